"""`Trials`: held-out squares of any choice of optional terms, without going back to the rows.

The rows of every joint are cut into blocks of time, and each block is kept as the Gram matrix of its weighted columns,
the optional ones and the torque included. Any choice of terms, fitted to some blocks and judged on others, is then a
small linear problem: a joint's own columns are eliminated (Schur complement), the inertials that joints share are
solved for, and the squares left in a held-out block are a quadratic form (Golub and Van Loan 2013, ch. 5).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray
from ..dynamics.friction import StribeckFriction, ViscousFriction
from ..dynamics.model import IdentifiedModel, Structure, TorqueModel
from ..estimate.optional_terms import OptionalTerm
from ..noise.weights import common_correlation
from ..regression.held_out import folds_of, time_blocks
from ..regression.prior import Prior, make_prior
from ..regression.regression import Regression
from ..solvers.separable import Solution
from .fit import Fit
from .joint_terms import JointTerms, column

BLOCKS = 24
"""Most blocks of time: twice as many as a model as a whole is judged by, for what a single term does is confined to low
speeds, to reversals or to loads, which few long blocks tell apart. With 16, 32 or 48 the real arms fare alike."""
SETTLING = 3
"""Rounds in which the weights of the joints follow their residuals."""
RIDGE = 1e-9
"""Relative, on the diagonal: keeps an elimination regular where a joint has two equal columns."""
SEEN = 1e-14
"""Information that the data have of a combination of shared parameters, relative to the best known one, below which it
is rounding."""
TAGS = ("00", "0d", "v0", "vd")
"""Shapes of the columns of Stribeck friction, see `JointTerms.tag`."""
OPTIONAL = frozenset(
    {f"f_c {tag}" for tag in TAGS} | {column(term, tag) for term in OptionalTerm for tag in TAGS if term.row.symbol}
)
"""Names of the columns that not every law has."""


@dataclass
class _Joint:
    """Gram matrices of one joint: shared columns, own columns, torque.

    Attributes:
        own: Column name -> place; shared columns come first, the torque last.
        fixed: Names of the columns that every law has.
        gram: (blocks, c, c) of every block.
        rest: (folds + 1, c, c) of all blocks but those of a fold; the last of all blocks.
        ridge: (c,) what a column's prior adds to its square.
        rows: Number of rows.
    """

    own: dict[str, int]
    fixed: tuple[str, ...]
    gram: FloatArray
    rest: FloatArray
    ridge: FloatArray
    rows: int

    def combine(self, basis: FloatArray) -> None:
        """Put r combinations of the s shared columns in their place: (s, r)."""
        before, after = basis.shape
        new = after + self.gram.shape[1] - before
        way = np.zeros((self.gram.shape[1], new))
        way[:before, :after], way[before:, after:] = basis, np.eye(new - after)
        self.gram, self.rest = way.T @ self.gram @ way, way.T @ self.rest @ way
        self.own = {name: place + after - before for name, place in self.own.items()}
        self.ridge = np.r_[np.zeros(after), self.ridge[before:]]

    def scale(self, factor: float) -> None:
        """Weigh all rows by the root of a factor."""
        self.gram *= factor
        self.rest *= factor


@dataclass(frozen=True)
class _Eliminated:
    """A joint's part of the normal equations with its own columns solved for, by subset of the blocks (k of them).

    Attributes:
        own: (o,) places of its own columns.
        back: (k, o, s + 1) the way back to their values.
        normal: (k, s + 1, s + 1) what is left for the s shared parameters and the torque: the Schur complement.
    """

    own: np.ndarray
    back: FloatArray
    normal: FloatArray


class Trials:
    """Gram matrices by joint and block.

    Attributes:
        blocks: Number of blocks.
        folds: Number of folds that they are held out in.
        seen: Per joint, the optional terms that these data can show.
    """

    def __init__(self, fit: Fit) -> None:
        """Build the columns of every optional term beside those of a fitted model.

        Args:
            fit: Fitted with all terms of the paper's law; its constants shape the columns.
        """
        constants = fit.solution.constants
        regression = with_optional_terms(fit.regression, fit.solution, OptionalTerm)
        self._model, self.joints = regression.model, regression.model.arm.joint_names
        prior = make_prior(regression.model, regression.motions)
        # Parameters that have a column which no constant shapes in the rows of several joints.
        owners = Counter(number for rows in regression.rows for number in rows.indices)
        shared = np.array(sorted(number for number, joints in owners.items() if joints > 1), dtype=int)
        block_of, recording = time_blocks(regression.motions, BLOCKS)
        self.blocks = len(recording)
        folds = folds_of(recording)
        self.folds = len(folds)
        self._fold = np.empty(self.blocks, dtype=int)
        for number, fold in enumerate(folds):
            self._fold[fold] = number
        self._correlation = common_correlation([noise for joint in fit.noise for noise in joint])
        self._joints = [
            _joint(regression, fit, joint, constants, shared, prior.scale, block_of, folds)
            for joint in range(len(self.joints))
        ]
        self.seen = [
            frozenset(
                term for term in OptionalTerm if one.rows and one.own.keys() >= {*JointTerms(frozenset({term})).columns}
            )
            for one in self._joints
        ]
        self._expected = self._reduce_shared(prior, shared)
        self._shared = len(self._expected)
        self._known: dict[tuple[int, JointTerms], _Eliminated] = {}

    def _reduce_shared(self, prior: Prior, shared: np.ndarray) -> FloatArray:
        """Keep of the shared columns the combinations that move any torque: the prior alone decides on the others.

        Their unknowns are independent and of variance 1 under the prior.

        Args:
            prior: Of all parameters.
            shared: (s,) numbers of the shared ones.

        Returns:
            Their mean under the prior (r,).
        """
        rows = prior.rows[:, shared]
        root = np.linalg.cholesky(rows.T @ rows + RIDGE * np.eye(len(shared)))
        white = np.linalg.inv(root).T
        total = np.sum([joint.rest[-1, : len(shared), : len(shared)] for joint in self._joints], axis=0)
        sizes, directions = np.linalg.eigh(white.T @ total @ white)
        basis = white @ directions[:, sizes > SEEN * sizes.max(initial=0.0)]
        for joint in self._joints:
            joint.combine(basis)
        return np.asarray(basis.T @ (rows.T @ prior.target))

    def settle(self, laws: Sequence[JointTerms]) -> None:
        """Weight each joint by what these laws leave of it."""
        for _ in range(SETTLING):
            squares = self._squares(*self._solve(laws), np.full(self.blocks, self.folds)).sum(axis=0)
            for joint, left in zip(self._joints, squares):
                if joint.rows:
                    joint.scale(1.0 / max(left / joint.rows, 1e-12))
            self._known.clear()

    def held_out(self, laws: Sequence[JointTerms]) -> FloatArray:
        """(blocks, n) squares left in every block by a fit to the blocks of the other folds, in units of `settle`."""
        return self._squares(*self._solve(laws), self._fold)

    def values(self, laws: Sequence[JointTerms], joint: int) -> dict[str, float]:
        """Values of a joint's own columns, fitted to everything: column name -> value; `f_b` relative to `f_c`."""
        _, own = self._solve(laws)
        names = {place: name for name, place in self._joints[joint].own.items()}
        places, values = own[joint]
        return {names[int(place)]: float(value) for place, value in zip(places, values[-1])}

    def _solve(self, laws: Sequence[JointTerms]) -> tuple[FloatArray, list[tuple[np.ndarray, FloatArray]]]:
        """Fits to every subset of the blocks: all but one fold's, in turn, and at last all.

        Returns:
            (folds + 1, s) shared parameters, and per joint the places (o,) and values (folds + 1, o) of its own.
        """
        joints = [self._eliminated(number, law) for number, law in enumerate(laws)]
        normal = joints[0].normal.copy()
        for joint in joints[1:]:  # faster than the sum of a stack of them
            normal += joint.normal
        matrix = normal[:, :-1, :-1] + np.eye(self._shared)
        shared = np.asarray(np.linalg.solve(matrix, (normal[:, :-1, -1] + self._expected)[..., None]), dtype=float)
        return shared[..., 0], [
            (joint.own, joint.back[..., -1] - (joint.back[..., :-1] @ shared)[..., 0]) for joint in joints
        ]

    def _eliminated(self, number: int, law: JointTerms) -> _Eliminated:
        """One joint's part of the normal equations under a law; kept for the next time."""
        if (number, law) not in self._known:
            joint = self._joints[number]
            own = np.array([joint.own[name] for name in (*joint.fixed, *law.columns) if name in joint.own], dtype=int)
            outer = np.r_[np.arange(self._shared), joint.gram.shape[1] - 1]
            gram, diagonal = joint.rest / self._correlation, np.arange(len(own))
            inner, across = gram[:, own[:, None], own], gram[:, own[:, None], outer]
            inner[:, diagonal, diagonal] += joint.ridge[own] + RIDGE * gram[:, own, own]
            back = np.linalg.solve(inner, across)
            normal = gram[:, outer[:, None], outer] - across.transpose(0, 2, 1) @ back
            self._known[number, law] = _Eliminated(own, np.asarray(back), normal)
        return self._known[number, law]

    def _squares(self, shared: FloatArray, own: list[tuple[np.ndarray, FloatArray]], subset: np.ndarray) -> FloatArray:
        """(blocks, n) squares that fits of `_solve` leave, in every block those of the subset (blocks,) named."""
        left = np.zeros((self.blocks, len(self._joints)))
        for number, (joint, (places, values)) in enumerate(zip(self._joints, own)):
            vector = np.zeros((self.blocks, joint.gram.shape[1], 1))
            vector[:, : self._shared, 0], vector[:, places, 0], vector[:, -1] = shared[subset], values[subset], -1.0
            left[:, number] = ((joint.gram @ vector) * vector).sum(axis=(1, 2))
        return np.maximum(left, 0.0)


def with_optional_terms(regression: Regression, solution: Solution, terms: Iterable[OptionalTerm]) -> Regression:
    """The regression of a fitted model with the columns of optional terms beside those of the paper's law.

    Args:
        regression: Of the fitted model.
        solution: Its parameters and constants, which shape the columns.
        terms: Which, at all joints; both forms of quadratic friction are always among them.
    """
    fitted = regression.model
    structure: Structure = {**fitted.structure, ViscousFriction.kind: {"quadratic": "both"}}
    for term in terms:
        if term.beyond_law:
            kind = term.row.term.kind
            structure[kind] = {**structure.get(kind, {}), term.row.option: True}
    model = TorqueModel(fitted.arm, structure)
    full = Regression(model, regression.motions, regression)
    start = IdentifiedModel(fitted, solution.parameters, solution.constants).carried_to(model).parameters
    full.update_background(start, solution.constants)
    return full


def _joint(
    regression: Regression,
    fit: Fit,
    joint: int,
    constants: FloatArray,
    shared: np.ndarray,
    scale: FloatArray,
    block_of: list[np.ndarray],
    folds: Sequence[np.ndarray],
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
    residual = fit.residuals[joint]
    size = float(np.sqrt(np.mean(residual**2))) if len(residual) else 1.0
    weight = np.sqrt(fit.regression.rows[joint].trust)[:, None] / max(size, 1e-12)
    stacked = np.column_stack([common, *(column for column, _ in columns.values()), rows.torque]) * weight
    owner = rows.group(block_of)
    parts = [stacked[owner == block] for block in range(sum(len(fold) for fold in folds))]
    gram = np.stack([part.T @ part for part in parts])
    rest = np.stack([*(np.delete(gram, fold, axis=0).sum(axis=0) for fold in folds), gram.sum(axis=0)])
    own = {name: len(shared) + k for k, name in enumerate(columns)}
    ridge = np.zeros(gram.shape[1])
    for name, (_, width) in columns.items():
        ridge[own[name]] = 1.0 / width**2 if width > 0 else 1e12
    return _Joint(own, tuple(name for name in columns if name not in OPTIONAL), gram, rest, ridge, len(rows.torque))


def _friction_columns(
    regression: Regression, term: int, joint: int, constants: FloatArray, scale: FloatArray
) -> dict[str, tuple[FloatArray, float]]:
    """Coulomb, static and load columns, with and without what their constants add; f_b is relative to f_c."""
    stribeck, presliding, *rest = (float(value) for value in constants)
    columns: dict[str, tuple[FloatArray, float]] = {}
    for tag in TAGS:
        shape = stribeck * ("v" in tag), presliding * ("d" in tag)
        if ("v" in tag and stribeck <= 0) or ("d" in tag and presliding <= 0):
            continue
        numbers, shaped = regression.shaped(term, (*shape, *rest))[joint]
        columns[f"f_c {tag}"] = shaped[:, 0] + shaped[:, 1], float(scale[numbers[0]])
        columns[f"mu {tag}"] = shaped[:, 2], float(scale[numbers[2]])
        if "v" in tag:
            columns[f"f_b {tag}"] = shaped[:, 1], float(scale[numbers[1]])
    return columns
