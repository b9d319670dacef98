"""The Gaussian prior of the parameters, as further rows of the least-squares problem.

The prior mean of a parameter is its CAD value, zero, or the parameter it is anchored to; the standard deviation is its
scale. Where the data determine a parameter, the prior is negligible. Where they do not, the estimate is the one nearest
to the prior mean, and its standard deviation stays at the scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import FloatArray
from ..dynamics.model import TorqueModel
from ..dynamics.regressor import INERTIAL_SYMBOLS
from ..dynamics.term import Parameter
from ..signals.motion import Motion

WIDENING = 2.0
"""Factor on every scale, since scales are orders of magnitude: the prior is rather too weak than too strong. Chosen."""


@dataclass(frozen=True)
class Prior:
    """Independent Gaussian priors `rows @ x ~ N(target, 1)` of the free parameters.

    Attributes:
        rows: (f, p), one row a free parameter, in units of its scale.
        target: (f,).
        scale: (p,) standard deviation of each parameter before the data; 0 where held.
        held: (p,) values of the parameters that are not estimated (and prior means of the others).
        free: (f,) numbers of the parameters to estimate.
        cad_scale: Factor on the scales of the inertials, as of `make_prior`.
    """

    rows: FloatArray
    target: FloatArray
    scale: FloatArray
    held: FloatArray
    free: np.ndarray
    cad_scale: float = 1.0

    @cached_property
    def _fixed(self) -> np.ndarray:
        """Numbers of the parameters that are not estimated."""
        return np.setdiff1d(np.arange(len(self.held)), self.free)

    def fixed_part(self, matrix: FloatArray) -> FloatArray:
        """(r,) what the parameters that are not estimated contribute to a system's rows (r, p or more)."""
        return np.asarray(matrix[:, self._fixed] @ self.held[self._fixed])


def make_prior(model: TorqueModel, motions: Sequence[Motion], cad_scale: float = 1.0) -> Prior:
    """The prior of a model, with scales from the sizes of torque and motion in the data.

    Args:
        model: Terms and their parameters.
        motions: Those of the fit; the sizes of torque and motion give the scales.
        cad_scale: Factor on the scales of the links' inertials. The last link's stay as they are: what the arm carries
            is part of it, and CAD need not have it.
    """
    size = _Sizes(motions)
    parameters = model.parameters
    scale = np.array([WIDENING * size.scale(parameter) for parameter in parameters])
    from_cad = [one.symbol in INERTIAL_SYMBOLS and one.joint in model.arm.joint_names[:-1] for one in parameters]
    scale *= np.where(from_cad, cad_scale, 1.0)
    numbers = {parameter.name: k for k, parameter in enumerate(parameters)}
    free = np.flatnonzero(scale > 0)
    rows = np.zeros((len(free), len(parameters)))
    target = np.empty(len(free))
    for row, k in enumerate(free):
        parameter = parameters[k]
        rows[row, k] = 1.0 / scale[k]
        target[row] = parameter.prior / scale[k]
        if parameter.anchor is not None:
            rows[row, numbers[f"{parameter.anchor}[{parameter.joint}]"]] = -1.0 / scale[k]
    held = np.array([parameter.prior for parameter in parameters])
    return Prior(rows, target, scale, held, free, cad_scale)


class _Sizes:
    """Sizes of torque, position, velocity and acceleration in the data, joint by joint."""

    def __init__(self, motions: Sequence[Motion]) -> None:
        self.joints = motions[0].joints
        self.torque = _largest_rms([motion.torque_rows for motion in motions])
        self.torque = np.maximum(self.torque, 1e-3 * self.torque.max())
        self.position = _largest_rms([motion.position for motion in motions])
        self.velocity = np.max([np.abs(motion.velocity).max(axis=0) for motion in motions], axis=0)
        self.acceleration = _largest_rms([motion.acceleration for motion in motions])

    def scale(self, parameter: Parameter) -> float:
        if parameter.held:
            return 0.0
        if parameter.scale is not None:
            return parameter.scale
        known = parameter.joint in self.joints
        which = self.joints.index(parameter.joint) if known else slice(None)
        size = float(np.mean(self.torque[which]))
        for power, signal in zip(parameter.dimension, (self.position, self.velocity, self.acceleration)):
            if power:
                size /= max(float(np.mean(signal[which])), 1e-3 * float(signal.max()), 1e-12) ** power
        return size


def _largest_rms(signals: Sequence[FloatArray]) -> FloatArray:
    """(n,) largest RMS of each column over several recordings."""
    return np.asarray(np.max([np.sqrt(np.mean(signal**2, axis=0)) for signal in signals], axis=0))
