"""`TrackingStream`: raw messages in, changes of the arm and its followed parameters out, dated as the messages are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..dynamics.model import IdentifiedModel
from ..recording import cdr, messages
from ..tracking.rows import RowStream, TrackedModel
from ..tracking.tracker import Change, Tracker, TrackingSettings, TrackingState
from .joint_samples import JointSamples


@dataclass(frozen=True)
class TrackingChoice:
    """What a user wants followed beside the friction levels, and how long what was learned is kept (moving time)."""

    payload: bool = False
    temperature: bool = False
    memory_s: float = 60.0


class TrackingStream:
    """A `Tracker` of one model over streams of messages.

    All times are those of the messages' stamps, in s since 1970.

    Args:
        model: Model with values.
        choice: What to follow.
    """

    def __init__(self, model: IdentifiedModel, choice: TrackingChoice) -> None:
        self._tracked = TrackedModel(model, choice.payload, choice.temperature)
        self._tracker = Tracker(self._tracked, TrackingSettings(memory_s=choice.memory_s))
        self._samples = JointSamples(self._tracked.joints, model.model.arm.effort_scale)
        self._rows: RowStream | None = None
        self._taken = 0
        self._newest_s = float("nan")
        # NaN until a joint has told: its friction is then as if no temperature were known.
        self._temperature = np.full(len(self._tracked.joints), np.nan)

    def add(self, payloads: Sequence[bytes], temperatures: Sequence[bytes] = ()) -> list[Change]:
        """Take messages in the order of arrival; returns the changes they made sure.

        Args:
            payloads: Joint states.
            temperatures: Joint temperatures that came meanwhile.
        """
        for payload in temperatures:
            self._hear_temperature(payload)
        samples = self._samples.take(payloads)
        if samples is None:
            return []
        if self._rows is None:
            self._rows = RowStream(self._tracked, self._samples.rate_hz)
        self._taken += len(samples.time)
        self._newest_s = float(samples.time[-1])
        parts = self._rows.add(samples.time, samples.position, samples.effort, self._temperature)
        found = [change for rows in parts for change in self._tracker.add(rows)]
        return [
            replace(
                change,
                time_s=self._epoch_s + change.time_s,
                earliest_s=self._epoch_s + change.earliest_s,
                found_s=self._epoch_s + change.found_s,
            )
            for change in found
        ]

    def _hear_temperature(self, payload: bytes) -> None:
        try:
            _, joint, celsius = cdr.decode_temperature(payload)
        except cdr.CdrError:
            return
        least, most = messages.TEMPERATURES_C
        if joint in self._tracked.joints and least <= celsius <= most:
            self._temperature[self._tracked.joints.index(joint)] = celsius

    @property
    def _epoch_s(self) -> float:
        return self._samples.epoch_ns / 1e9

    @property
    def newest_s(self) -> float:
        """Stamp of the last sample taken; NaN before the first."""
        return self._epoch_s + self._newest_s

    @property
    def data_s(self) -> float:
        """Length of the data taken, s, gaps not counted."""
        return self._taken / self._samples.rate_hz if self._taken else 0.0

    def state(self) -> TrackingState:
        """What is known now."""
        state = self._tracker.state()
        return replace(state, time_s=self._epoch_s + state.time_s)

    def figures(self) -> dict[str, object]:
        """For `/diagnostics`: how the stream stands; empty before the first samples."""
        if self._rows is None:
            return {}
        known = int(np.isfinite(self._temperature).sum())
        return {
            "rate_Hz": self._samples.rate_hz,
            "row_rate_Hz": self._rows.stream.row_rate_hz,
            "delay_s": self._rows.stream.delay_s,
            "restarts": self._rows.stream.restarts,
            "messages_left_out": self._samples.left_out,
            "temperatures": f"{known} of {len(self._temperature)}",
        }
