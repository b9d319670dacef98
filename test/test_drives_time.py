"""What time does to the simulated drives and their motions, with a clock that a test turns."""

import math
import select
import struct
from types import SimpleNamespace

import can
import numpy as np
import pytest
from simulated_bus import SCALE, FirstOrderArm

from spacearm_ident.canbus import local_bus
from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.pdo import FEEDBACK, pdo_writes
from spacearm_ident.simulation.drives import network as drives_network
from spacearm_ident.simulation.drives.drive import DriveConfig
from spacearm_ident.simulation.drives.motion import Motion
from spacearm_ident.simulation.drives.network import DriveNetwork


class Turning:
    """Mechanics that turn at 1 rad/s whatever the drives want."""

    def __init__(self):
        self.position, self.velocity = np.zeros(1), np.ones(1)
        self.torque, self.temperature = np.zeros(1), np.zeros(1)

    def step(self, target, enabled, brake, dt):
        self.position = self.position + dt


class Clock:
    """Time that passes only when told to, for the drives and for the stamps on the bus."""

    def __init__(self):
        self.now = 1000.0

    def time(self):
        return self.now

    def time_ns(self):
        return round(1e9 * self.now)

    monotonic = time


@pytest.fixture
def clock(monkeypatch):
    """However busy the machine is, nothing is late but what the test delays."""
    clock = Clock()
    monkeypatch.setattr(local_bus, "time", clock)
    monkeypatch.setattr(drives_network, "time", clock)
    without_waiting = SimpleNamespace(select=lambda *lists: select.select(*lists[:3], 0.0))
    monkeypatch.setattr(drives_network, "select", without_waiting)
    return clock


@pytest.fixture
def turning(own_buses, clock):
    """A network whose one drive reports its position with every SYNC, and a bare master's bus."""
    with LocalBus("t") as bus, LocalBus("t") as other:
        network = DriveNetwork([bus], [(0, DriveConfig(1, SCALE))], Turning())
        network.boot()
        write = network.drives[0].dictionary.set_data
        for index, sub, value, size in pdo_writes(1, FEEDBACK, transmit=True):
            write(index, sub, value.to_bytes(size, "little"))
        other.send(can.Message(arbitration_id=0, data=b"\x01\x01", is_extended_id=False))
        yield network, other


SYNC = can.Message(arbitration_id=0x80, is_extended_id=False)


def pass_time(network, clock, until):
    """Serve the drives until then, twenty times in a step of the physics."""
    while clock.now < until:
        clock.now = min(clock.now + 5e-5, until)
        network.poll()


def test_feedback_is_that_of_the_moment_of_its_sync(turning, clock):
    """Held samples of a 1 kHz physics would be up to 1 ms old; jitter of the SYNC must not show at all."""
    network, master = turning
    rng = np.random.default_rng(1)
    pairs = []
    due = clock.now
    for _ in range(450):
        due += 0.002
        pass_time(network, clock, due + rng.uniform(-3e-4, 3e-4))
        while master.recv(0) is not None:
            pass
        sent = clock.now
        master.send(SYNC)
        network.poll()
        answer = next(m for m in iter(lambda: master.recv(0), None) if m.arbitration_id == 0x181)
        pairs.append((sent, struct.unpack_from("<i", answer.data)[0] * SCALE.rad_per_count))
    t, q = np.array(pairs[200:]).T
    assert np.abs(np.diff(q) - np.diff(t)).max() < 2e-5


def test_a_sync_that_is_too_old_is_not_answered(turning, clock):
    network, master = turning
    for old in (False, True):
        while master.recv(0) is not None:
            pass
        master.send(SYNC)
        if old:
            clock.now += 0.02
        for _ in range(5):
            network.poll()
        answers = [m.arbitration_id for m in iter(lambda: master.recv(0), None)]
        assert answers.count(0x181) == (0 if old else 1)
        assert network.unanswered == int(old)
        clock.now += 0.001


def test_a_process_that_was_held_up_catches_up_or_says_what_it_left_out(turning, clock):
    network, _ = turning
    before = network.steps
    clock.now += 0.01
    for _ in range(12):
        network.poll()
    assert network.steps - before >= 8 and network.skipped == 0
    clock.now += 0.5
    for _ in range(3):
        network.poll()
    assert network.skipped >= 300


def test_what_came_while_the_process_was_held_up_is_lived_through_in_order(turning, clock):
    """Twenty SYNCs with their set-points wait; the drives must go through each, not jump to the last."""
    network, master = turning
    drive = network.drives[0]
    seen = []
    drive.after_sync = lambda stale=0.0: seen.append((network.steps, stale))
    # In step with the SYNC first, as in any run.
    for _ in range(20):
        master.send(SYNC)
        pass_time(network, clock, clock.now + 1e-3)
    seen.clear()
    for _ in range(20):
        master.send(SYNC)
        clock.now += 1e-3
    for _ in range(200):
        network.poll()
    assert len(seen) == 20
    steps = np.diff([at for at, _ in seen])
    assert np.all(steps <= 3) and np.sum(steps) >= 15
    assert network.skipped == 0


# Parts -----------------------------------------------------------------------------------------------


def test_motion_interpolates_evenly_and_then_stands():
    motion = Motion()
    motion.hold(100.0)
    motion.follow(140.0, 0.004)
    seen = []
    for _ in range(6):
        motion.advance(0.001)
        seen.append((motion.demand, motion.velocity))
    assert seen[:4] == [pytest.approx((110.0 + 10 * k, 10_000.0)) for k in range(4)]
    assert seen[4:] == [(140.0, 0.0)] * 2


@pytest.mark.parametrize("extrapolation", [0.0, 0.02])
def test_a_stream_that_breaks_off_is_extrapolated_for_so_long(extrapolation):
    motion = Motion(extrapolation)
    motion.hold(0.0)
    for k in range(1, 6):
        motion.follow(10.0 * k, 0.001)
        motion.advance(0.001)
    seen = []
    for _ in range(25):
        motion.advance(0.001)
        seen.append(motion.demand)
    assert max(seen) == pytest.approx(50.0 + 10.0 * round(1e3 * extrapolation))


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stop_ramp_takes_v_squared_over_two_a(sign):
    motion = Motion()
    motion.follow(sign * 1000.0, 0.1)
    motion.advance(0.001)
    motion.stop(1e5)
    start = motion.demand
    for _ in range(101):
        motion.advance(0.001)
    assert motion.stopped
    assert motion.demand - start == pytest.approx(sign * 1e4**2 / (2 * 1e5), rel=0.02)


def test_the_stand_in_follows_with_its_time_constant():
    arm = FirstOrderArm(2, time_constant=0.01)
    for _ in range(10):
        arm.step(np.ones(2), np.array([True, False]), np.array([False, True]), 0.001)
    assert arm.position == pytest.approx([1 - math.exp(-1.0), 0.0])
