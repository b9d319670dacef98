"""The live chain beside a busy core: samples lost, lateness, CPU, and whether the parameters are those simulated.

    python bench/bench_live.py [--out DIR] [--idle]

The same chain as `spacearm demo`: five processes, CAN frames, DDS; five periods of 10 s to identify, three of
another excitation to validate, while a process spins on one core (`--idle`: none). Samples are counted by the
SYNC stamps of the frames they came in: a slot of the 1 ms cycle without a sample in the bag must be one that the
driver has counted as missed (it was not scheduled) or incomplete (a drive's answer came too late).
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from bench_bus import cpu_s
from bench_simulated_arm import base_scores, scores, share
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from spacearm_ident.cli.demo import PLANS, begin, node_parameters, perform, write_trajectory
from spacearm_ident.config import config_path
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.nodes.chain import Chain
from spacearm_ident.recording import read_recording
from spacearm_ident.results.store import load_result

TABLE_2_NM = (3.9462, 5.0670, 3.2432, 1.4323, 1.0583, 1.1698)
"""RMSE of the paper's validation, joint by joint (Jing et al. 2025, table 2)."""
SMALLEST_R = 0.97
CYCLE_S = 1e-3


def cpu_times(chain: Chain) -> dict[str, float]:
    return {name: cpu_s(pid) for name, pid in chain.processes.items()}


def live(folder: Path) -> None:
    """Both runs; prints what the nodes counted."""
    files = [write_trajectory(plan, folder) for plan in PLANS]
    with Chain(folder, node_parameters(folder)) as chain:
        begin(chain)
        for plan, file in zip(PLANS, files):
            before, start = cpu_times(chain), os.times().elapsed
            perform(chain, plan, file, lambda *_: None)
            elapsed = os.times().elapsed - start
            if plan is PLANS[0]:
                shares = {name: (cpu - before[name]) / elapsed for name, cpu in cpu_times(chain).items()}
        recorded = chain.values("recorder: topics")["/joint_states"]
        print(f"recorder      {chain.call('/recorder/stop')}; /joint_states: {recorded}")
        values = chain.values("canopen_driver")
        streamed, arm = chain.values("trajectory"), chain.values("simulated_arm")
        chain.call("/driver/enable", False)
    late = " ".join(f"{float(values[f'lateness_{q}_us']):.0f}" for q in ("p50", "p99", "p999"))
    print(
        f"cycle         {values['cycles']} cycles, lateness {late} µs (p50 p99 p99.9); {values['missed_cycles']} missed"
    )
    print(f"set-points    {streamed['set_points']} in the last run, {streamed['late']} late")
    print(f"drives        {arm['physics_steps_skipped']} steps skipped, {arm['sync_unanswered']} SYNCs unanswered")
    print("CPU           " + ", ".join(f"{name} {share:.0%}" for name, share in shares.items()) + " of a core")
    found = count_samples(next((folder / "recordings").glob("*/")))
    print(
        "samples       {slots} slots, {published} published, {in_bag} in the bag ({missed} slots missed, "
        "{incomplete} incomplete: {without} without); largest gap {largest_gap_ms:.0f} ms".format(**found)
    )


def count_samples(bag: Path) -> dict[str, Any]:
    """Compare the samples in the bag with what the driver says in the same bag, between two of its words.

    Returns:
        Slots of the cycle; samples published and in the bag; slots missed, incomplete and without a sample; gaps, the
        largest in ms, and by how many µs intervals without a gap differ from the cycle (50, 99 and 99.9 %).
    """
    first, last = said_by_driver(bag)
    recording = read_recording(bag)
    stamps = 1e-9 * recording.start_ns + recording.time
    inside = stamps[(stamps > first[0]) & (stamps <= last[0])]
    slots = round(np.ptp(inside) / CYCLE_S) + 1
    samples, missed, incomplete = (after - before for before, after in zip(first[1:], last[1:]))
    steps = np.diff(inside)
    off = np.abs(steps[steps < 1.5 * CYCLE_S] - CYCLE_S)
    return {
        "slots": slots,
        "published": samples,
        "in_bag": len(inside),
        "missed": missed,
        "incomplete": incomplete,
        "without": slots - len(inside),
        "gaps": sum(issue.count for issue in recording.issues if issue.kind == "gap"),
        "largest_gap_ms": 1e3 * float(steps.max()),
        "jitter_us": [1e6 * float(value) for value in np.quantile(off, (0.5, 0.99, 0.999))],
    }


def said_by_driver(bag: Path) -> list[tuple[float, int, int, int]]:
    """Time (s), samples, missed and incomplete cycles from the driver's third and last diagnostics."""
    said = []
    with next(bag.glob("*.mcap")).open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for *_, message in reader.iter_decoded_messages(topics=["/diagnostics"]):
            for status in message.status:
                if status.name == "canopen_driver":
                    values = {pair.key: pair.value for pair in status.values}
                    counts = (int(values[key]) for key in ("samples", "missed_cycles", "incomplete_cycles"))
                    said.append((message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec, *counts))
    # At first the recorder is still joining topics.
    return [said[2], said[-1]]


def judge(folder: Path) -> bool:
    """Parameters against those simulated, validation against the paper's; whether all is reached."""
    result = load_result(folder)
    model = load_model(config_path("paper_arm_model.yaml"))
    truth = {p.name: v for p, v in zip(model.model.parameters, model.parameters)}
    truth |= {c.name: v for c, v in zip(model.model.constants, model.constants)}
    found = scores(result.identified, truth)
    z = np.array([score for *_, score in found])
    print(share("parameters within three standard errors", z, 3.0))
    print(share("base parameters within three", base_scores(result.identified, truth), 3.0))
    for _, name, score in found:
        if abs(score) > 3.0:
            print(f"    {name} is {score:+.1f} standard errors off")
    good = bool(np.all(np.abs(z) <= 3.0))
    for mark, (joint, fit) in zip(TABLE_2_NM, result.validation.joints.items()):
        print(
            f"{joint}       RMSE {fit.everything.rmse:.3f} N·m (paper {mark:.3f})   R {fit.everything.correlation:.4f}"
        )
        good = good and fit.everything.correlation > SMALLEST_R and fit.everything.rmse < mark
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, metavar="DIR", help="keep what is recorded and identified here")
    parser.add_argument("--idle", action="store_true", help="leave the other core alone")
    options = parser.parse_args()
    busy = None if options.idle else subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        with tempfile.TemporaryDirectory() as scratch:
            folder = options.out or Path(scratch)
            folder.mkdir(parents=True, exist_ok=True)
            live(folder)
            good = judge(folder)
    finally:
        if busy is not None:
            busy.kill()
            busy.wait()
    print("all reached" if good else "NOT all reached")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
