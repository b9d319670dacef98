"""`LiveTracking`: what the identifier knows of its arm as it is now; what to say of it, and when to look closer.

It feeds a `TrackingThread` and keeps what that finds: the followed parameters, the changes, and, where a change is to
be explained, the stretch of joint states behind the first one (`ChangeWindow`).
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from datetime import UTC, datetime

from ..dynamics.model import IdentifiedModel
from ..tracking.tracker import Change, TrackingState
from .runtime import Level, Status
from .tracking_stream import TrackingChoice, TrackingStream
from .tracking_thread import Broken, TrackingThread

WARN_S = 60.0
"""A change is a warning for so long after it was found; then it is history, and still told."""
PUBLISH_S = 1.0
LONGEST_MARKS = 8192
PART = "tracking"


class LiveTracking:
    """On-line tracking of one model.

    Args:
        model: Model with values.
        choice: What to follow.
        window_s: Length of the stretch behind a change that is to be explained; None: none is.
        before: Tracking of the model before: the changes it found stay said.
    """

    def __init__(
        self,
        model: IdentifiedModel,
        choice: TrackingChoice,
        window_s: float | None = None,
        before: LiveTracking | None = None,
    ) -> None:
        self._thread = TrackingThread(TrackingStream(model, choice))
        self._window = None if window_s is None else ChangeWindow(window_s)
        self._changes: list[Change] = [] if before is None else list(before._changes)
        self._warn_until: float = float("-inf") if before is None else before._warn_until
        self._published = float("-inf")
        self._figures: dict[str, object] = {}
        self._broken = self._given_up = ""
        self._told_s = float("nan")
        self.state: TrackingState | None = None

    def feed(self, payloads: Sequence[bytes], temperatures: Sequence[bytes], arrived_ns: int) -> None:
        """Hand over joint states and temperatures in the order of arrival.

        Args:
            payloads: Joint states since the last call, CDR.
            temperatures: Temperatures since the last call, CDR.
            arrived_ns: When the last joint state arrived, ns.
        """
        if (payloads or temperatures) and not self._broken:
            self._thread.feed(payloads, temperatures, arrived_ns)

    def poll(self) -> list[Change]:
        """Changes found since the last time."""
        found: list[Change] = []
        for news in self._thread.poll():
            if isinstance(news, Broken):
                self._broken = news.reason
                self._give_up(news.reason)
                continue
            self.state, self._figures = news.state, dict(news.figures)
            found += news.changes
            if self._window is not None and self._window.add(news.newest_s, news.arrived_ns, news.changes):
                self._given_up = "the clock of the joint states was set back"
        if found:
            self._changes += found
            self._warn_until = time.monotonic() + WARN_S
            self._published = float("-inf")
        return found

    def due(self) -> TrackingState | None:
        """The state, where it is time to publish it: once a second while rows come, and after a change at once."""
        state, now = self.state, time.monotonic()
        if state is None or not state.time_s > 0 or state.time_s == self._told_s or now < self._published + PUBLISH_S:
            return None
        self._published, self._told_s = now, state.time_s
        return state

    def to_explain(self) -> tuple[int, int] | None:
        """Times of arrival between which the joint states behind a change lie, once there are enough; told once."""
        return None if self._window is None else self._window.take()

    @property
    def last_change(self) -> Change | None:
        """The change found last."""
        return self._changes[-1] if self._changes else None

    def given_up(self) -> str:
        """Why a change that was to be explained will not be; told once, empty where there is none."""
        reason, self._given_up = self._given_up, ""
        return reason

    def _give_up(self, reason: str) -> None:
        if self._window is not None and self._window.drop():
            self._given_up = reason

    def status(self) -> Status:
        """For `/diagnostics`."""
        if self._broken:
            return Status(Level.ERROR, f"{self._broken}; it restarts with the next model", self._figures, PART)
        if self.state is None and not self._changes:
            return Status(Level.OK, "waiting for joint states", part=PART)
        parameters = () if self.state is None else self.state.parameters
        figures: dict[str, object] = {
            "changes": len(self._changes),
            "informed": f"{sum(item.informed for item in parameters)} of {len(parameters)}",
            "blocks_left_out": self._thread.blocks_left_out,
            **self._figures,
        }
        if not self._changes:
            return Status(Level.OK, "follows; no change so far", figures, PART)
        last = self._changes[-1]
        fresh = time.monotonic() < self._warn_until
        message = f"{'' if fresh else 'follows; the last change: '}{sentence(last)}"
        return Status(Level.WARN if fresh else Level.OK, message, figures | _figures(last), PART)

    def stop(self, reason: str) -> None:
        """End the thread; `reason` is why a change that waits for its explanation has none (`given_up`)."""
        self._give_up(reason)
        self._thread.stop()


class ChangeWindow:
    """From stamps of changes to times of arrival: the stretch that begins with a change and is `length_s` long.

    Changes within a stretch that another has begun are part of it. The stretch begins with the first block that lies
    behind the change as a whole.
    """

    def __init__(self, length_s: float) -> None:
        self._length_s = length_s
        self._marks: deque[tuple[float, int]] = deque(maxlen=LONGEST_MARKS)
        self._from_s: float | None = None

    def add(self, newest_s: float, arrived_ns: int, changes: Sequence[Change]) -> bool:
        """Note a block of joint states and the changes found in it; returns whether a stretch was dropped.

        Args:
            newest_s: Stamp of the last joint state of the block, s since 1970.
            arrived_ns: When that joint state arrived, ns.
            changes: Changes found in the block.
        """
        dropped = False
        if self._marks and newest_s < self._marks[-1][0]:
            # The clock was set back: what it showed before says nothing of what it shows now.
            self._marks.clear()
            dropped = self.drop()
        self._marks.append((newest_s, arrived_ns))
        if changes and self._from_s is None:
            self._from_s = min(change.time_s for change in changes)
        return dropped

    def drop(self) -> bool:
        """Forget the stretch that has begun; returns whether there was one."""
        begun, self._from_s = self._from_s is not None, None
        return begun

    def take(self) -> tuple[int, int] | None:
        """First and last time of arrival, ns, of a stretch that is complete; told once."""
        if self._from_s is None or self._marks[-1][0] < self._from_s + self._length_s:
            return None
        start, stop = (
            next(arrived_ns for newest_s, arrived_ns in self._marks if newest_s >= stamp_s)
            for stamp_s in (self._from_s, self._from_s + self._length_s)
        )
        self._from_s = None
        return start + 1, stop


def sentence(change: Change) -> str:
    """A change, for a person."""
    moment = datetime.fromtimestamp(change.time_s, UTC).isoformat(timespec="milliseconds")
    also = f"; or {', '.join(change.rivals)}" if change.rivals else ""
    return (
        f"{change.what} at {change.joint} changed by {change.size:+.3g} ± {change.standard_error:.2g} {change.unit} "
        f"at {moment} ({change.significance:.1f} sigma{also})"
    )


def _figures(change: Change) -> dict[str, object]:
    """A change, for programs; stamps with their milliseconds."""
    return {
        "joint": change.joint,
        "what": change.what,
        "size": change.size,
        "standard_error": change.standard_error,
        "unit": change.unit,
        "time_s": f"{change.time_s:.3f}",
        "earliest_s": f"{change.earliest_s:.3f}",
        "found_s": f"{change.found_s:.3f}",
        "significance": change.significance,
        "rivals": ", ".join(change.rivals),
        **{f"jump[{symbol}]": value for symbol, value in change.values.items()},
    }
