"""The local bus between objects, threads and processes: what is sent arrives, and nothing hangs."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spacearm_ident.canbus import frames
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.meeting_point import runtime_dir
from spacearm_ident.canbus.open_bus import open_bus
from spacearm_ident.errors import UserError

WAIT = 5.0
pytestmark = pytest.mark.usefixtures("own_buses")


@pytest.fixture
def join():
    buses = []

    def make(channel="t", **options):
        bus = LocalBus(channel, **options)
        buses.append(bus)
        return bus

    yield make
    for bus in buses:
        bus.shutdown()


def frame(can_id, data=b"", **options):
    return can.Message(arbitration_id=can_id, data=data, is_extended_id=False, **options)


messages = st.one_of(
    st.builds(
        lambda can_id, data, extended: can.Message(
            arbitration_id=can_id if extended else can_id & 0x7FF, is_extended_id=extended, data=data
        ),
        st.integers(0, 0x1FFFFFFF),
        st.binary(max_size=8),
        st.booleans(),
    ),
    st.builds(
        lambda can_id, size, brs, esi: can.Message(
            arbitration_id=can_id,
            is_extended_id=False,
            is_fd=True,
            data=os.urandom(size),
            bitrate_switch=brs,
            error_state_indicator=esi,
        ),
        st.integers(0, 0x7FF),
        st.sampled_from([0, 1, 8, 12, 16, 20, 24, 32, 48, 64]),
        st.booleans(),
        st.booleans(),
    ),
    st.builds(
        lambda can_id, dlc: can.Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=True, dlc=dlc),
        st.integers(0, 0x7FF),
        st.integers(0, 8),
    ),
)


@given(messages, st.integers(0, 2**62), st.integers(0, 2**33))
def test_a_frame_survives_packing(message, sent_ns, sequence):
    back, number = frames.unpack(frames.pack(message, sent_ns, sequence), "x")
    assert back.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
    assert back.timestamp == pytest.approx(sent_ns * 1e-9)
    assert number == sequence % 2**32


def test_the_layout_is_the_kernels():
    packed = frames.pack(frame(0x181, b"\x01\x02\x03"), 0, 0)
    assert packed[:16] == bytes.fromhex("8101000003000000") + b"\x01\x02\x03" + bytes(5)


def test_every_other_participant_receives_in_order_and_the_sender_does_not(join):
    a, b, c = join(), join(), join()
    for n in range(20):
        a.send(frame(n))
    for other in (b, c):
        assert [other.recv(WAIT).arbitration_id for _ in range(20)] == list(range(20))
    c.send(frame(0x7F))
    assert a.recv(WAIT).arbitration_id == 0x7F
    assert b.recv(WAIT).arbitration_id == 0x7F
    assert a.recv(0) is None and c.recv(0) is None


def test_buses_of_other_names_are_separate(join):
    a, b, elsewhere = join("t"), join("t"), join("u")
    a.send(frame(1))
    assert b.recv(WAIT).arbitration_id == 1
    assert elsewhere.recv(0.01) is None


def test_own_messages_on_request(join):
    a, b = join(receive_own_messages=True), join()
    a.send(frame(5))
    own = a.recv(WAIT)
    assert own.arbitration_id == 5 and not own.is_rx
    assert b.recv(WAIT).is_rx


def test_filters(join):
    a = join()
    b = join(can_filters=[{"can_id": 0x180, "can_mask": 0x780, "extended": False}])
    for can_id in (0x080, 0x181, 0x701, 0x1FF):
        a.send(frame(can_id))
    assert [b.recv(WAIT).arbitration_id for _ in range(2)] == [0x181, 0x1FF]
    assert b.recv(0.01) is None


def test_the_stamp_is_the_time_of_sending(join):
    a, b = join(), join()
    before = time.time()
    a.send(frame(1))
    after = time.time()
    time.sleep(0.05)
    assert before - 1e-6 <= b.recv(WAIT).timestamp <= after + 1e-6


def test_a_busy_sender_does_not_starve_another(join):
    reader, busy, quiet = join(), join(), join()
    for _ in range(500):
        busy.send(frame(1))
    quiet.send(frame(2))
    assert 2 in [reader.recv(WAIT).arbitration_id for _ in range(100)]


def test_a_slow_reader_loses_frames_and_stalls_nobody(join):
    sender, slow, quick = join(), join(), join()
    sender.send(frame(0))
    total, received = 1, 0
    while sender.dropped == 0 and total < 100_000:
        sender.send(frame(1))
        total += 1
        received += quick.recv(WAIT) is not None
    for _ in range(99):
        sender.send(frame(1))
        received += quick.recv(WAIT) is not None
    assert received == total + 99 - 1 and quick.recv(WAIT) is not None
    assert (sender.dropped, quick.lost) == (100, 0)
    got = sum(1 for _ in iter(lambda: slow.recv(0), None))
    sender.send(frame(2))
    assert slow.recv(WAIT).arbitration_id == 2
    assert slow.lost == 100 and got == total + 99 - 100


def test_alone_on_the_bus_nobody_acknowledges(join):
    alone = join()
    assert alone.state is can.BusState.PASSIVE
    with pytest.raises(can.CanOperationError, match="nobody acknowledges"):
        alone.send(frame(1))
    assert alone.recv(0.01) is None
    other = join()
    alone.send(frame(2))
    assert alone.state is can.BusState.ACTIVE
    assert other.recv(WAIT).arbitration_id == 2


def test_the_last_participant_leaving_is_one_error_frame_after_its_last_words(join):
    a, b, c = join(), join(), join()
    b.send(frame(7))
    b.shutdown()
    assert a.recv(WAIT).arbitration_id == 7
    assert a.recv(0.01) is None
    c.shutdown()
    error = a.recv(WAIT)
    assert error.is_error_frame and error.arbitration_id == frames.ERROR_NO_ACKNOWLEDGE
    assert a.recv(0.01) is None
    with pytest.raises(can.CanOperationError):
        a.send(frame(1))


def test_a_bus_that_was_shut_down_refuses_and_leaves_no_file(join, own_buses):
    a, b = join(), join()
    a.shutdown()
    a.shutdown()
    with pytest.raises(can.CanOperationError):
        a.send(frame(1))
    with pytest.raises(can.CanOperationError):
        a.recv(0.1)
    b.shutdown()
    assert list(own_buses.iterdir()) == []


CHILD = """
import sys, time, can
from spacearm_ident.canbus.local_bus import LocalBus
bus = LocalBus("t")
print("ready", flush=True)
while True:
    message = bus.recv(1.0)
    if message is not None and not message.is_error_frame:
        bus.send(message)
"""


@pytest.fixture
def echo():
    child = subprocess.Popen([sys.executable, "-c", CHILD], stdout=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    yield child
    child.kill()
    child.wait()
    child.stdout.close()


def test_frames_go_to_another_process_and_back(join, echo):
    bus = join()
    for n in range(200):
        bus.send(frame(n))
    assert [bus.recv(WAIT).arbitration_id for _ in range(200)] == list(range(200))


def test_a_killed_process_is_an_error_frame_and_its_file_is_removed(join, echo, own_buses):
    bus = join()
    bus.send(frame(1))
    assert bus.recv(WAIT).arbitration_id == 1
    echo.send_signal(signal.SIGKILL)
    echo.wait()
    assert bus.recv(WAIT).is_error_frame
    with pytest.raises(can.CanOperationError):
        bus.send(frame(1))
    assert len(list(own_buses.glob("t/*.sock"))) == 2
    newcomer = join()
    assert len(list(own_buses.glob("t/*.sock"))) == 2
    newcomer.send(frame(3))
    assert bus.recv(WAIT).arbitration_id == 3


def test_a_stopped_process_blocks_nobody(join, echo):
    bus, other = join(), join()
    echo.send_signal(signal.SIGSTOP)
    for _ in range(100):
        bus.send(frame(1))
    assert sum(other.recv(WAIT) is not None for _ in range(100)) == 100
    echo.send_signal(signal.SIGCONT)


def _join_and_report(channel, count, ready, results):
    with LocalBus(channel) as bus:
        ready.wait()
        bus.send(frame(1))
        heard = 0
        while heard < count - 1 and (message := bus.recv(WAIT)) is not None:
            heard += not message.is_error_frame
        results.put(heard)
        ready.wait()


def test_processes_that_join_at_the_same_moment_all_meet():
    count = 5
    context = multiprocessing.get_context("fork")
    ready, results = context.Barrier(count), context.Queue()
    children = [context.Process(target=_join_and_report, args=("crowd", count, ready, results)) for _ in range(count)]
    for child in children:
        child.start()
    assert [results.get(timeout=20) for _ in range(count)] == [count - 1] * count
    for child in children:
        child.join()


def test_the_runtime_directory_is_private(own_buses, monkeypatch):
    assert runtime_dir().stat().st_mode & 0o777 == 0o700
    own_buses.chmod(0o755)
    with pytest.raises(can.CanInitializationError, match="not a private directory"):
        LocalBus("t")
    own_buses.chmod(0o700)
    link = own_buses.parent / "link"
    link.symlink_to(own_buses)
    monkeypatch.setenv("SPACEARM_RUNTIME_DIR", str(link))
    with pytest.raises(can.CanInitializationError, match="not a private directory"):
        LocalBus("t")


@pytest.mark.parametrize("name", ["", "..", "a/b", ".hidden", "x y"])
def test_unusable_names(name):
    with pytest.raises(can.CanInitializationError, match="bus name"):
        LocalBus(name)


def test_open_bus_by_name_without_installation():
    with open_bus("local", "t", bitrate=1_000_000) as bus:
        assert isinstance(bus, LocalBus)


def test_open_bus_says_what_to_do():
    with pytest.raises(UserError, match="use 'local' or 'socketcan'"):
        open_bus("nonsense", "x")
    with pytest.raises(UserError, match="ip link set no_such_can up"):
        open_bus("socketcan", "no_such_can")
