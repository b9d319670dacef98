"""The tracking of raw messages: dates, gaps, missing temperatures, messages that are broken; and its thread."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import small_arm
from live_nodes import wait_for

from spacearm_ident.nodes.tracking_stream import TrackingChoice, TrackingStream
from spacearm_ident.nodes.tracking_thread import LONGEST_WAITING, Broken, TrackingThread
from spacearm_ident.recording import Recording, cdr
from spacearm_ident.tracking.tracker import Change

STEP_S = 25.0


def with_payload(run: Recording) -> Recording:
    """The forearm holds 1 kg, 0.1 m from its joint, from `STEP_S` on."""
    bare, laden = pin.buildModelFromXML(small_arm.URDF), pin.buildModelFromXML(small_arm.URDF)
    laden.inertias[2] += pin.Inertia(1.0, np.array([0.0, 0.0, 0.1]), np.zeros((3, 3)))
    acceleration = np.gradient(run.velocity, run.time, axis=0)
    states = list(zip(run.position, run.velocity, acceleration))
    torque = [[pin.rnea(model, model.createData(), *state) for state in states] for model in (bare, laden)]
    more = (np.array(torque[1]) - torque[0]) * (run.time >= STEP_S)[:, None]
    return replace(run, effort=run.effort + more)


def feed(stream: TrackingStream, payloads: list[bytes], size: int = 40) -> list[Change]:
    return [change for first in range(0, len(payloads), size) for change in stream.add(payloads[first : first + size])]


def values(stream: TrackingStream) -> dict[str, tuple[float, float]]:
    return {item.name: (item.value, item.standard_error) for item in stream.state().parameters}


@pytest.fixture(scope="module")
def run() -> Recording:
    return small_arm.recording(40.0)


@pytest.mark.parametrize(("size", "order"), [(40, (1, 0)), (400, (0, 1))])
def test_a_friction_step_is_dated_by_the_stamps(run, size, order):
    stream = TrackingStream(small_arm.identified(), TrackingChoice())
    (change,) = feed(stream, small_arm.payloads(small_arm.with_step(run, STEP_S), order), size)
    at_s = run.start_ns / 1e9 + STEP_S
    assert (change.joint, change.what, change.rivals) == ("elbow", "f_c", ("load",))  # The joint has not reversed yet.
    assert abs(change.time_s - at_s) < 0.5 and change.earliest_s <= change.time_s < change.found_s < at_s + 5.0
    for name, truth in {"f_c[elbow]": 2.0, "f_c[shoulder]": 3.0, "k_v1[shoulder]": 2.0}.items():
        value, error = values(stream)[name]
        assert abs(value - truth) < 3.5 * error < 0.7
    assert stream.state().time_s == pytest.approx(run.start_ns / 1e9 + 40.0, abs=1.0)
    assert stream.data_s == pytest.approx(40.0) and stream.newest_s - run.start_ns / 1e9 == pytest.approx(39.995)


def test_a_payload_is_one_change_where_it_is_followed(run):
    stream = TrackingStream(small_arm.identified(), TrackingChoice(payload=True))
    (change,) = feed(stream, small_arm.payloads(with_payload(run)))
    assert (change.what, change.joint, change.unit) == ("payload", "elbow", "kg")
    assert abs(change.time_s - run.start_ns / 1e9 - STEP_S) < 0.5
    # The payload's moment of inertia is not followed: a tenth of its torque here.
    assert values(stream)["dm[elbow]"][0] == pytest.approx(1.0, rel=0.1)
    assert values(stream)["dmcz[elbow]"][0] == pytest.approx(0.1, rel=0.15)


def test_standing_still_after_a_gap_changes_nothing(run):
    stream = TrackingStream(small_arm.identified(), TrackingChoice())
    feed(stream, small_arm.payloads(small_arm.recording(15.0)))
    still = small_arm.recording(20.0, still=(0, 1))
    at_rest = small_arm.payloads(replace(still, effort=still.effort + 3.0), after_s=20.0)
    # The last rows of the motion wait for those of the rest to be a whole batch.
    feed(stream, at_rest[:400])
    before = values(stream)
    assert feed(stream, at_rest[400:]) == []
    assert values(stream) == before
    assert stream.figures()["restarts"] == 1
    # And it goes on where it was.
    assert feed(stream, small_arm.payloads(small_arm.recording(10.0, seed=1), after_s=60.0)) == []
    assert values(stream) != before


def test_what_cannot_be_used_is_counted_and_spoils_nothing():
    payloads = small_arm.payloads(small_arm.recording(15.0))
    stamp = small_arm.recording(1.0).start_ns + 7_002_000_000
    row = np.zeros((1, 2))
    odd = [
        b"",
        b"nonsense",
        cdr.encode_joint_states([stamp], ["shoulder"], row[:, :1], effort=row[:, :1])[0],
        cdr.encode_joint_states([stamp], small_arm.JOINTS, row)[0],
        cdr.encode_joint_states([stamp], small_arm.JOINTS, row, effort=row * np.nan)[0],
    ]
    clean, spoilt = (TrackingStream(small_arm.identified(), TrackingChoice()) for _ in range(2))
    feed(clean, payloads)
    assert feed(spoilt, [*odd[:2], *payloads[:1400], *odd[2:], *payloads[1400:]]) == []
    assert spoilt.figures()["messages_left_out"] == 5
    for name, (value, error) in values(clean).items():
        assert abs(values(spoilt)[name][0] - value) < 0.1 * error


def test_the_temperature_of_a_joint_counts_once_it_has_told_it():
    payloads = small_arm.payloads(small_arm.recording(40.0))
    stream = TrackingStream(small_arm.identified(), TrackingChoice(temperature=True))

    def told(joint: str) -> float:
        item = next(item for item in stream.state().parameters if item.name == f"alpha_c[{joint}]")
        return item.standard_error

    def warm(joint: str, celsius: float) -> bytes:
        return cdr.encode_temperature(0, joint, celsius)

    feed(stream, payloads[:2000])
    unknown = {joint: told(joint) for joint in ("shoulder", "elbow")}
    broken = [b"", b"\x00\x01\x00\x00junk", warm("knee", 30.0), warm("elbow", float("nan")), warm("shoulder", 50.0)]
    assert stream.add(payloads[2000:2400], broken) == []
    feed(stream, payloads[2400:4000])
    assert told("elbow") == pytest.approx(unknown["elbow"], rel=1e-9) and stream.figures()["temperatures"] == "1 of 2"
    assert told("shoulder") < 0.9 * unknown["shoulder"]
    stream.add(payloads[4000:4400], [warm("elbow", 35.0)])
    feed(stream, payloads[4400:])
    assert stream.figures()["temperatures"] == "2 of 2"
    assert told("elbow") < 0.9 * unknown["elbow"]


class Slow:
    """A stream that works until it is let go, or breaks."""

    newest_s, data_s = 1.0, 1.0

    def __init__(self, break_down: bool = False) -> None:
        self.taken: list[object] = []
        self.at_work, self.go = threading.Event(), threading.Event()
        self._break_down = break_down

    def add(self, payloads: object, temperatures: object) -> list[Change]:
        self.at_work.set()
        assert self.go.wait(30.0)
        if self._break_down:
            raise np.linalg.LinAlgError("singular")
        self.taken.append(payloads)
        return []

    def state(self) -> str:
        return f"after {len(self.taken)}"

    def figures(self) -> dict[str, object]:
        return {"rate_Hz": 1000.0}


def heard(thread: TrackingThread, count: int) -> list[object]:
    news: list[object] = []

    def enough() -> bool:
        news.extend(thread.poll())
        return len(news) >= count

    wait_for(enough, f"{count} news")
    return news


def test_the_thread_tells_of_every_block_in_order_and_takes_what_it_can():
    stream = Slow()
    thread = TrackingThread(stream)
    thread.feed([b"0"], [], 0)
    assert stream.at_work.wait(30.0)
    for number in range(1, LONGEST_WAITING + 4):
        thread.feed([b"%d" % number], [], number)
    assert thread.blocks_left_out == 3 and thread.poll() == []
    stream.go.set()
    news = heard(thread, LONGEST_WAITING + 1)
    assert [item.arrived_ns for item in news] == list(range(LONGEST_WAITING + 1))
    assert news[0].state == "after 1" and 0.0 <= news[0].figures["core_share"] < 1.0
    thread.stop()


def test_a_thread_that_is_stopped_at_work_ends_and_does_no_more():
    stream = Slow()
    thread = TrackingThread(stream)
    for number in range(LONGEST_WAITING + 5):
        thread.feed([b""], [], number)
    assert stream.at_work.wait(30.0)
    letting_go = threading.Timer(0.2, stream.go.set)
    letting_go.start()
    thread.stop()
    assert len(stream.taken) <= 1
    assert "tracking" not in {other.name for other in threading.enumerate()}


def test_what_breaks_in_the_thread_is_told(capsys):
    stream = Slow(break_down=True)
    thread = TrackingThread(stream)
    stream.go.set()
    thread.feed([b""], [], 0)
    (news,) = heard(thread, 1)
    assert news == Broken("the tracking broke: LinAlgError: singular")
    assert "singular" in capsys.readouterr().err
    thread.stop()
