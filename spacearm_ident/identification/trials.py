"""`Trials`: held-out squares of any choice of optional terms, without going back to the rows.

The rows of every joint are cut into blocks of time, and each block is kept as the Gram matrix of its weighted columns,
the optional ones and the torque included. Any choice of terms, fitted to some blocks and judged on others, is then a
small linear problem: a joint's own columns are eliminated (Schur complement), the inertials that joints share are
solved for, and the squares left in a held-out block are a quadratic form (Golub and Van Loan 2013, ch. 5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.friction import StribeckFriction
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..dynamics.rigid_body import JointSpring
from ..noise.weights import common_correlation
from ..regression.held_out import folds_of, time_blocks
from ..regression.prior import make_prior
from ..regression.regression import Regression
from .fit import Fit
from .joint_terms import JointTerms

SETTLING = 3
"""Rounds in which the weights of the joints follow their residuals."""
RIDGE = 1e-9
"""Relative, on the diagonal: keeps an elimination regular where a joint has two equal columns."""


COLUMN_OF = {
    "offset": "offset",
    "stribeck": "f_c v0",
    "presliding": "f_c 0d",
    "load": "mu 00",
    "even": "k_v2",
    "odd": "k_v2_odd",
    "cubic": "k_v3",
    "spring": "k_1",
}
"""Optional term -> the column by whose presence it can be chosen."""


@dataclass
class _Joint:
    """Gram matrices of one joint: shared columns, own columns, torque."""

    own: dict[str, int]
    fixed: tuple[str, ...]
    gram: FloatArray
    ridge: FloatArray
    rows: int


class Trials:
    """Gram matrices by joint and block.

    Attributes:
        blocks: Number of blocks.
        seen: Per joint, names of the optional terms that these data can show.
    """

    def __init__(self, fit: Fit) -> None:
        """Build the columns of every optional term beside those of a fitted model.

        Args:
            fit: Fitted with all terms of the paper's law; its constants shape the columns.
        """
        regression, constants = _with_everything(fit)
        self._model, self.joints = regression.model, regression.model.arm.joint_names
        prior = make_prior(regression.model, regression.motions)
        owners = _owners(regression)
        shared = np.array(sorted(k for k, rows in owners.items() if len(rows) > 1), dtype=int)
        self._shared = len(shared)
        width = prior.rows[:, shared]
        concerned = np.abs(width).sum(axis=1) > 0
        self._information = width[concerned].T @ width[concerned] + RIDGE * np.eye(self._shared)
        self._pull = width[concerned].T @ prior.target[concerned]
        block_of, self._recording = time_blocks(regression.motions)
        self.blocks = len(self._recording)
        self._correlation = common_correlation([noise for joint in fit.noise for noise in joint])
        self._joints = [
            _joint(regression, fit, joint, constants, shared, prior.scale, block_of, self.blocks)
            for joint in range(len(self.joints))
        ]
        self.seen = [
            frozenset(name for name, column in COLUMN_OF.items() if one.rows and column in one.own)
            for one in self._joints
        ]
        self._known: dict[tuple[int, JointTerms, bytes], tuple[FloatArray, FloatArray, np.ndarray]] = {}

    @property
    def folds(self) -> list[np.ndarray]:
        """Numbers of the blocks that are held out together."""
        return folds_of(self._recording)

    def settle(self, laws: Sequence[JointTerms]) -> None:
        """Weight each joint by what these laws leave of it."""
        everything = np.arange(self.blocks)
        for _ in range(SETTLING):
            squares = self._squares(everything, *self._solve(everything, laws)).sum(axis=0)
            for joint, left in zip(self._joints, squares):
                if joint.rows:
                    joint.gram /= max(left / joint.rows, 1e-12)
            self._known.clear()

    def held_out(self, laws: Sequence[JointTerms]) -> FloatArray:
        """(blocks, n) squares left in every block by a fit to the blocks of the other folds, in units of `settle`."""
        left = np.zeros((self.blocks, len(self._joints)))
        for fold in self.folds:
            rest = np.setdiff1d(np.arange(self.blocks), fold)
            left[fold] = self._squares(fold, *self._solve(rest, laws))
        return left

    def values(self, laws: Sequence[JointTerms], joint: int) -> dict[str, float]:
        """Values of a joint's own columns, fitted to everything: column name -> value; `f_b` relative to `f_c`."""
        _, own = self._solve(np.arange(self.blocks), laws)
        names = {place: name for name, place in self._joints[joint].own.items()}
        return {names[int(place)]: float(value) for place, value in zip(*own[joint])}

    def _solve(
        self, blocks: np.ndarray, laws: Sequence[JointTerms]
    ) -> tuple[FloatArray, list[tuple[np.ndarray, FloatArray]]]:
        """Shared parameters, and per joint the places and values of its own, fitted to some blocks."""
        normal = np.zeros((self._shared + 1, self._shared + 1))
        eliminated = []
        for number, law in enumerate(laws):
            key = number, law, blocks.tobytes()
            if key not in self._known:
                self._known[key] = self._eliminate(number, law, blocks)
            part = self._known[key]
            normal += part[0]
            eliminated.append(part)
        matrix = normal[:-1, :-1] + self._information
        shared = np.linalg.solve(matrix + RIDGE * np.diag(np.diag(matrix)), normal[:-1, -1] + self._pull)
        return shared, [(own, back[:, -1] - back[:, :-1] @ shared) for _, back, own in eliminated]

    def _eliminate(self, number: int, law: JointTerms, blocks: np.ndarray) -> tuple[FloatArray, FloatArray, np.ndarray]:
        """Schur complement of a joint's own columns, the way back to their values, and their places."""
        joint = self._joints[number]
        own = np.array([joint.own[name] for name in (*joint.fixed, *law.columns) if name in joint.own], dtype=int)
        outer = np.r_[np.arange(self._shared), joint.gram.shape[1] - 1]
        gram = joint.gram[blocks].sum(axis=0) / self._correlation
        inner = gram[np.ix_(own, own)] + np.diag(joint.ridge[own] + RIDGE * np.diag(gram)[own])
        across = gram[np.ix_(own, outer)]
        back = np.linalg.solve(inner, across) if len(own) else np.zeros((0, len(outer)))
        return gram[np.ix_(outer, outer)] - across.T @ back, back, own

    def _squares(self, blocks: np.ndarray, shared: FloatArray, own: list[tuple[np.ndarray, FloatArray]]) -> FloatArray:
        """(len(blocks), n) squares left by a solution."""
        left = np.zeros((len(blocks), len(self._joints)))
        for number, (joint, (places, values)) in enumerate(zip(self._joints, own)):
            vector = np.zeros(joint.gram.shape[1])
            vector[: self._shared], vector[places], vector[-1] = shared, values, -1.0
            left[:, number] = np.einsum("i,bij,j->b", vector, joint.gram[blocks], vector)
        return np.maximum(left, 0.0)


def _with_everything(fit: Fit) -> tuple[Regression, FloatArray]:
    """The fitted model's regression with the columns of every optional term, and the constants that shape them."""
    fitted, solution = fit.regression.model, fit.solution
    structure: Structure = {
        **fitted.structure,
        "stribeck_friction": {**fitted.structure["stribeck_friction"], "load": True},
        "viscous_friction": {"quadratic": "both"},
        "torque_offset": {},
        JointSpring.kind: {"free": True},
    }
    model = TorqueModel(fitted.arm, structure)
    regression = Regression(model, fit.regression.motions, fit.regression)
    start = IdentifiedModel(fitted, solution.parameters, solution.constants).carried_to(model).parameters
    regression.update_background(start, solution.constants)
    return regression, solution.constants


def _owners(regression: Regression) -> dict[int, set[int]]:
    """Parameter number -> joints in whose rows it has a column that no constant shapes."""
    owners: dict[int, set[int]] = {}
    for joint, rows in enumerate(regression.rows):
        for number in rows.indices:
            owners.setdefault(number, set()).add(joint)
    return owners


def _joint(
    regression: Regression,
    fit: Fit,
    joint: int,
    constants: FloatArray,
    shared: np.ndarray,
    scale: FloatArray,
    block_of: list[np.ndarray],
    blocks: int,
) -> _Joint:
    """One joint's columns, weighted, as Gram matrices by block."""
    rows, names = regression.rows[joint], regression.model.parameters
    places = {int(number): k for k, number in enumerate(shared)}
    common = np.zeros((len(rows.torque), len(shared)))
    columns: dict[str, tuple[FloatArray, float]] = {}
    for k, number in enumerate(rows.indices):
        if number in places:
            common[:, places[number]] = rows.fixed[:, k]
        else:
            columns[names[number].symbol] = rows.fixed[:, k], float(scale[number])
    for term, first, count in regression.shaped_terms():
        found = regression.shaped(term, constants[first : first + count]).get(joint)
        if found is None:
            continue
        if isinstance(regression.term(term), StribeckFriction):
            columns |= _friction_columns(regression, term, joint, constants[first : first + count], scale)
        else:
            columns |= {f"{names[n].name}": (column, float(scale[n])) for n, column in zip(found[0], found[1].T)}
    optional = {name for tag in ("00", "0d", "v0", "vd") for name in (f"f_c {tag}", f"f_b {tag}", f"mu {tag}")}
    optional |= {"offset", "k_v2", "k_v2_odd", "k_v3", "k_1"}
    residual = fit.residuals[joint]
    size = float(np.sqrt(np.mean(residual**2))) if len(residual) else 1.0
    weight = np.sqrt(fit.regression.rows[joint].trust)[:, None] / max(size, 1e-12)
    stacked = np.column_stack([common, *(column for column, _ in columns.values()), rows.torque]) * weight
    owner = rows.group(block_of)
    gram = np.stack([stacked[owner == block].T @ stacked[owner == block] for block in range(blocks)])
    own = {name: len(shared) + k for k, name in enumerate(columns)}
    ridge = np.zeros(gram.shape[1])
    for name, (_, width) in columns.items():
        ridge[own[name]] = 1.0 / width**2 if width > 0 else 1e12
    return _Joint(own, tuple(name for name in columns if name not in optional), gram, ridge, len(rows.torque))


def _friction_columns(
    regression: Regression, term: int, joint: int, constants: FloatArray, scale: FloatArray
) -> dict[str, tuple[FloatArray, float]]:
    """Coulomb, static and load columns, with and without what their constants add; f_b is relative to f_c."""
    stribeck, presliding, *rest = (float(value) for value in constants)
    columns: dict[str, tuple[FloatArray, float]] = {}
    for tag, shape in {"00": (0, 0), "0d": (0, presliding), "v0": (stribeck, 0), "vd": (stribeck, presliding)}.items():
        if ("v" in tag and stribeck <= 0) or ("d" in tag and presliding <= 0):
            continue
        numbers, shaped = regression.shaped(term, (*shape, *rest))[joint]
        columns[f"f_c {tag}"] = shaped[:, 0] + shaped[:, 1], float(scale[numbers[0]])
        columns[f"mu {tag}"] = shaped[:, 2], float(scale[numbers[2]])
        if "v" in tag:
            columns[f"f_b {tag}"] = shaped[:, 1], float(scale[numbers[1]])
    return columns
