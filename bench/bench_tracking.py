"""What tracking costs (data seconds over CPU seconds), how fast it finds changes, and how often it cries wolf.

The paper's arm with torque from its own model: what is measured is the tracker, not the model. `--hours` is the length
of the stationary runs in which every change found is a false alarm.

`--live SECONDS` measures the node instead, fed over ROS 2 at 1 kHz with a recording of the simulated arm: the CPU time
of the tracking's thread over the length of the data (`core_share`), and that of the whole node.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from spacearm_ident.dynamics.model import IdentifiedModel
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.recording import cdr
from spacearm_ident.recording.bag import read_bag
from spacearm_ident.recording.messages import STATES_TOPIC, TEMPERATURES_TOPIC, TOPIC_TYPES
from spacearm_ident.signals.motion import Motion
from spacearm_ident.tracking.rows import RowStream, TrackedModel, rows_of
from spacearm_ident.tracking.tracker import Change, Tracker

MODEL = Path(__file__).parent.parent / "config" / "paper_arm_model.yaml"
CUTOFF_HZ = 10.0
NOISE_NM = np.array([0.6, 0.6, 0.45, 0.15, 0.15, 0.15])
CHANGES: dict[str, dict[str, float]] = {
    "f_c[joint_3] + 1.5 N m": {"f_c[joint_3]": 1.5},
    "f_c[joint_5] + 0.5 N m": {"f_c[joint_5]": 0.5},
    "k_v1[joint_2] + 4 N m s/rad": {"k_v1[joint_2]": 4.0},
    "payload 1 kg, 0.1 m out": {"dm[joint_6]": 1.0, "dmcz[joint_6]": 0.1},
    "payload 0.3 kg, 0.1 m out": {"dm[joint_6]": 0.3, "dmcz[joint_6]": 0.03},
}


def motion_of(model: IdentifiedModel, seconds: float, rate_hz: float, seed: int) -> Motion:
    """Sines of frequencies that never repeat together, up to 0.8 rad/s."""
    rng, count = np.random.default_rng(seed), len(model.model.arm.joints)
    omega = 2 * np.pi * np.sqrt(rng.uniform(0.05**2, 0.4**2, (4, count)))
    angle = np.arange(0.0, seconds, 1.0 / rate_hz)[:, None, None] * omega + rng.uniform(0, 2 * np.pi, (4, count))
    size = 0.8 * rng.dirichlet(np.ones(4), count).T
    acceleration = -(size * omega * np.sin(angle)).sum(axis=1)
    position = (size / omega * np.sin(angle)).sum(axis=1)
    return Motion(
        joints=model.model.arm.joint_names,
        rate_hz=rate_hz,
        start_s=0.0,
        position=position,
        velocity=(size * np.cos(angle)).sum(axis=1),
        acceleration=acceleration,
        torque=np.zeros_like(position),
        speed_noise=np.full(count, 1e-6),
        resolved_speed=np.percentile(np.abs(acceleration), 95, axis=0) / (2 * np.pi * CUTOFF_HZ),
        block=max(1, int(rate_hz / (20 * CUTOFF_HZ))),
        cutoff_hz=CUTOFF_HZ,
        stride=10,
    )


def noise(shape: tuple[int, ...], seed: int, ar: float) -> np.ndarray:
    """AR(1) noise of the joints' standard deviations."""
    white = np.random.default_rng(seed).standard_normal((shape[0] + 5000, *shape[1:]))
    return NOISE_NM * lfilter([np.sqrt(1 - ar**2)], [1.0, -ar], white, axis=0)[5000:]


def cost(model: IdentifiedModel, payload: bool, temperature: bool, seconds: float) -> None:
    motion = motion_of(model, seconds, 1000.0, 0)
    torque = model.torque(motion) + noise(motion.position.shape, 0, 0.0)
    stamps = np.arange(len(torque)) / 1000.0
    tracked = TrackedModel(model, payload, temperature)
    stream, tracker, spent = RowStream(tracked, 1000.0), Tracker(tracked), [0.0, 0.0]
    for first in range(0, len(torque), 200):
        block = slice(first, first + 200)
        warm = np.full(6, 20.0 + first / 1e5) if temperature else None
        start = time.process_time()
        parts = stream.add(stamps[block], motion.position[block], torque[block], warm)
        middle = time.process_time()
        for rows in parts:
            tracker.add(rows)
        spent[0] += middle - start
        spent[1] += time.process_time() - middle
    what = "levels" + ", payload" * payload + ", alpha" * temperature
    print(
        f"{what:<24} {seconds:.0f} s of data in {sum(spent):.2f} CPU s: ratio {seconds / sum(spent):.0f}, "
        f"{sum(spent) / seconds:.1%} of a core (rows {spent[0] / seconds:.1%}, the rest {spent[1] / seconds:.1%})"
    )


def tracked_run(
    model: IdentifiedModel,
    by: dict[str, float],
    seconds: float,
    at_s: float,
    seed: int,
    ar: float,
    payload: bool = True,
) -> list[Change]:
    tracked = TrackedModel(model, payload)
    motion = motion_of(model, seconds, 200.0, seed)
    names = [parameter.name for parameter in tracked.model.model.parameters]
    values = tracked.model.parameters.copy()
    for name, size in by.items():
        values[names.index(name)] += size
    torque = tracked.model.torque(motion) + noise(motion.position.shape, seed + 1000, ar)
    if by:
        late = slice(int(at_s * 200.0), None)
        after = replace(tracked.model, parameters=values).torque(motion) - tracked.model.torque(motion)
        torque[late] += after[late]
    return Tracker(tracked).add(rows_of(tracked, replace(motion, torque=torque)))


def live(seconds: float) -> None:
    """The node fed with the simulated arm at 1 kHz, without tracking and with more and more of it."""
    from spacearm_ident.cli.demo import Plan, write_trajectory

    choices = {
        "no tracking": ("tracking:=false",),
        "levels": (),
        "levels, payload, alpha": ("tracking_payload:=true", "tracking_temperature:=true"),
    }
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        file = write_trajectory(Plan("excitation", 1, max(1, round(seconds * 0.1)), 0.1), folder)
        words = ["--model", MODEL, "--arm", MODEL.with_name("paper_arm.yaml"), "--trajectory", file]
        command = [sys.executable, "-m", "spacearm_ident.cli.main", "simulate", *words, "--out", folder / "run.mcap"]
        subprocess.run([*map(str, command), "--quiet"], check=True)
        streams = read_bag(folder / "run.mcap", {STATES_TOPIC: TOPIC_TYPES[STATES_TOPIC].name}.get).streams
        for what, choice in choices.items():
            print(f"{what:<24} {node_fed_with(list(streams[STATES_TOPIC].payloads), choice)}", flush=True)


def node_fed_with(payloads: list[bytes], choice: tuple[str, ...]) -> str:
    """What the identifier needs and says while these joint states come to it at 1 kHz."""
    import rclpy
    from bench_bus import cpu_s
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState, Temperature

    from spacearm_ident.canbus.realtime import come_first
    from spacearm_ident.nodes.runtime import STREAM

    parameters = [word for one in (f"model:={MODEL}", *choice) for word in ("-p", one)]
    command = [sys.executable, "-m", "spacearm_ident.cli.main", "node", "identifier", "--ros-args", *parameters]
    said: dict[str, dict[str, str]] = {}

    def keep(message: DiagnosticArray) -> None:
        said.update({s.name: {pair.key: pair.value for pair in s.values} for s in message.status})

    rclpy.init()
    with subprocess.Popen(command, start_new_session=True) as process:
        try:
            come_first(process.pid)
            node = rclpy.create_node("bench")
            states = node.create_publisher(JointState, STATES_TOPIC, STREAM)
            warmth = node.create_publisher(Temperature, TEMPERATURES_TOPIC, STREAM)
            node.create_subscription(DiagnosticArray, "/diagnostics", keep, 100)
            while not (states.get_subscription_count() and warmth.get_subscription_count() and said):
                rclpy.spin_once(node, timeout_sec=0.1)
            for joint in range(1, 7):
                warmth.publish(cdr.encode_temperature(0, f"joint_{joint}", 25.0))
            before, begun = cpu_s(process.pid), time.monotonic()
            for number, payload in enumerate(payloads):
                time.sleep(max(0.0, begun + number / 1000.0 - time.monotonic()))
                states.publish(payload)
            elapsed = time.monotonic() - begun
            share = (cpu_s(process.pid) - before) / elapsed
            said.clear()
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                rclpy.spin_once(node, timeout_sec=0.1)
        finally:
            process.send_signal(signal.SIGINT)
            rclpy.shutdown()
    followed, received = said.get("identifier: tracking", {}), said["identifier"]["received"]
    told = [f"{key} {followed[key]}" for key in ("core_share", "data_s", "informed", "changes") if followed]
    line = f"{elapsed:.0f} s, {received} of {len(payloads)} samples: the node {share:.1%} of a core"
    return ", ".join([line, *told])


def changes(model: IdentifiedModel, runs: int, payload: bool) -> None:
    print("with a payload followed" if payload else "levels alone followed")
    for words, by in CHANGES.items():
        if not payload and any(name.startswith("dm") for name in by):
            continue
        delay, error, named, others = [np.nan], [np.nan], Counter[str](), 0
        for seed in range(runs):
            at_s = 20.0 + 5.0 * seed / runs
            found = tracked_run(model, by, 40.0, at_s, seed, 0.5, payload)
            others += max(0, len(found) - 1)
            if found:
                delay.append(found[0].found_s - at_s)
                error.append(abs(found[0].time_s - at_s))
                named[found[0].what] += 1
        print(
            f"{words:<28} found {named.total()} of {runs}, delay median {np.nanmedian(delay):.2f} s, "
            f"largest {np.nanmax(delay):.1f} s; time wrong by {np.nanmedian(error):.2f} s (median); "
            f"named {dict(named)}; {others} further"
        )


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--seconds", type=float, default=60.0, help="of data for the cost")
    arguments.add_argument("--runs", type=int, default=20, help="a change")
    arguments.add_argument("--hours", type=float, default=1.0, help="of stationary motion for each kind of noise")
    arguments.add_argument("--live", type=float, metavar="SECONDS", help="measure the node, this long each, instead")
    options = arguments.parse_args()
    if options.live:
        live(options.live)
        return
    model = replace(load_model(MODEL), cutoff_hz=CUTOFF_HZ)
    for payload, temperature in ((False, False), (True, False), (True, True)):
        cost(model, payload, temperature, options.seconds)
    for payload in (False, True):
        changes(model, options.runs, payload)
    for ar in (0.0, 0.9, 0.99, 0.998):
        runs = max(1, round(options.hours * 4))
        found = [change for seed in range(runs) for change in tracked_run(model, {}, 900.0, 0.0, seed, ar)]
        kept = -0.005 / np.log(ar) if ar else 0.0
        most = max((change.significance for change in found), default=float("nan"))
        print(
            f"noise that keeps {kept:.3f} s: {len(found)} false alarms in {runs / 4:.2f} h of six joints"
            + (f" (largest {most:.1f} sigma)" if found else "")
        )


if __name__ == "__main__":
    main()
