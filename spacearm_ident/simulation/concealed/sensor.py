"""Concealed faults of sensors and clocks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi

from spacearm_ident.arrays import FloatArray
from spacearm_ident.simulation.concealed.effect import Effect, Parameter

if TYPE_CHECKING:
    from spacearm_ident.simulation.closed_loop import Truth


class EncoderEccentricity(Effect):
    """The encoder's disc sits off its axis: the angle shown is wrong by amplitude·sin(cycles·angle + phase)."""

    name = "encoder_eccentricity"
    parameters: ClassVar = {
        "amplitude": Parameter("rad", 1e-4, 2e-2),
        "cycles": Parameter("1/rev", 1.0, 64.0, 1.0),
        "phase": Parameter("rad", -np.pi, np.pi, 0.0),
    }

    def encoder(self, position: FloatArray) -> FloatArray:
        """As shown; the drive believes it."""
        shown = position.copy()
        angle = position[..., self.joints]
        shown[..., self.joints] += self.values["amplitude"] * np.sin(
            self.values["cycles"] * angle + self.values["phase"]
        )
        return shown


class TimeDelay(Effect):
    """Torque reaches the recording `delay` seconds after the motion it belongs to, alike for all joints.

    Law `early`: the motion is late instead.
    """

    name = "time_delay"
    parameters: ClassVar = {"delay": Parameter("s", 1e-3, 12e-3)}
    laws = ("usual", "early")
    joints_needed = 0

    def reported(self, truth: Truth) -> Truth:
        """The torque of another moment."""
        delay = self.one("delay") * (-1.0 if self.law == "early" else 1.0)
        wanted = np.clip(truth.time - delay, truth.time[0], truth.time[-1])
        # Linear between samples: a spline would ring at reversals.
        columns = [np.interp(wanted, truth.time, column) for column in truth.torque.T]
        return replace(truth, torque=np.column_stack(columns))


class FilterLag(Effect):
    """The drive smooths the torque it reports: first order, law `second_order`: second, of the corner `corner`."""

    name = "filter_lag"
    parameters: ClassVar = {"corner": Parameter("Hz", 4.0, 80.0)}
    laws = ("usual", "second_order")

    def reported(self, truth: Truth) -> Truth:
        """Smoothed, in the steady state at the start."""
        rate = 1.0 / float(np.median(np.diff(truth.time)))
        torque = truth.torque.copy()
        for joint, corner in zip(self.joints, self.values["corner"], strict=True):
            sos = butter(2 if self.law == "second_order" else 1, corner, fs=rate, output="sos")
            torque[:, joint] = sosfilt(sos, torque[:, joint], zi=sosfilt_zi(sos) * torque[0, joint])[0]
        return replace(truth, torque=torque)
