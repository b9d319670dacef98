"""Bags and options in, a validated model and its result folder out: `spacearm identify` as a function.

The one pass behind `spacearm identify`, `spacearm batch` and the identifier node. `Options` are a user's wishes in
words and files: they cross to another process, say themselves as a command line, and have a fingerprint, by which a
result is recognised as what they would give again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from ..bayes.from_prior import GroundPrior
from ..documents import file_sha256
from ..dynamics.arm import Arm, load_arm
from ..dynamics.model import over_temperature, structure_of
from ..environment.gravity import require_gravity_choice
from ..errors import UserError
from ..estimate.identified import Identified
from ..identification.effort import in_newton_metres
from ..identification.identify import Progress, Settings
from ..identification.weighed import Weight, calibrate_gains, parse_weight
from ..recording import Recording, describe
from ..results.store import ARRAYS, MODEL, load_prior
from ..solvers.choice import SEPARABLE, require_solver
from .identification import Session, corrected, find_arm, identify_session, locked_words, structure_of_file, within
from .reading import Reading

AUTO, VACUUM = "auto", "vacuum"


@dataclass(frozen=True)
class Options:
    """How to identify, in the words of a user.

    Attributes:
        arm: URDF or arm YAML; None: of the bags' `/robot_description`.
        gravity: (3,) m/s^2 instead of the arm's; None: the arm's.
        fixed_base: Take the base for fixed though a bag holds its motion.
        namespace: Of the arm, where a bag holds several.
        friction: `auto` (the terms that predict held-out data best, joint by joint), or one of `FRICTION_LAWS`.
        cutoff_hz: Bandwidth; None: chosen from the data.
        structure: Model file whose terms are identified, effects included; its values do not count.
        solver: One of `SOLVERS`.
        seed: Of its particle swarm, where it has one.
        temperature: What of friction follows the joints' temperatures, some of `OVER_TEMPERATURE`.
        estimate_gravity: One of `GRAVITY_CHOICES`; empty: gravity is the arm's.
        prior: Result folder, or the model.yaml in one, to update.
        mapping: What the columns of logs are; None: the file beside each, or what is proposed.
        weighed: MASS@LINK of a known mass, kg, that the arm carries in `loaded`; empty: torque gains are taken as 1.
        loaded: Recordings with the known mass, otherwise of the same arm as those to fit.
    """

    arm: Path | None = None
    gravity: tuple[float, float, float] | None = None
    fixed_base: bool = False
    namespace: str | None = None
    friction: str = AUTO
    cutoff_hz: float | None = None
    structure: Path | None = None
    solver: str = SEPARABLE
    seed: int = 0
    temperature: tuple[str, ...] = ()
    estimate_gravity: str = ""
    prior: Path | None = None
    mapping: Path | None = None
    weighed: str = ""
    loaded: tuple[Path, ...] = ()

    def words(self) -> list[str]:
        """The same on the command line of `spacearm identify`."""
        words = arm_words(self.arm, self.gravity)
        if self.fixed_base:
            words += ["--fixed-base"]
        if self.namespace is not None:
            words += ["--namespace", self.namespace]
        if self.friction != AUTO:
            words += ["--friction", self.friction]
        if self.structure is not None:
            words += ["--structure", str(self.structure)]
        if self.solver != SEPARABLE:
            words += ["--solver", self.solver, "--seed", str(self.seed)]
        if self.temperature:
            words += ["--temperature", ",".join(self.temperature)]
        if self.estimate_gravity:
            words += ["--estimate-gravity", self.estimate_gravity]
        if self.prior is not None:
            words += ["--prior", str(self.prior)]
        if self.mapping is not None:
            words += ["--mapping", str(self.mapping)]
        if self.weighed:
            words += [*(word for bag in self.loaded for word in ("--loaded", str(bag))), "--weighed", self.weighed]
        if self.cutoff_hz is not None:
            words += ["--bandwidth", _exact(self.cutoff_hz)]
        return words

    def absolute(self) -> Options:
        """The same from whatever folder a process works in."""
        files = {name: getattr(self, name) for name in ("arm", "structure", "prior", "mapping")}
        loaded = tuple(bag.resolve() for bag in self.loaded)
        return replace(
            self, loaded=loaded, **{name: file.resolve() for name, file in files.items() if file is not None}
        )

    def fingerprint(self) -> dict[str, Any]:
        """What is not as by default, as plain data; of a file its content (SHA-256), wherever it lies.

        Raises:
            UserError: A file cannot be read.
        """
        given = {item.name: getattr(self, item.name) for item in fields(self)}
        changed = {item.name: given[item.name] for item in fields(self) if given[item.name] != item.default}
        return {name: _content(name, value) for name, value in changed.items()}

    def settings(self, arm: Arm, prior: GroundPrior | None = None) -> Settings:
        """For an arm.

        Args:
            arm: The arm.
            prior: Ground model to update, in its own structure; with friction `vacuum`, its k_v2 and k_v3 are gone.

        Raises:
            UserError: No friction law, solver, temperature term or choice of that name, a negative seed, a law beside a
                structure, a structure that is not of this arm, or what a prior decides beside a prior.
        """
        friction, structure, temperature = self.friction, self.structure, self.temperature
        require_solver(self.solver)
        if self.seed < 0:
            raise UserError(f"seed {self.seed}: a seed is a whole number from 0 on")
        require_gravity_choice(self.estimate_gravity, arm.gravity)
        if prior is not None:
            if friction not in (AUTO, VACUUM) or structure is not None or temperature or self.solver != SEPARABLE:
                raise UserError(
                    f"a prior has its own structure and solver: beside it, friction may be {VACUUM} (k_v2 and k_v3 "
                    "gone), leave out other friction, structure, temperature and solver"
                )
            ground = prior.in_vacuum() if friction == VACUUM else prior
            return Settings(self.cutoff_hz, gravity=self.estimate_gravity, prior=ground)
        if structure is None:
            terms = None if friction == AUTO else structure_of(arm, friction)
            over_temperature(terms or structure_of(arm), arm, temperature)
            return Settings(self.cutoff_hz, terms, self.solver, self.seed, tuple(temperature), self.estimate_gravity)
        if friction != AUTO or temperature:
            asked = f"friction {friction}" if friction != AUTO else f"temperature {','.join(temperature)}"
            raise UserError(f"a structure has its own friction law: leave out {asked} or {structure}")
        terms = structure_of_file(structure, arm)
        return Settings(self.cutoff_hz, terms, self.solver, self.seed, gravity=self.estimate_gravity)

    def weight(self) -> Weight | None:
        """The known mass, if there is one.

        Raises:
            UserError: Not a mass, no recordings with it, recordings without a mass, or a prior whose gains are fixed.
        """
        if bool(self.weighed) != bool(self.loaded):
            raise UserError("a known mass needs both --weighed MASS@LINK and --loaded BAG, recorded with it")
        if self.weighed and self.prior is not None:
            raise UserError("--weighed does not go with --prior: the prior's torque has the gains it was recorded with")
        return parse_weight(self.weighed) if self.weighed else None


def identify_bags(
    fitted: Sequence[Path],
    validated: Sequence[Path],
    directory: Path,
    options: Options,
    *,
    command: str | None = None,
    known: Identified | None = None,
    progress: Progress | None = None,
) -> tuple[Session, tuple[str, ...]]:
    """Read, identify, validate, write the result folder.

    Args:
        fitted: Bags to identify the arm from.
        validated: Bags to validate on; empty: hold-out; `fitted` again: nothing is held out.
        directory: Result folder.
        options: How.
        command: How to do it again; kept with the result.
        known: The identification of all of `fitted`, where there is one already.
        progress: Called with a share done in 0..1 and what is being done.

    Returns:
        What came out, and what was found in the recordings, a line each.

    Raises:
        UserError: As `identify_session`, or a file cannot be read.
    """
    report = progress or (lambda share, what: None)
    reading = Reading(options.arm, options.namespace, options.mapping, options.fixed_base)
    runs = reading.read(fitted, within(report, 0.0, 0.2))
    again = tuple(validated) == tuple(fitted)
    judges = runs if again else reading.read(validated, within(report, 0.2, 0.3))
    recordings: list[Recording] = [*runs, *(() if again else judges)]
    prior = load_prior(options.prior) if options.prior else None
    arm = find_arm(options.arm, options.gravity, recordings, prior)
    settings = options.settings(arm, prior)
    if weight := options.weight():
        loaded = reading.read(options.loaded, within(report, 0.3, 0.35))
        with_mass, without = (corrected(in_newton_metres(part, arm), arm) for part in (loaded, runs))
        gains = calibrate_gains(without, with_mass, arm, weight)
        settings, arm = replace(settings, gains=gains), gains.corrected(arm)
    runs = in_newton_metres(runs, arm)
    judges = runs if again else in_newton_metres(judges, arm)
    recordings = [*runs, *(() if again else judges)]
    session = identify_session(
        runs,
        judges,
        arm,
        settings,
        directory,
        command=command,
        asked=options.fingerprint(),
        known=known,
        progress=within(report, 0.35, 1.0),
    )
    lines = [line for recording in recordings for line in describe(recording)]
    return session, (*lines, *locked_words(arm))


def arm_words(arm: Path | None, gravity: Sequence[float] | None) -> list[str]:
    """`--arm` and `--gravity`, where there are any.

    Args:
        arm: URDF or arm YAML; None: no option.
        gravity: (3,) m/s²; None: no option. Numbers keep every digit.
    """
    words = [] if arm is None else ["--arm", str(arm)]
    return words if gravity is None else [*words, "--gravity", *map(_exact, gravity)]


def _exact(value: float) -> str:
    """A number as a person writes it, and with every digit it has."""
    short = f"{value:g}"
    return short if float(short) == value else repr(float(value))


def _content(name: str, value: Any) -> Any:
    """A wish as plain data: what a file holds, and what it refers to."""
    if isinstance(value, tuple):
        return [_content(name, item) for item in value]
    if not isinstance(value, Path):
        return value
    try:
        if name == "arm":
            return hashlib.sha256(value.read_bytes() + load_arm(value).urdf.encode()).hexdigest()
        if name == "prior":
            folder = value if value.is_dir() else value.parent
            return [file_sha256(folder / MODEL if value.is_dir() else value), file_sha256(folder / ARRAYS)]
        if value.is_dir():
            return [file_sha256(file) for file in sorted(value.rglob("*")) if file.is_file()]
        return file_sha256(value)
    except OSError as error:
        raise UserError(f"cannot read {value} ({error.strerror or error}): check the path") from error
