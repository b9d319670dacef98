"""Helper of the tests: simulated drives in a process of their own, on local buses."""

import multiprocessing
import threading
from contextlib import contextmanager

import numpy as np

from spacearm_ident.canbus.local_bus import LocalBus
from spacearm_ident.canbus.realtime import prepare_process, prepare_thread
from spacearm_ident.canbus.scaling import JointScale
from spacearm_ident.simulation.drives.drive import DriveConfig
from spacearm_ident.simulation.drives.network import DriveNetwork

SCALE = JointScale(counts_per_turn=65536, gear_ratio=100.0, torque_constant=0.1, rated=5.0)
FORK = multiprocessing.get_context("fork")


class FirstOrderArm:
    """Joints that follow their target with a time constant and report a torque that a test can foretell.

    Under power they run away with the velocity `runaway`, rad/s, that a test may set.
    The torque is `stiffness × (target − position)`; temperatures rise by 1 °C a joint from 20 °C.
    """

    def __init__(self, joints, time_constant=0.005, stiffness=1000.0):
        self.position = np.zeros(joints)
        self.velocity = np.zeros(joints)
        self.torque = np.zeros(joints)
        self.temperature = 20.0 + np.arange(joints)
        self.runaway = np.zeros(joints)
        self._time_constant = time_constant
        self._stiffness = stiffness

    def step(self, target, enabled, brake, dt):
        """Let `dt` seconds pass; joints that are not enabled stand still."""
        error = np.where(enabled & ~brake, target - self.position, 0.0)
        move = error * -np.expm1(-dt / self._time_constant) + dt * np.where(enabled, self.runaway, 0.0)
        self.position = self.position + move
        self.velocity = move / dt
        self.torque = self._stiffness * (error - move)


def _serve(channels, configs, ready, stop, habit, acts):
    prepare_thread()
    prepare_process()
    buses = [LocalBus(channel) for channel in channels]
    arm = FirstOrderArm(len(configs))
    network = DriveNetwork(buses, configs, arm)
    if habit is not None:
        habit(network.drives, arm)
    started = threading.Event()

    def stopping():
        if not started.is_set():
            started.set()
            ready.set()
        if acts.poll():
            act, arguments = acts.recv()
            acts.send(act(network.drives, arm, *arguments))
        return stop.is_set()

    network.run(stopping)
    for bus in buses:
        bus.shutdown()


@contextmanager
def simulated_drives(channels=("t",), per_bus=2, scale=SCALE, habit=None):
    """Start `per_bus` drives on each channel (nodes counted through); yields the process.

    `habit(drives, arm)` is called before they boot; `process.act(function, *arguments)` calls the function there with
    drives, arm and arguments while they run, and returns what it returns.
    """
    configs = [(bus, DriveConfig(1 + bus * per_bus + k, scale)) for bus in range(len(channels)) for k in range(per_bus)]
    ready, stop = FORK.Event(), FORK.Event()
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=_serve, args=(channels, configs, ready, stop, habit, theirs), daemon=True)

    def act(function, *arguments):
        ours.send((function, arguments))
        assert ours.poll(20)
        return ours.recv()

    process.act = act
    process.start()
    try:
        assert ready.wait(20)
        yield process
    finally:
        stop.set()
        process.join(5)
        if process.is_alive():
            process.kill()
            process.join()
