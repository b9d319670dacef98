"""`Identified`: the estimate, how well it is known, and what determined it. Plain results, no computation."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from ..arrays import FloatArray
from ..dynamics.base_parameters import BaseParameters
from ..dynamics.model import IdentifiedModel
from ..signals.bandwidth import Bandwidth
from .coupling import CouplingTrial
from .environment import Environment
from .optional_terms import OptionalTerm

GAIN_DEVIATION = 0.07
"""Relative standard deviation of a joint's torque gain (torque constant times ratio, or a sensor's) before anything is
known of it. Stated, not measured on the arm at hand: published torque constants of a UR10e are 8 to 10 % off, and data
sheets of motors give tolerances of 5 to 10 %."""


class Determination(Enum):
    """What a parameter's value rests on."""

    DATA = "determined by the data"
    COMBINED = "known only in a combination"
    BOUND = "at a bound"
    PRIOR = "from the prior"
    FIXED = "held fixed"


@dataclass(frozen=True)
class Estimate:
    """One parameter or constant.

    Attributes:
        symbol, joint, unit: What it is.
        value: In `unit`.
        standard_error: Same unit; NaN where the data say nothing about it by itself.
        determination: What the value rests on.
        note: Base parameter it is part of, which bound it is at, ... ; may be empty.
        factor: Half width of the 95 % interval in standard errors: Student's where few data decided.
        gain_error: What the torque gains' own uncertainty adds, one standard deviation (`torque_gain.py`); same unit,
            NaN where it was not asked for. It is not in `standard_error`, which is for the torque as recorded.
    """

    symbol: str
    joint: str
    unit: str
    value: float
    standard_error: float
    determination: Determination
    note: str = ""
    factor: float = 1.959964
    gain_error: float = float("nan")

    @property
    def name(self) -> str:
        """`f_c[joint_1]`."""
        return f"{self.symbol}[{self.joint}]"

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval; NaN, NaN where there is no standard error."""
        half = self.factor * self.standard_error
        return (self.value - half, self.value + half)

    @property
    def interval_with_gain(self) -> tuple[float, float]:
        """95 % interval that includes the torque gains' uncertainty; NaN, NaN where that or the standard error is."""
        half = self.factor * math.hypot(self.standard_error, self.gain_error)
        return (self.value - half, self.value + half)

    @property
    def identifiable(self) -> bool:
        """Whether the data determine it by itself."""
        return self.determination is Determination.DATA


@dataclass(frozen=True)
class Choice:
    """One decision about the structure of the model, with its evidence.

    Attributes:
        term: What was considered, in words, such as `friction that grows with the load at elbow_joint`.
        gain: What it brings when everything is fitted again: mean drop of the squares of held-out blocks over its
            standard error (t); in the base model of a mismatch, drop in weighted squares (chi-square units).
        accepted: Whether it joined the model.
        kind: Which term; None: of a result that does not say.
        joint: Where; empty: at all joints.
    """

    term: str
    gain: float
    accepted: bool
    kind: OptionalTerm | None = None
    joint: str = ""


@dataclass(frozen=True)
class Move:
    """What an update made of one parameter or constant of its prior.

    Attributes:
        name, unit: What it is.
        before, spread: Prior mean and standard deviation, room for changes since included.
        after, standard_error: Posterior.
        variance_reduction: Share of the prior's variance that the data took away: 0 is all prior, 1 all data.
    """

    name: str
    unit: str
    before: float
    spread: float
    after: float
    standard_error: float
    variance_reduction: float

    @property
    def deviations(self) -> float:
        """How far it moved, in standard deviations of the prior."""
        return (self.after - self.before) / self.spread


@dataclass(frozen=True)
class BaseBody:
    """What a free base's momentum balance says of the body that carries the arm.

    Attributes:
        estimates: Its ten inertial parameters about the base link's frame, as the arm's own values have them.
        combined: What the data determine of it: base parameters that one of the ten leads.
    """

    estimates: tuple[Estimate, ...]
    combined: tuple[Estimate, ...]


@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Attributes:
        model: Structure and values: physically consistent, ready to predict.
        estimates: Every linear parameter and constant, in the model's order: parameters, then constants.
        base: Regrouping into base parameters.
        base_values: (b,) estimates of the base parameters, before physical consistency is imposed.
        base_errors: (b,) their standard errors.
        covariance: (p + c, p + c) of parameters and constants (zero rows for constants that were not searched).
        consistency_shift: Largest move of a base parameter, in its standard errors, that imposing physical
            consistency took (0: the data's estimate was consistent by itself).
        residual_sigma_Nm: (n,) residual per joint on the fitted rows.
        rows: (n,) regression rows per joint.
        bandwidth: Low-pass that torque and regressor went through.
        choices: Decisions about the structure.
        solver: How the solver ended, in words.
        joints_at_rest: Joints that were never seen to move: nothing is known of their friction.
        joints_unresolved: Those of them whose positions do move, at a speed that is lost in the noise.
        notes: Further things a user should know.
        environment: Vacuum or air, gravity, temperatures.
        moves: What was updated since the prior model, those of an update that have a spread; else empty.
        base_body: The body that carries the arm, where its motion was recorded and nothing else holds it.
        coupling: Whether a motor that turns with the last two joints was tried, and what it brought.
    """

    model: IdentifiedModel
    estimates: tuple[Estimate, ...]
    base: BaseParameters
    base_values: FloatArray
    base_errors: FloatArray
    covariance: FloatArray
    consistency_shift: float
    residual_sigma_Nm: FloatArray
    rows: np.ndarray
    bandwidth: Bandwidth
    choices: tuple[Choice, ...] = ()
    solver: str = ""
    joints_at_rest: tuple[str, ...] = ()
    joints_unresolved: tuple[str, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)
    environment: Environment = field(default_factory=Environment)
    moves: tuple[Move, ...] = ()
    base_body: BaseBody | None = None
    coupling: CouplingTrial | None = None


@dataclass(frozen=True)
class Fit:
    """How well a prediction meets a measurement, over some rows of one joint.

    Attributes:
        rows: Rows compared.
        rmse, mae, largest: N·m.
        correlation: Pearson's R (NaN where nothing varies).
        relative_rms: Residual RMS over torque RMS (NaN where there is no torque).
    """

    rows: int
    rmse: float
    mae: float
    largest: float
    correlation: float
    relative_rms: float


@dataclass(frozen=True)
class LackOfFit:
    """F test of the repeatable residual against the scatter between periods.

    Attributes:
        f: Ratio of mean squares; about 1 when the model leaves nothing repeatable out.
        p_value: Probability of so large a ratio under a right model.
        noise_Nm: Pure error of a row.
    """

    f: float
    p_value: float
    noise_Nm: float


@dataclass(frozen=True)
class JointValidation:
    """One joint's validation.

    Attributes:
        everything: All rows, up to the cut-off of the fit.
        moving: Rows while the joint moves, up to the cut-off.
        unfiltered: All samples as recorded.
        lack_of_fit: Where it can be tested.
        unfiltered_moving: Samples as recorded while the joint moves; None in results of earlier versions.
    """

    everything: Fit
    moving: Fit
    unfiltered: Fit
    lack_of_fit: LackOfFit | None = None
    unfiltered_moving: Fit | None = None


@dataclass(frozen=True)
class Trace:
    """Signals behind a validation, for figures: regression rows of one motion, columns in the order of the arm.

    Attributes:
        source: Which recording (its name).
        time: (M,) s.
        position, velocity: (M, n) rad, rad/s.
        measured, predicted: (M, n) N·m.
        moving: (M, n).
    """

    source: str
    time: FloatArray
    position: FloatArray
    velocity: FloatArray
    measured: FloatArray
    predicted: FloatArray
    moving: np.ndarray


@dataclass(frozen=True)
class Spectrum:
    """One-sided power spectral densities of unfiltered validation signals, at logarithmically spaced frequencies.

    Attributes:
        frequency: (F,) Hz, increasing.
        torque: (F, n) of the measured torque, (N·m)²/Hz or N²/Hz.
        residual: (F, n) of measured minus predicted torque, same units.
    """

    frequency: FloatArray
    torque: FloatArray
    residual: FloatArray


@dataclass(frozen=True)
class Validation:
    """How the model predicts data.

    Attributes:
        joints: Joint name -> figures.
        traces: Signals, one entry a motion.
        what: What it was validated on, in words: other recordings, or a stated hold-out.
        held_out: Whether the fit had not seen these data.
        spectrum: Of torque and residual; None where the signals are too short, or in results of earlier versions.
    """

    joints: dict[str, JointValidation]
    traces: tuple[Trace, ...]
    what: str
    held_out: bool
    spectrum: Spectrum | None = None
