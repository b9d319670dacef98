"""What the identifier says of what it follows, and which stretch behind a change it has explained."""

from __future__ import annotations

import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest
import small_arm
from live_nodes import wait_for

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")

from spacearm_ident.nodes import live_tracking
from spacearm_ident.nodes.identifier_messages import tracked_statuses
from spacearm_ident.nodes.live_tracking import ChangeWindow, LiveTracking
from spacearm_ident.nodes.runtime import Level
from spacearm_ident.nodes.tracking_stream import TrackingChoice
from spacearm_ident.nodes.tracking_thread import Broken, Followed
from spacearm_ident.tracking.layout import TrackedValue
from spacearm_ident.tracking.tracker import Change, TrackingState

T0 = 1_700_000_000.0
CHANGE = Change(T0 + 25.0, T0 + 24.9, T0 + 26.1, "elbow", "f_c", 0.5, 0.04, "N m", 9.3, ("load",))
VALUE = TrackedValue("f_c", "elbow", "N m", 2.0, 0.05, 1.5, True)


class TestWindow:
    def test_it_begins_behind_the_change_and_ends_when_it_is_long_enough(self):
        # Played ten times as fast, by another clock: arrival is what the buffer knows.
        window = ChangeWindow(10.0)
        for number in range(30):
            window.add(T0 + number + 20.5, 100 * number, [CHANGE] if number == 6 else [])
            stretch = window.take()
            assert (stretch is not None) == (number == 15)
            if stretch:
                # The block up to T0 + 25.5 has the change in it: what came after that at 500 is behind it.
                assert stretch == (501, 1500)

    def test_changes_within_a_stretch_are_part_of_it_and_a_later_one_begins_another(self):
        window, taken = ChangeWindow(5.0), []
        for number in range(40):
            later = {7: 26.9, 9: 29.0, 20: 40.0}.get(number)
            window.add(T0 + number + 20.0, number, [replace(CHANGE, time_s=T0 + later)] if later else [])
            if stretch := window.take():
                taken.append(stretch)
        assert taken == [(8, 12), (21, 25)]

    def test_who_asks_late_gets_the_same(self):
        window = ChangeWindow(10.0)
        for number in range(40):
            window.add(T0 + number + 20.5, 100 * number, [CHANGE] if number == 6 else [])
        assert window.take() == (501, 1500)
        assert window.take() is None

    def test_a_clock_set_back_ends_what_was_begun(self):
        window = ChangeWindow(5.0)
        window.add(T0 + 25.0, 1, [])
        window.add(T0 + 26.0, 2, [CHANGE])
        for number in range(40):
            window.add(T0 - 1000.0 + number, 3 + number, [])
            assert window.take() is None
        window.add(T0 - 960.0, 50, [replace(CHANGE, time_s=T0 - 962.5)])
        window.add(T0 - 955.0, 55, [])
        assert window.take() == (42, 55)


class Fed:
    """A thread whose news the test writes."""

    blocks_left_out = 2

    def __init__(self, stream: object) -> None:
        self.news: list[object] = []

    def stop(self) -> None:
        pass

    def poll(self) -> list[object]:
        news, self.news = self.news, []
        return news

    def tell(self, *changes: Change, time_s: float = T0 + 30.0) -> None:
        state = TrackingState(time_s, (VALUE, replace(VALUE, symbol="k_v1", informed=False)), [], [])
        self.news.append(Followed(time_s + 0.3, 0, changes, state, {"core_share": 0.05}))


@pytest.fixture
def clock(monkeypatch) -> SimpleNamespace:
    """The clock of the module, and the thread of the last tracking made."""
    now = SimpleNamespace(s=100.0)
    monkeypatch.setattr(live_tracking, "time", SimpleNamespace(monotonic=lambda: now.s))

    def make(stream: object) -> Fed:
        now.thread = Fed(stream)
        return now.thread

    monkeypatch.setattr(live_tracking, "TrackingThread", make)
    return now


def test_a_change_warns_for_a_while_and_is_told_from_then_on(clock):
    tracking = LiveTracking(small_arm.identified(), TrackingChoice())
    assert tracking.status().message == "waiting for joint states"
    clock.thread.tell()
    assert tracking.poll() == []
    status = tracking.status()
    assert (status.level, status.message) == (Level.OK, "follows; no change so far")
    assert status.values["informed"] == "1 of 2" and status.values["blocks_left_out"] == 2
    clock.thread.tell(CHANGE)
    assert tracking.poll() == [CHANGE]
    status = tracking.status()
    assert status.level is Level.WARN and status.part == "tracking"
    words = "f_c at elbow changed by +0.5 ± 0.04 N m at 2023-11-14T22:13:45.000+00:00 (9.3 sigma; or load)"
    assert status.message == words
    told = {"joint": "elbow", "what": "f_c", "time_s": "1700000025.000", "rivals": "load", "changes": 1}
    assert told.items() <= status.values.items()
    clock.s += live_tracking.WARN_S + 1.0
    status = tracking.status()
    assert (status.level, status.message) == (Level.OK, f"follows; the last change: {words}")


def test_a_change_found_with_one_model_stays_said_with_the_next(clock):
    first = LiveTracking(small_arm.identified(), TrackingChoice())
    clock.thread.tell(CHANGE)
    first.poll()
    second = LiveTracking(small_arm.identified(), TrackingChoice(), before=first)
    assert "f_c at elbow changed by +0.5" in second.status().message  # No joint state has come yet.
    clock.thread.tell()
    assert second.poll() == []
    assert second.status().level is Level.WARN and "f_c at elbow changed by +0.5" in second.status().message
    clock.s += live_tracking.WARN_S + 1.0
    assert second.status().level is Level.OK and "the last change: f_c at elbow" in second.status().message


def test_a_change_that_will_not_be_explained_is_told_once_with_the_reason(clock):
    for spoil, reason in (
        (lambda tracking: clock.thread.tell(time_s=T0 - 1000.0), "the clock of the joint states was set back"),
        (lambda tracking: clock.thread.news.append(Broken("the tracking broke")), "the tracking broke"),
        (lambda tracking: tracking.stop("the node was ended"), "the node was ended"),
    ):
        tracking = LiveTracking(small_arm.identified(), TrackingChoice(), 30.0)
        clock.thread.tell(CHANGE)
        tracking.poll()
        assert tracking.given_up() == ""
        spoil(tracking)
        tracking.poll()
        assert (tracking.given_up(), tracking.given_up()) == (reason, "")
        tracking.stop("nothing waits any more")
        assert tracking.given_up() == ""


def test_values_are_due_once_a_second_while_rows_come_and_at_once_after_a_change(clock):
    tracking = LiveTracking(small_arm.identified(), TrackingChoice())
    clock.thread.tell(time_s=float("nan"))  # Samples, but no row yet.
    tracking.poll()
    assert tracking.due() is None
    due = []
    for tenth in range(40):
        clock.s = 100.0 + 0.1 * tenth
        change = [CHANGE] if tenth == 13 else []
        # From the 25th on the arm's data end: nothing new to say.
        clock.thread.tell(*change, time_s=T0 + min(tenth, 25))
        tracking.poll()
        if tracking.due():
            due.append(tenth)
    assert due[:3] == [0, 10, 13] and due[3] in (23, 24) and len(due) <= 5


def test_what_broke_is_an_error_and_takes_no_more(clock):
    tracking = LiveTracking(small_arm.identified(), TrackingChoice())
    clock.thread.news.append(Broken("the tracking broke: singular"))
    assert tracking.poll() == []
    status = tracking.status()
    assert status.level is Level.ERROR and "restarts with the next model" in status.message
    tracking.feed([b""], [], 0)  # Fed has no `feed`: it would fail.


def test_followed_values_are_told_from_identified_ones():
    state = TrackingState(T0, (VALUE, replace(VALUE, symbol="k_v1", informed=False)), [], [])
    first, second = tracked_statuses("small_arm", state)
    values = {pair.key: pair.value for pair in first.values}
    assert first.name == "tracked f_c[elbow]" and first.message == values["determination"] == "tracked"
    assert (values["value"], values["standard_error"], values["identified"]) == ("2.0", "0.05", "1.5")
    assert values["time_s"] == "1700000000.000" and values["note"] == ""
    assert {pair.key: pair.value for pair in second.values}["note"] == "not excited by any motion yet"


def test_a_model_change_in_the_middle_of_the_work():
    """The old thread ends though blocks are waiting; the new model is followed from what comes then."""
    payloads = small_arm.payloads(small_arm.recording(20.0))
    first = LiveTracking(small_arm.identified(), TrackingChoice(payload=True))
    for start in range(0, 4000, 100):
        first.feed(payloads[start : start + 100], [], start)
    first.stop("over")
    assert "tracking" not in {thread.name for thread in threading.enumerate()}
    second = LiveTracking(small_arm.identified(), TrackingChoice())
    second.feed(payloads, [], 1)
    wait_for(lambda: second.poll() == [] and second.due(), "the second at work")
    assert {item.symbol for item in second.state.parameters} == {"f_c", "f_b", "k_v1"}
    second.stop("over")
