"""How long `read_recording` takes for 60,000 samples of 6 joints, next to the usual ROS 2 bag readers.

Run: `python bench/bench_reading.py [samples]`. All three produce the same arrays of stamps, positions,
velocities and efforts from the same bag; ours also checks CRCs, hashes the file and splits at gaps. What
counts are the ratios: seconds depend on the machine.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from spacearm_ident.recording import Recording, messages, read_recording, write_recording

REPEATS = 3


def example(samples: int) -> Recording:
    time_s = np.arange(samples) / 1000.0
    noise = np.random.default_rng(0).normal(size=(samples, 6)) * 1e-4
    position = np.sin(time_s[:, None] * np.linspace(0.5, 1.5, 6)) + noise
    return Recording(
        joints=tuple(f"joint_{number}" for number in range(1, 7)),
        time=time_s,
        position=position,
        velocity=np.gradient(position, 1e-3, axis=0),
        effort=20.0 * position + noise,
        segments=(slice(0, samples),),
        start_ns=1_753_000_000_000_000_000,
        urdf="<robot name='bench'/>",
    )


def ours(folder: Path) -> np.ndarray:
    return read_recording(folder).effort


def effort_of(rows: Iterable[Any]) -> np.ndarray:
    stamps, position, velocity, effort = [], [], [], []
    for row in rows:
        stamps.append(row.header.stamp.sec * 10**9 + row.header.stamp.nanosec)
        position.append(row.position)
        velocity.append(row.velocity)
        effort.append(row.effort)
    return [np.array(column) for column in (stamps, position, velocity, effort)][3]


def with_mcap_ros2(folder: Path) -> np.ndarray:
    with next(folder.glob("*.mcap")).open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return effort_of(row for *_, row in reader.iter_decoded_messages(topics=[messages.STATES_TOPIC]))


def with_rosbags(folder: Path) -> np.ndarray:
    with AnyReader([folder]) as reader:
        wanted = [c for c in reader.connections if c.topic == messages.STATES_TOPIC]
        rows = reader.messages(connections=wanted)
        return effort_of(reader.deserialize(payload, connection.msgtype) for connection, _, payload in rows)


def best(read: Callable[[Path], np.ndarray], folder: Path, repeats: int) -> tuple[float, np.ndarray]:
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        effort = read(folder)
        seconds.append(time.perf_counter() - start)
    return min(seconds), effort


def main() -> None:
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 60_000
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "run"
        start = time.perf_counter()
        write_recording(folder, example(samples))
        print(f"write_recording   {time.perf_counter() - start:7.3f} s   {samples} samples of 6 joints")
        reference, effort = best(ours, folder, REPEATS)
        print(f"read_recording    {reference:7.3f} s")
        for name, read in (("mcap_ros2_support", with_mcap_ros2), ("rosbags", with_rosbags)):
            seconds, theirs = best(read, folder, 1)
            assert np.array_equal(effort, theirs)
            print(f"{name:17} {seconds:7.3f} s   {seconds / reference:6.1f} times as long")


if __name__ == "__main__":
    main()
