"""How many parameters a result has: the one definition behind console, page, JSON and documents.

A *parameter* is a number that the model predicts torque with: ten inertial parameters a link, a rotor inertia, friction
coefficients and constants a joint, and what else its terms have, `identified.estimates`. What the chosen friction law
leaves out is listed in `parameters.csv` for comparison with other results, and is not counted. A parameter is
*determined* if the data fix it by itself. A *base parameter* is a linear combination that the motion can reveal; it is
*determined* if the data give it a standard error.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

from .identified import Determination, Identified

DEFINITION = (
    "A parameter is a number that the model predicts torque with; what its friction law leaves out (fixed at zero, "
    "×) is listed and not counted. Determined by the data: its standard error follows from the data on its own. A base "
    "parameter is a linear combination that the motion can reveal."
)
"""The definition above for a page, in words."""


@dataclass(frozen=True)
class Counts:
    """How many parameters, and what they rest on.

    Attributes:
        by_determination: What a value rests on -> number of parameters, in the order of `Determination`.
        base: Base parameters.
        base_determined: Those with a standard error.
    """

    by_determination: Mapping[Determination, int]
    base: int
    base_determined: int

    @property
    def parameters(self) -> int:
        """All parameters of the model."""
        return sum(self.by_determination.values())

    @property
    def determined(self) -> int:
        """Those that the data determine by themselves."""
        return self.by_determination.get(Determination.DATA, 0)

    @property
    def words(self) -> str:
        """One clause for a console, without a full stop."""
        return (
            f"{self.determined} of {self.parameters} parameters determined by the data on their own, "
            f"{self.base_determined} of {self.base} base parameters"
        )

    def as_dict(self) -> dict[str, int]:
        """For programs: `total`, then one number a determination, then the base parameters."""
        kinds = {kind.value: number for kind, number in self.by_determination.items()}
        return {"total": self.parameters, **kinds, "base": self.base, "base_determined": self.base_determined}


def counts(identified: Identified) -> Counts:
    """Count the parameters of a result."""
    found = Counter(estimate.determination for estimate in identified.estimates)
    known = int(sum(error > 0.0 for error in identified.base_errors))
    return Counts({kind: found[kind] for kind in Determination if found[kind]}, len(identified.base_values), known)
