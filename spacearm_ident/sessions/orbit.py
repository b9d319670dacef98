"""An orbit session: commissioning runs on the ground, runs in orbit in; an adapted model and why it moved out.

Ground runs are identified as by `spacearm identify`; the result is the prior of the adaptation to the orbit's runs. On
runs that neither saw, three models are judged: the ground's as it is, the same with gravity as it is in orbit, and the
adapted one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..arrays import FloatArray
from ..bayes.adaptation import Adaptation, adapt
from ..bayes.from_prior import GroundPrior
from ..dynamics.arm import Arm
from ..errors import UserError
from ..estimate.identified import Validation
from ..identification.identify import Progress, Settings
from ..identification.validation import validate
from ..recording import Recording
from ..report.orbit_folder import write_orbit
from .identification import identify_session, within

WANTED_R = 0.97
"""The paper's R on every joint, all samples (abstract)."""


@dataclass(frozen=True)
class OrbitSession:
    """What came out.

    Attributes:
        adaptation: The adapted model, and what moved.
        ground: The ground's model on ground runs it had not seen.
        unadapted, weightless, adapted: Three models on orbit runs that none of them had seen.
        page: The report to open.
    """

    adaptation: Adaptation
    ground: Validation
    unadapted: Validation
    weightless: Validation
    adapted: Validation
    page: Path

    @property
    def shortfall(self) -> str | None:
        """Why the adaptation is not good enough; None where it is."""
        for when, validation in (("on the ground", self.ground), ("in orbit, adapted", self.adapted)):
            joint, figures = min(validation.joints.items(), key=lambda item: _r(item[1].everything.correlation))
            r = _r(figures.everything.correlation)
            if not r > WANTED_R:
                return f"R is {r:.4f} at {joint} {when}, not above {WANTED_R:g}"
        return None


def _r(correlation: float) -> float:
    """R; a joint whose torque does not vary has none, and is not known to be right."""
    return correlation if correlation == correlation else -1.0


def orbit_session(
    ground: tuple[Sequence[Recording], Sequence[Recording]],
    orbit: tuple[Sequence[Recording], Sequence[Recording]],
    arm: Arm,
    gravity: FloatArray,
    directory: Path,
    *,
    settings: Settings | None = None,
    command: str | None = None,
    progress: Progress | None = None,
) -> OrbitSession:
    """Identify on the ground, adapt in orbit, judge, write `directory` and, below it, the ground's own result.

    Args:
        ground: Runs to identify from, and runs to validate on.
        orbit: Runs to adapt to, and runs to judge on.
        arm: What is known before, with gravity as on the ground.
        gravity: (3,) in orbit, m/s², base frame.
        directory: Result folder; `ground` in it is a result folder of `spacearm identify`.
        settings: Decisions of the user on the identification.
        command: How to do it again.
        progress: Called with a share done in 0..1 and what is being done.

    Raises:
        UnfitDataError: The data cannot carry it.
        UserError: The recordings do not fit the arm, or the folder cannot be written.
    """
    report = progress or (lambda share, what: None)
    if not all(ground) or not all(orbit):
        raise UserError("an orbit session needs runs to fit and runs to judge on, on the ground and in orbit")
    first = identify_session(
        ground[0],
        ground[1],
        arm,
        settings or Settings(),
        directory / "ground",
        command=command,
        progress=within(report, 0.0, 0.5),
    )
    report(0.5, "adapting to the orbit")
    adaptation = adapt(GroundPrior.of(first.identified), orbit[0], gravity)
    report(0.8, "judging")
    models = (adaptation.ground, adaptation.weightless, adaptation.adapted)
    judged = [validate(model, orbit[1], "on held-out orbit runs", True) for model in models]
    report(0.9, "writing the report")
    page = write_orbit(adaptation, (first.validation, *judged), orbit, WANTED_R, directory, command)
    report(1.0, "done")
    return OrbitSession(adaptation, first.validation, judged[0], judged[1], judged[2], page)
