"""`CouplingTrial`: whether a motor that turns with the last two joints explains a wrist that fits badly."""

from __future__ import annotations

from dataclasses import dataclass

from ..dynamics.arm import Coupling


@dataclass(frozen=True)
class CouplingTrial:
    """What a coupling of the last two joints brought in held-out blocks.

    Attributes:
        coupling: The better of those that were tried.
        before, after: Residual RMS over torque RMS of either joint while it moves, without and with it.
        helps: Whether both joints are predicted better beyond chance.
        adopted: Whether the identified model has it.
    """

    coupling: Coupling
    before: tuple[float, float]
    after: tuple[float, float]
    helps: bool
    adopted: bool = False

    @property
    def joints(self) -> tuple[str, str]:
        """The two joints."""
        first, last = self.coupling.ratios
        return first, last

    @property
    def line(self) -> str:
        """The line for an arm YAML."""
        ratios = ", ".join(f"{joint}: {ratio:.1f}" for joint, ratio in self.coupling.ratios.items())
        return f"couplings: [{{name: {self.coupling.name}, ratios: {{{ratios}}}}}]"

    @property
    def words(self) -> str:
        """What was tried and what it brought, for a person."""
        first, last = self.joints
        change = (
            f"residual of {first} {self.before[0]:.0%} -> {self.after[0]:.0%}, of {last} {self.before[1]:.0%} -> "
            f"{self.after[1]:.0%} of the torque (held-out blocks, moving, plain friction law)"
        )
        if self.adopted:
            return f"in the model: a motor that turns with {first} and {last}: {change}; in an arm YAML: {self.line}"
        if self.helps:
            return f"tried: a motor that turns with {first} and {last}: {change}; add to the arm YAML: {self.line}"
        return f"tried, no improvement: a motor that turns with {first} and {last}: {change}"

    def as_dict(self) -> dict[str, object]:
        """For programs."""
        return {
            "joints": list(self.joints),
            "relative_rms_before": list(self.before),
            "relative_rms_after": list(self.after),
            "helps": self.helps,
            "adopted": self.adopted,
            "yaml": self.line if self.helps else None,
        }
