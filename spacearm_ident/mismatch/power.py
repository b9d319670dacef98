"""Power: for effects that were not found, the size from which they would have been.

What an effect must show to be a finding (`competition.GATE`, `judgement`) is turned round: the smallest size with which
the field's rows, whitened and beside the base, gain the gate and the penalty, which is no friction of another day, and
with which a joint's residual is beyond what a healthy arm leaves. An effect of this size is found, unless another
explains as much or the held-out data do not show it; a smaller one may be, where it exceeds what it seems to be in
parts of the reference (`null.py`), which is not computed for effects that nothing spoke for.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from ..arrays import FloatArray
from ..forks import each
from .candidate import INVISIBLE, UNDERFLOW, Candidate
from .evidence import Evidence
from .finding import Detectable, Finding
from .healthy import Healthy
from .judgement import BEYOND_A_DAY, LEAST
from .residuals import unwhitened
from .scored import penalty
from .stacked import stacked_effect


def would_have_seen(
    evidence: Evidence,
    on_a_day: Evidence,
    tried: Iterable[Sequence[Candidate]],
    findings: Sequence[Finding],
    healthy: Healthy,
    gate: float,
) -> tuple[Detectable, ...]:
    """The smallest size of every effect that was not found.

    Args:
        evidence: Base, field and reference.
        on_a_day: The same, with friction of the field that may be another day's.
        tried: Effects that were compared, each at the points of its constants' grids; of several forms of one effect
            at its joints the first is taken.
        findings: What was found; the same effect at one of its joints is left out.
        healthy: What a healthy arm leaves of the judged recordings.
        gate: Drop in chi-square that an effect must bring.

    Returns:
        By effect and joints; none for events in time, which have no one size. Last, with an infinite size, the effects
        that these recordings would not show at any size that they can have.
    """
    seen = {(finding.effect, joint) for finding in findings for joint in finding.joints}
    power = _Power(evidence, on_a_day, healthy, gate)

    def is_asked(grid: Sequence[Candidate]) -> bool:
        effect = grid[0].effect
        return not any((effect.kind, joint) in seen for joint in effect.joints)

    def smallest(grid: Sequence[Candidate]) -> Detectable | None:
        return power.of_constant(grid) if grid[0].held.all() else power.of_parameter(grid)

    asked = [grid for grid in tried if grid and is_asked(grid)]
    sizes: dict[tuple[str, tuple[str, ...]], Detectable] = {}
    for size in each(smallest, asked):
        if size is not None:
            sizes.setdefault((size.name, size.joints), size)
    for effect in (grid[0].effect for grid in asked):
        sizes.setdefault((effect.kind, effect.joints), Detectable(effect.kind, effect.joints, np.inf, ""))
    return tuple(sizes.values())


class _Power:
    """The size of an effect from what its columns add to the field's rows."""

    def __init__(self, evidence: Evidence, on_a_day: Evidence, healthy: Healthy, gate: float) -> None:
        self._evidence, self._on_a_day, self._gate = evidence, on_a_day, gate
        self._scene = unwhitened(evidence.base, evidence.field)
        self._rows = self._scene.by_joint(np.ones(len(self._scene)))
        # A joint whose noise is not known shows nothing.
        floor = np.where(np.isfinite(healthy.floor_Nm), healthy.floor_Nm, np.inf)
        # (n,) mean square that an effect must add to a joint's residual, N²·m².
        with np.errstate(invalid="ignore"):
            self._needed = np.fmax(np.fmax(healthy.largest_Nm, floor) ** 2 - floor**2, LEAST * floor**2)

    def of_parameter(self, grid: Sequence[Candidate]) -> Detectable | None:
        """Of its first free parameter, at the constants at which the base can take over least."""
        number = int(np.flatnonzero(~grid[0].held)[0])
        values = np.eye(len(grid[0].effect.parameters))[number]
        best = max(grid, key=lambda candidate: _visibility(candidate, values))
        share = self._share(best, values)
        if not share > 0.0:
            return None
        shown = _shown(best, number, float(1.0 / np.sqrt(share)))
        return None if shown is None or self._is_beyond_the_arm(shown) else shown

    def _is_beyond_the_arm(self, size: Detectable) -> bool:
        """Whether it is more torque than its joint needed for anything: an effect that no such arm has."""
        names = self._evidence.base.model.arm.joint_names
        own = np.isin(self._scene.joint, [names.index(joint) for joint in size.joints])
        return size.unit in ("N m", "N") and size.size > np.max(np.abs(self._scene.torque()[own]), initial=0.0)

    def of_constant(self, grid: Sequence[Candidate]) -> Detectable | None:
        """Of an effect whose size is in its constants: the point of their grids that adds least and would be seen."""
        prior = np.array([parameter.prior for parameter in grid[0].effect.parameters])
        seen = [candidate for candidate in grid if self._by_gate(candidate, prior) >= 1.0]
        for candidate in sorted(seen, key=lambda one: float(prior @ one.gram @ prior)):
            if self._share(candidate, prior) >= 1.0:
                effect = candidate.effect
                name, (value, unit) = next(iter(effect.shown(np.array([*prior, *candidate.constants])).items()))
                return Detectable(effect.kind, effect.joints, value, unit, name)
        return None

    def _by_gate(self, candidate: Candidate, values: FloatArray) -> float:
        """What it gains over what it must, in chi-square."""
        needed = self._gate + penalty(candidate.effect, self._evidence.rows)
        return float(values @ candidate.gram @ values) / needed

    def _share(self, candidate: Candidate, values: FloatArray) -> float:
        """Square of the largest factor by which the effect could be smaller and still be found."""
        visibility = _visibility(candidate, values)
        if not visibility > INVISIBLE:
            return 0.0
        stacked = stacked_effect(self._scene, candidate.effect, candidate.constants)
        squares = np.zeros(len(self._scene))
        squares[stacked.rows] = (stacked.columns @ values) ** 2
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = visibility * self._scene.by_joint(squares) / (self._rows * self._needed)
        (day,) = self._on_a_day.again([candidate])
        by_day = float(values @ day.gram @ values) / BEYOND_A_DAY
        return min(self._by_gate(candidate, values), by_day, float(np.max(np.nan_to_num(beyond, posinf=0.0))))


def _visibility(candidate: Candidate, values: FloatArray) -> float:
    """Share of an effect's energy, with these parameters (k,), that the base cannot take over."""
    energy = float(np.sum((candidate.stacked.columns @ values) ** 2))
    return float(values @ candidate.gram @ values) / energy if energy > UNDERFLOW else 0.0


def _shown(candidate: Candidate, number: int, size: float) -> Detectable | None:
    """A parameter's size in the quantity that a card shows of it; None where it is in none, or beyond its bounds."""
    effect, parameter = candidate.effect, candidate.effect.parameters[number]
    before = np.array([*(parameter.prior for parameter in effect.parameters), *candidate.constants])
    after = before.copy()
    after[number] += size if parameter.upper >= before[number] + size else -size
    if after[number] < parameter.lower:
        return None
    old, new = effect.shown(before), effect.shown(after)
    for name, (value, unit) in new.items():
        change = abs(value - old[name][0])
        if np.isfinite(change) and change > 0.0:
            return Detectable(effect.kind, effect.joints, change, unit, name)
    return None
