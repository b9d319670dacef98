"""`Reading` and `Comparing`: what recordings do not say of themselves, whichever session asks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..dynamics.arm import load_arm
from ..dynamics.effects import EFFECTS
from ..errors import UnfitDataError, UserError
from ..identification.identify import Progress
from ..logs.read import read_log
from ..recording import Recording, read_recording, recordings_in
from ..recording.tables import is_log

LEAST_RATE_HZ = 25.0
"""Slowest sampling that can be differentiated: five samples in a period of the lowest bandwidth a fit uses, 5 Hz."""
USUAL_RATE_HZ = 100.0
"""What any driver of an arm publishes, Hz."""


@dataclass(frozen=True)
class Reading:
    """How recordings are read.

    Attributes:
        arm: URDF or arm YAML: a log says nothing of its arm, and where several arms publish on one topic its joints are
            meant. None: what the bags describe.
        namespace: Of the arm, where a bag holds several, as `read_recording`.
        mapping: What the columns of a log are, as `read_log`; None: the file beside it, or what is proposed.
        fixed_base: Whether the base is taken for fixed though the bags hold its motion.
        otherwise: The arm of logs where neither `arm` nor their mapping names one, such as a simulation's URDF.
    """

    arm: Path | None = None
    namespace: str | None = None
    mapping: Path | None = None
    fixed_base: bool = False
    otherwise: Path | None = None

    def read(self, paths: Sequence[Path], progress: Progress) -> list[Recording]:
        """Read bags and logs one after the other, all of a folder of bags.

        Args:
            paths: MCAP files, rosbag2 folders, other bags, or logs.
            progress: Called with a share done in 0..1 and what is being done.

        Returns:
            A recording each.

        Raises:
            UserError: One cannot be read, or holds no joint states.
            UnfitDataError: One is sampled slower than `LEAST_RATE_HZ`.
        """
        recordings = []
        preferred = () if self.arm is None else load_arm(self.arm).joint_names
        paths = [bag for path in paths for bag in recordings_in(Path(path))]
        for number, path in enumerate(paths):
            progress(number / len(paths), f"reading {path.name}")
            recording = (
                read_log(path, self.arm, self.mapping, self.otherwise).recording
                if is_log(path)
                else read_recording(path, preferred=preferred, namespace=self.namespace)
            )
            if recording.rate_hz < LEAST_RATE_HZ:
                raise UnfitDataError(
                    f"{path}: {recording.rate_hz:.3g} Hz is too slow: friction reverses, inertia acts between the "
                    f"samples; record joint states at {USUAL_RATE_HZ:g} Hz or more, {LEAST_RATE_HZ:g} Hz at the very "
                    "least"
                )
            recordings.append(replace(recording, base=None) if self.fixed_base else recording)
        return recordings


@dataclass(frozen=True)
class Comparing:
    """How recordings are compared with a reference or a simulation.

    Attributes:
        reading: How they are read.
        gravity: (3,) m/s^2 in the base frame, instead of the arm's; None: the arm's.
        excluded: Effects that are not to be considered.

    Raises:
        UserError: There is no effect of a name that is excluded.
    """

    reading: Reading = field(default_factory=Reading)
    gravity: tuple[float, ...] | None = None
    excluded: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check the names."""
        for name in self.excluded:
            if name not in EFFECTS:
                raise UserError(f"no effect {name!r}: there are {', '.join(EFFECTS)}")
