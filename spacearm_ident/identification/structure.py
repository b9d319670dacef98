"""Which optional terms are in the model: those that predict held-out data better, joint by joint.

Two searches, for joints share their inertials, and what is missing at one spoils what could be seen at another.

- *Forward* from the plain law (Coulomb and viscous friction, rotor inertia, offset), one term at one joint at a time. A
  change is made if the joint is predicted better in held-out blocks (`trials.py`), beyond chance, if all joints
  together are predicted no worse, and if the values it takes are possible.
- *Backward* from every term that the data can show, at all joints: what does not help its joint beyond chance, beside
  all others, is taken out, the least helpful first. The offset, which the plain law has, goes where the joint is
  predicted better without it.

Both end in a law whose terms have all been shown to help; presliding alone has only not been contradicted (`_needed`).
The second counts where its values are possible, too, and it predicts held-out blocks better than the first. So the
result is the plain model wherever nothing else predicts better. A level shared out among all that is tried would hold
for each joint as a whole, but it leaves out what predicts (docs/real_arms.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import Structure
from ..estimate.identified import Choice
from ..estimate.optional_terms import POSITION, SPEED, OptionalTerm
from ..regression.held_out import BEYOND, FEWEST_BLOCKS, LEVEL, bound, gain, t_of_drop
from .fit import Fit
from .joint_terms import QUADRATIC, JointTerms, column, structure_with
from .trials import Trials

ROUNDS = 12
"""Changes in a row at one joint; more than there are terms."""
COVERED_SHARE = 0.25
"""Share of a joint's velocity limit that the data must reach before friction of second or third order in speed is
considered: a curvature seen below a quarter of the range is hardly distinct from slopes of other terms, and the rest of
the range would be extrapolated (rokae joint 6, 8 % of its range: 27 % of its torque off, without the term 9 %). As much
of the joint's range, or of a turn, they must cover before a spring is considered."""
SPEEDS = 9
"""Speeds at which friction is checked to resist, from zero to the largest in the data."""


@dataclass(frozen=True)
class _Step:
    """A change of one joint's law, with what it brings: drop in squares as a share, and t of the drop over blocks."""

    joint: int
    law: JointTerms
    gain: float
    t: float


def choose_structure(fit: Fit) -> tuple[Structure, tuple[Choice, ...]]:
    """The structure whose optional terms predict held-out data best.

    Args:
        fit: Fitted with all terms of the paper's law.

    Returns:
        The structure, and every decision with its evidence.
    """
    joints = fit.regression.model.arm.joint_names
    fastest = np.max([np.abs(motion.velocity).max(axis=0) for motion in fit.regression.motions], axis=0)
    laws = [JointTerms() for _ in joints]
    trials = Trials(fit)
    offered = [_offered(trials, fit, number, float(speed)) for number, speed in enumerate(fastest)]
    evidence: dict[tuple[int, OptionalTerm], float] = {}
    if trials.blocks >= FEWEST_BLOCKS and trials.folds > 1:
        trials.settle(laws)
        laws = _searched(trials, laws, offered, fastest, evidence)
        against: dict[tuple[int, OptionalTerm], float] = {}
        reduced = _reduced(trials, _whole(trials, offered), against)
        possible = all(_possible(trials, reduced, joint, fastest) for joint in range(len(joints)))
        if possible and gain(trials.held_out(laws), trials.held_out(reduced)) > 0.0:
            laws, evidence = reduced, against
    choices = tuple(
        Choice(
            term=f"{term.row.words} at {joint}",
            gain=float(evidence.get((number, term), 0.0)),
            accepted=term in laws[number].terms,
            kind=term,
            joint=joint,
        )
        for number, joint in enumerate(joints)
        for term in OptionalTerm
        if term in laws[number].terms or (number, term) in evidence
    )
    return structure_with(fit.regression.model.structure, joints, laws, fastest.tolist()), choices


def _offered(trials: Trials, fit: Fit, joint: int, fastest: float) -> frozenset[OptionalTerm]:
    """Terms that a joint may get: those that are seen, and whose range the data cover."""
    described, motions = fit.regression.model.arm.joints[joint], fit.regression.motions
    positions = np.concatenate([motion.position[:, joint] for motion in motions])
    turn = 2.0 * np.pi if described.revolute else np.inf
    uncovered: set[str] = set()
    if np.isfinite(described.velocity_limit) and fastest < COVERED_SHARE * described.velocity_limit:
        uncovered.add(SPEED)
    if np.ptp(positions) < COVERED_SHARE * min(described.upper - described.lower, turn):
        uncovered.add(POSITION)
    return frozenset(term for term in trials.seen[joint] if term.row.covers not in uncovered)


def _searched(
    trials: Trials,
    laws: list[JointTerms],
    offered: Sequence[frozenset[OptionalTerm]],
    fastest: FloatArray,
    evidence: dict[tuple[int, OptionalTerm], float],
) -> list[JointTerms]:
    """Make the best change at every joint until none is left; `evidence` takes t by joint and term."""
    current = trials.held_out(laws)
    for _ in range(ROUNDS):
        steps = []
        for joint in range(len(laws)):
            tried = [_step(trials, laws, current, joint, law) for law in laws[joint].neighbours(offered[joint])]
            for step in tried:
                changed_terms = step.law.terms ^ laws[joint].terms
                for term in changed_terms if len(changed_terms) == 1 else ():
                    evidence[joint, term] = step.t if term in step.law.terms else -step.t
            steps += [step for step in tried if step.gain > 0.0 and step.t > _needed(laws[joint], step.law, trials)]
        changed: set[int] = set()
        for step in sorted(steps, key=lambda one: -one.gain):
            if step.joint in changed or not _possible(trials, _with(laws, step.joint, step.law), step.joint, fastest):
                continue
            again = _step(trials, laws, current, step.joint, step.law)
            if again.gain > 0.0:
                laws = _with(laws, step.joint, step.law)
                current = trials.held_out(laws)
                changed.add(step.joint)
        if not changed:
            break
    return laws


def _needed(before: JointTerms, after: JointTerms, trials: Trials) -> float:
    """The t that a change of a joint's law must exceed.

    Zero where presliding is added: in no joint is friction discontinuous at a reversal. It acts in few blocks, so that
    held-out data need only not contradict it.
    """
    return 0.0 if OptionalTerm.PRESLIDING in after.terms - before.terms else bound(LEVEL, trials.blocks)


def _whole(trials: Trials, offered: Sequence[frozenset[OptionalTerm]]) -> list[JointTerms]:
    """Laws with every term that a joint may have, each quadratic one in the form that leaves less beside the others."""

    def law(terms: frozenset[OptionalTerm], form: OptionalTerm) -> JointTerms:
        return JointTerms(JointTerms().terms | terms.difference(QUADRATIC) | terms.intersection({form}))

    laws = [law(terms, OptionalTerm.EVEN) for terms in offered]
    for joint, terms in enumerate(offered):
        odd = _with(laws, joint, law(terms, OptionalTerm.ODD))
        if gain(trials.held_out(laws), trials.held_out(odd)) > 0.0:
            laws = odd
    return laws


def _reduced(
    trials: Trials, laws: list[JointTerms], evidence: dict[tuple[int, OptionalTerm], float]
) -> list[JointTerms]:
    """Without the terms that do not help beyond chance beside all others; `evidence` takes t by joint and term."""
    for _ in range(ROUNDS):
        current, weakest = trials.held_out(laws), []
        for joint, whole in enumerate(laws):
            for law in whole.simpler():
                t = t_of_drop(trials.held_out(_with(laws, joint, law))[:, joint], current[:, joint])
                (term,) = whole.terms - law.terms
                evidence[joint, term] = t
                if t <= (-BEYOND if term is OptionalTerm.OFFSET else _needed(law, whole, trials)):
                    weakest.append((t, joint, law))
        changed: set[int] = set()
        for _, joint, law in sorted(weakest, key=lambda one: one[0]):
            if joint not in changed:
                laws = _with(laws, joint, law)
                changed.add(joint)
        if not changed:
            break
    return laws


def _with(laws: Sequence[JointTerms], joint: int, law: JointTerms) -> list[JointTerms]:
    return [law if number == joint else other for number, other in enumerate(laws)]


def _step(trials: Trials, laws: Sequence[JointTerms], current: FloatArray, joint: int, law: JointTerms) -> _Step:
    """What a change brings in held-out blocks: the gain of all joints together, and how clear it is at its own."""
    left = trials.held_out(_with(laws, joint, law))
    return _Step(joint, law, gain(current, left), t_of_drop(current[:, joint], left[:, joint]))


def _possible(trials: Trials, laws: Sequence[JointTerms], joint: int, fastest: FloatArray) -> bool:
    """Whether the values that a joint's law takes are physical: f_b above f_c, friction that resists."""
    values = trials.values(laws, joint)
    law, speeds = laws[joint], np.linspace(0.0, float(fastest[joint]), SPEEDS)
    for term in law.terms:
        if term.row.possible is not None:
            lowest, highest = term.row.possible
            if not lowest <= values[column(term, law.tag)] <= highest:
                return False
    odd = values[f"f_c {law.tag}"] + values.get("k_v1", 0.0) * speeds + values.get("k_v3", 0.0) * speeds**3
    odd = odd + values.get("k_v2_odd", 0.0) * speeds**2
    even = values.get("k_v2", 0.0) * speeds**2
    return bool((odd - np.abs(even) >= 0.0).all())
