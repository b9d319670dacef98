"""The closed loop behind a recording: what the arm was told, and how stiffly its drives held it to that.

A recording does not hold the controller. What of it shows in the motion is told apart here:

- *Tracking.* Any linear controller makes the arm follow its commands through a linear filter, and fall short of them in
  proportion to the torque. Lag, feedforward and droop under smooth torque are therefore fitted, joint by joint, as a
  short filter of the command and a share of the model's torque. The noise of the positions is in what is fitted and not
  in what it is fitted by, so it averages out. A delay of the measured positions looks like lag, and stays.
- *Droop under dry friction* is no linear filter of anything: it comes with the sign of the velocity, and at reversals
  the arm sticks until the loop has built up torque. It is simulated (`simulated_loop.py`), and how large the recorded
  one is beside the simulated one says how stiff the recorded loop was.

Without commands, or with some that the arm did not follow, the reference is the recorded motion itself, droop and all,
low-passed with zero phase, and the loop is so stiff that nothing is added. Noise slower than that low-pass stays in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import butter, sosfiltfilt

from ..arrays import FloatArray
from ..dynamics.friction import StribeckFriction
from ..dynamics.model import TorqueModel
from ..recording.recording import Recording
from .simulated_loop import follow, sampled

SIMULATION_HZ = 1000.0
RECORDED_SHARE = 0.5
"""Low-pass of a reference made of recorded positions, over the bandwidth of the fit."""
SHIFTS_S = np.arange(-0.02, 0.1601, 0.02)
"""Reach of the filter from command to motion: a position loop of 6 Hz forgets within."""
LARGEST_MISS = 0.02
"""Share of a joint's motion that the commands may leave unexplained, or they are not what it followed."""
FITTED_SAMPLES = 20_000
"""Stamps that the filter is fitted to, at most twice as many."""
BANDWIDTHS_HZ = (3.0, 250.0)
LARGEST_CHANGE = 4.0
"""Factor by which a bandwidth changes at once."""


class RecordedLoop:
    """One recording's closed loop, simulated again and again.

    Attributes:
        bandwidth_hz: (n,) of each joint's loop.
        commanded: Whether the reference is what was commanded.
    """

    def __init__(self, model: TorqueModel, recording: Recording, cutoff_hz: float, bandwidth_hz: float) -> None:
        """Find what the arm was told.

        Args:
            model: Whose arm it is.
            recording: With the joints of the arm.
            cutoff_hz: Bandwidth of the fit.
            bandwidth_hz: Of all joints' loops, to begin with.
        """
        self._model = model
        self._recording = recording.in_order(model.arm.joint_names)
        command = _command(self._recording)
        self._stretches = [
            (segment, _Stretch(self._recording.time[segment], self._recording.position[segment], command, cutoff_hz))
            for segment in self._recording.segments
            if segment.stop - segment.start >= max(32, self._recording.rate_hz)
        ]
        self.commanded = all(stretch.commanded for _, stretch in self._stretches)
        first_hz = bandwidth_hz if self.commanded else BANDWIDTHS_HZ[1]
        self.bandwidth_hz = np.full(len(model.arm.joints), first_hz)

    def simulate(self, parameters: FloatArray, constants: FloatArray) -> Recording:
        """The recording with the positions of a simulated arm of these (p,) parameters and (c,) constants.

        Each joint's loop is first made as stiff as the recorded one, going by the droop of the simulation before.
        """
        references = [stretch.reference() for _, stretch in self._stretches]
        _, share = max(references, key=lambda found: len(found[0]))
        share = np.clip(share, LARGEST_CHANGE**-2, LARGEST_CHANGE**2)
        self.bandwidth_hz = np.clip(self.bandwidth_hz / np.sqrt(share), *BANDWIDTHS_HZ)
        position = self._recording.position.copy()
        for (segment, stretch), (reference, _) in zip(self._stretches, references):
            position[segment] = stretch.simulate(self._model, parameters, constants, reference, self.bandwidth_hz)
        return replace(self._recording, position=position, velocity=None)


def _command(recording: Recording) -> BSpline | None:
    """The commands as a function of time, where there are enough of them."""
    if recording.command is None:
        return None
    sound = np.isfinite(recording.command.values).all(axis=1)
    time, first = np.unique(recording.command.time[sound], return_index=True)
    return make_interp_spline(time, recording.command.values[sound][first], k=3) if len(time) >= 8 else None


class _Stretch:
    """An uninterrupted part of a recording, and its simulation on an even grid."""

    def __init__(self, time: FloatArray, position: FloatArray, command: BSpline | None, cutoff_hz: float) -> None:
        self._time, self._position, self._command, self._cutoff_hz = time, position, command, cutoff_hz
        self._grid = time[0] + np.arange(int((time[-1] - time[0]) * SIMULATION_HZ) + 2) / SIMULATION_HZ
        self._droop: FloatArray | None = None
        self._torque: FloatArray | None = None
        self.commanded = command is not None and self._followed()

    def simulate(
        self,
        model: TorqueModel,
        parameters: FloatArray,
        constants: FloatArray,
        reference: FloatArray,
        bandwidth_hz: FloatArray,
    ) -> FloatArray:
        """(N, n) positions at the stamps of the simulated arm, told to follow `reference` (K, n)."""
        joints = model.arm.joint_names
        reached = follow(model, parameters, constants, sampled(joints, SIMULATION_HZ, reference), bandwidth_hz)
        self._droop = reached - reference
        if self.commanded:
            # Along the smoothed command, not the reference: of that the torque is a part, and would feed on itself.
            told = sampled(joints, SIMULATION_HZ, _smooth(self._told(self._grid, np.zeros(1))[0], self._cutoff_hz))
            smooth = tuple(kind for kind in model.structure if kind != StribeckFriction.kind)
            self._torque = model.torque(told, parameters, constants, smooth)
        return self._at_stamps(reached)

    def reference(self) -> tuple[FloatArray, FloatArray]:
        """What the arm was told.

        Returns:
            (K, n) positions on the grid, without the droop; (n,) the recorded droop over the last simulation's, 1 where
            there was none.
        """
        if self.commanded:
            return self._from_commands()
        even = make_interp_spline(self._time, self._position, k=3)(np.minimum(self._grid, self._time[-1]))
        return _smooth(even, RECORDED_SHARE * self._cutoff_hz), np.ones(self._position.shape[1])

    def _followed(self) -> bool:
        """Whether every joint went where it was told."""
        missed = (self._position - self._at_stamps(self._from_commands()[0])).std(axis=0)
        moved = self._position.std(axis=0)
        return bool((missed < LARGEST_MISS * np.maximum(moved, 0.01 * moved.max())).all())

    def _from_commands(self) -> tuple[FloatArray, FloatArray]:
        thin = slice(None, None, max(1, len(self._time) // FITTED_SAMPLES))
        shifts = np.concatenate([[0.0], SHIFTS_S])
        fitted, grid = self._told(self._time[thin], shifts), self._told(self._grid, shifts)
        loads = [signal for signal in (self._torque, self._droop) if signal is not None]
        at_stamps = [self._at_stamps(signal)[thin] for signal in loads]
        reference, share = grid[0].copy(), np.ones(grid.shape[2])
        for joint in range(len(share)):
            matrix = _columns(fitted, at_stamps, joint)
            scale = np.linalg.norm(matrix, axis=0) + 1e-12
            behind = self._position[thin, joint] - fitted[0, :, joint]
            found = np.linalg.lstsq(matrix / scale, behind, rcond=1e-6)[0] / scale
            if self._droop is not None:
                # What dry friction holds the arm back by is for the simulation to say.
                share[joint], found[-1] = found[-1], 0.0
            reference[:, joint] += _columns(grid, loads, joint) @ found
        return reference, share

    def _at_stamps(self, on_grid: FloatArray) -> FloatArray:
        return np.asarray(make_interp_spline(self._grid, on_grid, k=3)(self._time))

    def _told(self, time: FloatArray, shifts: FloatArray) -> FloatArray:
        """(s, T, n) the command at times (T,) less each of the shifts (s,), s; held outside its span."""
        assert self._command is not None
        shifted = time - shifts[:, None]
        return np.asarray(self._command(np.clip(shifted, self._command.t[0], self._command.t[-1])))


def _columns(told: FloatArray, loads: Sequence[FloatArray], joint: int) -> FloatArray:
    """(T, 1 + s + l) offset, shifted commands less the command told[0], and the loads (T, n) on a joint."""
    shifted = (told[1:, :, joint] - told[0, :, joint]).T
    return np.column_stack([np.ones(told.shape[1]), shifted, *(load[:, joint] for load in loads)])


def _smooth(signal: FloatArray, low_pass_hz: float) -> FloatArray:
    """(K, n) a signal on the simulation's grid without its fast part, zero phase."""
    low_pass = butter(4, low_pass_hz, fs=SIMULATION_HZ, output="sos")
    padding = min(len(signal) - 1, int(2 * SIMULATION_HZ / low_pass_hz))
    return np.asarray(sosfiltfilt(low_pass, signal, axis=0, padlen=padding))
