"""The simulated arm as a process has it: drives on their buses, physics behind them, one thread for both."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

import can

from spacearm_ident.canbus.realtime import prepare_process, prepare_thread
from spacearm_ident.documents import read_yaml
from spacearm_ident.driver.arm_can import ArmCan
from spacearm_ident.driver.bus_lock import BusLock
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.closed_loop import SensorNoise
from spacearm_ident.simulation.concealed import Concealment, Effect, load_concealed
from spacearm_ident.simulation.drives.drive import DriveConfig
from spacearm_ident.simulation.drives.network import DriveNetwork
from spacearm_ident.simulation.live_arm import LiveArm
from spacearm_ident.simulation.parameters import PlantParameters
from spacearm_ident.simulation.thermal import surroundings


class ArmProcess:
    """Serves the drives in a thread of its own.

    Attributes:
        network: The drives; its counters may be read at any time.
        failure: Why the thread has ended, if not by `close`.
        warning: What a user should know about real time.
    """

    def __init__(self, config: ArmCan, arm: LiveArm, *, priority: int = 60) -> None:
        """Join the buses; the drives boot with `start`.

        Raises:
            UserError: A bus cannot be opened, or has a simulated arm.
        """
        self._locks = [BusLock(address.interface, address.channel, "simulated_arm") for address in config.buses]
        self._buses: list[can.BusABC] = config.open()
        bus = config.bus
        configs = [(axis.bus, DriveConfig(axis.node_id, axis.scale, bus.extrapolation)) for axis in bus.axes]
        self.network = DriveNetwork(self._buses, configs, arm, config.bus.period)
        self.failure: str | None = None
        self.warning: str | None = None
        self._priority = priority
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="drives", daemon=True)

    def start(self) -> None:
        """Switch the drives on."""
        self._thread.start()

    def close(self) -> None:
        """Cut the power and leave the buses."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(5.0)
        for bus in self._buses:
            bus.shutdown()
        for lock in self._locks:
            lock.release()

    def _serve(self) -> None:
        self.warning = prepare_thread(self._priority)
        prepare_process()
        try:
            self.network.run(self._stop.is_set)
        except Exception as error:
            self.failure = f"{type(error).__name__} {error}"


def live_arm(
    config: ArmCan,
    model: Path,
    *,
    noise: float = 1.0,
    seed: int = 0,
    position: list[float] | None,
    ambient: float = 20.0,
    conceal: Path | None = None,
) -> LiveArm:
    """The arm of a model file, under the drives of `config`.

    Args:
        config: Arm and drives.
        model: A model file; what the arm obeys.
        noise: Times the usual noise of the current sensors; 0: none.
        seed: Of the noise.
        position: (n,) rad where it starts, or one angle for all joints; zero unless given.
        ambient: Temperature of the surroundings, and of the arm at the start, °C.
        conceal: File of physics that the model does not know; only what acts while the arm moves.

    Raises:
        UserError: The model cannot be read or does not fit the arm.
    """
    try:
        parameters = PlantParameters.from_model(read_yaml(model, "the model"), config.arm.urdf)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise UserError(f"cannot read the model {model}: {error}") from error
    n = len(parameters.joints)
    if position is not None and len(position) not in (1, n):
        raise UserError(f"the start position has {len(position)} angles: give {n}, or one for all joints")
    start = None if position is None else position * (n // len(position))
    return LiveArm(
        parameters,
        config.arm,
        position=start,
        noise=SensorNoise.times(noise),
        seed=seed,
        ambient=surroundings(ambient),
        hidden=None if conceal is None else hidden_physics(conceal, parameters.joints),
    )


def hidden_physics(path: Path, joints: Sequence[str]) -> Concealment:
    """What a file conceals in a live arm with these joints.

    Args:
        path: File of the schema `spacearm_ident/conceal/1`.
        joints: Names in the arm's order.

    Raises:
        UserError: It cannot be read, or conceals what only a finished recording can show.
    """
    effects = load_concealed(path, joints)
    for effect in effects:
        if type(effect).reported is not Effect.reported:
            raise UserError(f"{path}: {effect.name} is done to a finished recording: use spacearm simulate for it")
    return Concealment(effects)
