"""The simulated arm under its drives, recorded: a trajectory in, a `Recording` out.

Two halves. `simulate_truth` runs plant and servo and keeps exact motion and torque at the stamps. `measure`
looks at that truth through sensors. A recorded torque is the mean of what the drive applied over the sample
interval centred on the stamp, so it belongs to the motion at that very stamp; a torque of the half-open
interval before or after would be a hidden delay of half a millisecond, which identification would answer
with a biased viscosity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.base_link import base_link
from spacearm_ident.errors import UserError
from spacearm_ident.excitation.trajectory import Motion, Trajectory
from spacearm_ident.recording.messages import BASE_IMU_TOPIC
from spacearm_ident.recording.recording import BaseSensor, Recording, Series
from spacearm_ident.simulation.plant import Plant, PlantParameters
from spacearm_ident.simulation.servo import DriveData, Servo, ServoTuning
from spacearm_ident.simulation.thermal import ThermalParameters

if TYPE_CHECKING:
    from spacearm_ident.simulation.concealed.concealment import Concealment

Progress = Callable[[float], None]

SETTLE_S = 0.5
"""Held at the start before the recording begins, so that the drives carry gravity at its first sample."""
_TEMPERATURE_HZ = 5.0
_RUNAWAY = 1e3
"""rad/s that no arm's joint turns at."""


class RunawayError(UserError):
    """The simulated arm cannot carry what its parameters make of it."""


@dataclass(frozen=True)
class SensorNoise:
    """What the sensors make of the truth.

    Attributes:
        effort_white: White noise of the torque from current, share of the drive's torque limit (where that is
            infinite, of the joint's largest torque in the run).
        effort_coloured: Its slow part, same unit: a first-order process.
        effort_correlation_s: Time constant of that process, s.
        position_counts: Counts per output turn of the joint encoder that `position` comes from; 0: exact.
        velocity_noise: White noise of the reported velocity, rad/s.
        temperature_noise: K.
        imu_rate_hz: Of an IMU in the base link's frame (200 Hz is usual); 0: there is none.
        gyro_noise: White noise of a sample of its angular velocity, rad/s.
        accelerometer_noise: White noise of a sample of its specific force, m/s².
        effort_scale: (n,) N·m or N that the shares of effort are of; None: the torque limits.
    """

    effort_white: float = 0.0035
    effort_coloured: float = 0.0012
    effort_correlation_s: float = 0.01
    position_counts: int = 2**19
    velocity_noise: float = 5e-4
    temperature_noise: float = 0.05
    imu_rate_hz: float = 0.0
    gyro_noise: float = 4e-4
    accelerometer_noise: float = 5e-3
    effort_scale: FloatArray | None = None

    @classmethod
    def none(cls) -> SensorNoise:
        """Perfect sensors."""
        return cls(0.0, 0.0, 1.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @classmethod
    def times(cls, factor: float) -> SensorNoise:
        """The usual sensors with so many times their usual noise; resolution and correlation stay."""
        return cls(
            effort_white=factor * cls.effort_white,
            effort_coloured=factor * cls.effort_coloured,
            velocity_noise=factor * cls.velocity_noise,
            temperature_noise=factor * cls.temperature_noise,
            gyro_noise=factor * cls.gyro_noise,
            accelerometer_noise=factor * cls.accelerometer_noise,
        )


@dataclass(frozen=True, eq=False)
class Truth:
    """What really happened, at the stamps; (N, n) each.

    Attributes:
        joints: Names of the n joints.
        time: (N,) s.
        q: rad.
        qd: rad/s.
        qdd: Mean over the sample interval centred on the stamp, rad/s²: the acceleration `torque` causes.
        torque: Motor torque on the output side, mean over that interval, N·m.
        command: Set-points, rad.
        temperature: Housings, °C, on the clock `temperature_time` (M,) s.
        urdf: Robot description.
        drives: Electrical data of the drives.
        base_rate: (N, 3) angular velocity of the base in its own axes, rad/s.
        base_force: (N, 3) specific force at the base's origin in its axes, mean over the interval, m/s².
    """

    joints: tuple[str, ...]
    time: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    torque: FloatArray
    command: FloatArray
    temperature_time: FloatArray
    temperature: FloatArray
    urdf: str
    drives: DriveData
    base_rate: FloatArray | None = None
    base_force: FloatArray | None = None


def simulate_truth(
    parameters: PlantParameters,
    trajectory: Trajectory,
    *,
    rate_hz: float = 1000.0,
    drives: DriveData | None = None,
    tuning: ServoTuning | None = None,
    thermal: ThermalParameters | None = None,
    hidden: Concealment | None = None,
    progress: Progress | None = None,
) -> Truth:
    """Follow a trajectory and return the noise-free truth.

    Args:
        parameters: What the arm obeys.
        trajectory: What it is told to do; its joints are those of the parameters, in the same order.
        rate_hz: Sample rate of the truth; the servo rate is an even multiple of it.
        drives: Electrical data; `DriveData.plain` unless given.
        tuning: Of the servo loops.
        thermal: Thermal data; copper losses follow from `drives` unless given.
        hidden: Physics that the parameters do not tell of.
        progress: Called now and then with the share done, 0 to 1.

    Raises:
        ValueError: Joints or rates do not fit.
        UserError: Parameters and robot description do not fit.
        RunawayError: They make an arm that runs away.
    """
    if tuple(trajectory.joints) != parameters.joints:
        raise ValueError(f"trajectory moves {trajectory.joints}, the plant has {parameters.joints}")
    tuning = ServoTuning() if tuning is None else tuning
    drives = DriveData.plain(len(parameters.joints)) if drives is None else drives
    ratio = round(tuning.rate_hz / rate_hz)
    if ratio % 2 or abs(ratio * rate_hz - tuning.rate_hz) > 1e-6 * tuning.rate_hz:
        raise ValueError("the servo rate must be an even multiple of the recording's rate")

    before, half = round(SETTLE_S * tuning.rate_hz), ratio // 2
    samples = int(np.floor(trajectory.duration_s * rate_hz + 1e-9)) + 1
    at = before + ratio * np.arange(samples)
    command = trajectory.evaluate((np.arange(at[-1] + half + 1) - before) / tuning.rate_hz)
    start = command.q[0]
    warmth = thermal or ThermalParameters(drives.copper_loss)
    plant = plant_of(parameters, start, warmth, hidden)
    servo = Servo(np.diag(plant.inertia()), drives, tuning, start)
    warm_every = max(1, round(rate_hz / _TEMPERATURE_HZ))
    q, qd, torque, warm, base = _run(plant, servo, command, at[::warm_every], hidden, progress)
    truth = Truth(
        joints=parameters.joints,
        time=np.arange(samples) / rate_hz,
        q=q[at],
        qd=qd[at],
        qdd=(qd[at + half] - qd[at - half]) * rate_hz,
        torque=np.mean([torque[at + k] for k in range(-half, half)], axis=0),
        command=command.q[at],
        temperature_time=np.arange(0, samples, warm_every) / rate_hz,
        temperature=warm,
        urdf=parameters.urdf,
        drives=drives,
        **_base_truth(base, at, half, rate_hz, plant.parameters.gravity),
    )
    return truth if hidden is None else hidden.reported(truth)


def plant_of(
    parameters: PlantParameters,
    position: FloatArray,
    thermal: ThermalParameters,
    hidden: Concealment | None,
) -> Plant:
    """The plant at rest at a position, with its hidden physics.

    Args:
        parameters: Parameters of the n joints and of the rigid bodies.
        position: (n,) rad or m.
        thermal: Thermal parameters of the joints.
        hidden: Physics beyond the parameters; None: there is none.
    """
    if hidden is None:
        return Plant(parameters, position=position, thermal=thermal)
    return hidden.plant(parameters, position, thermal)


def measure(truth: Truth, noise: SensorNoise, seed: int = 0, start_ns: int = 0) -> Recording:
    """Simulate the sensors: the recording that they make of the true motion.

    Args:
        truth: True signals of the run.
        noise: Noise, resolution and IMU of the sensors.
        seed: Seed of the noise; the same seed gives the same recording.
        start_ns: Start of the recording, ns since the epoch.
    """
    rng = np.random.default_rng(seed)
    shape = truth.q.shape
    limit = truth.drives.torque_limit if noise.effort_scale is None else noise.effort_scale
    full_scale = np.where(np.isfinite(limit), limit, np.abs(truth.torque).max(axis=0))
    keep = np.exp(-float(np.median(np.diff(truth.time))) / noise.effort_correlation_s)
    # First-order process of unit variance; the long run-in forgets that the filter starts at zero.
    run_in = int(np.ceil(10 / -np.log(keep))) if keep > 0 else 0
    drive = rng.standard_normal((shape[0] + run_in, shape[1])) * np.sqrt(1 - keep**2)
    coloured = lfilter([1.0], [1.0, -keep], drive, axis=0)[run_in:]
    white = rng.standard_normal(shape)
    effort = truth.torque + full_scale * (noise.effort_white * white + noise.effort_coloured * coloured)
    position = truth.q
    if noise.position_counts:
        count = 2 * np.pi / noise.position_counts
        position = np.rint(position / count) * count
    warm = truth.temperature + noise.temperature_noise * rng.standard_normal(truth.temperature.shape)
    return Recording(
        joints=truth.joints,
        time=truth.time,
        position=position,
        velocity=truth.qd + noise.velocity_noise * rng.standard_normal(shape),
        effort=effort,
        segments=(slice(0, len(truth.time)),),
        start_ns=start_ns,
        command=Series(truth.time, truth.command),
        temperatures={name: Series(truth.temperature_time, warm[:, i]) for i, name in enumerate(truth.joints)},
        base=_imu(truth, noise, rng) if noise.imu_rate_hz else None,
        urdf=truth.urdf,
    )


def _imu(truth: Truth, noise: SensorNoise, rng: np.random.Generator) -> BaseSensor:
    """An IMU in the base link's frame.

    Raises:
        UserError: It is faster than the recording.
    """
    if truth.base_rate is None or truth.base_force is None:
        raise ValueError("this truth does not hold the base's motion")
    recorded_hz = 1.0 / float(np.median(np.diff(truth.time)))
    if not 0.0 < noise.imu_rate_hz <= 1.001 * recorded_hz:
        raise UserError(f"an IMU at {noise.imu_rate_hz:g} Hz: choose a rate up to the recording's {recorded_hz:g} Hz")
    some = slice(None, None, round(recorded_hz / noise.imu_rate_hz))
    rate, force = truth.base_rate[some], truth.base_force[some]
    return BaseSensor(
        topic=BASE_IMU_TOPIC,
        frame=base_link(truth.urdf),
        time=truth.time[some],
        rate=rate + noise.gyro_noise * rng.standard_normal(rate.shape),
        force=force + noise.accelerometer_noise * rng.standard_normal(force.shape),
        runs=(slice(0, len(rate)),),
    )


def _base_truth(
    states: FloatArray | None, at: NDArray[np.intp], half: int, rate_hz: float, gravity: FloatArray
) -> dict[str, FloatArray]:
    """What a perfect IMU on the base feels at the stamps, from its states (T, 13) at every servo cycle."""
    if states is None:
        return {"base_rate": np.zeros((len(at), 3)), "base_force": np.tile(-gravity, (len(at), 1))}

    def velocity(cycles: NDArray[np.intp]) -> FloatArray:
        return np.asarray(Rotation.from_quat(states[cycles, 3:7]).apply(states[cycles, 7:10]))

    acceleration = (velocity(at + half) - velocity(at - half)) * rate_hz
    force = Rotation.from_quat(states[at, 3:7]).inv().apply(acceleration - gravity)
    return {"base_rate": states[at, 10:], "base_force": np.asarray(force)}


# Of numbers that grow beyond all bounds `_stop_a_runaway` tells, in words.
@np.errstate(over="ignore", invalid="ignore")
def _run(
    plant: Plant,
    servo: Servo,
    command: Motion,
    warm_at: NDArray[np.intp],
    hidden: Concealment | None,
    progress: Progress | None,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Position and velocity at the start of every servo cycle, torque during it; housings at `warm_at`; the base."""
    q, qd, torque = (np.empty_like(command.q) for _ in range(3))
    warm = np.empty((len(warm_at), q.shape[1]))
    states = None if plant.base() is None else np.empty((len(q), 13))
    edges = [0, *warm_at.tolist(), len(q)]
    for chunk, (first, last) in enumerate(pairwise(edges)):
        if chunk:
            warm[chunk - 1] = plant.housing_temperature
        if progress is not None:
            progress(first / len(q))
        _stop_a_runaway(plant)
        for cycle in range(first, last):
            q[cycle] = seen = plant.position
            qd[cycle] = plant.velocity
            if states is not None:
                states[cycle] = plant.base()
            if hidden is not None:
                seen = hidden.encoder(seen)
            applied = servo.torque(seen, command.q[cycle], command.qd[cycle])
            torque[cycle] = applied
            plant.step(applied if hidden is None else hidden.motor(applied, plant), servo.dt)
    _stop_a_runaway(plant)
    if progress is not None:
        progress(1.0)
    return q, qd, torque, warm, states


def _stop_a_runaway(plant: Plant) -> None:
    # What is no number any more is not less either.
    if not np.abs(plant.velocity).max() < _RUNAWAY:
        raise RunawayError(
            f"the simulated arm runs away within {plant.time:.1f} s: its inertia is not positive, or a spring pushes; "
            "make smaller what is concealed in it, or give another model"
        )
