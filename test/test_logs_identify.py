"""A UR10e's recording in the formats of others gives the parameters of its bag, by the proposed mapping alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_logs import CONSTANTS, UR10E, arm_file, german_csv, write_lerobot, write_mat

from spacearm_ident.cli.main import main
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.recording import Recording, read_recording, write_recording

SAME = 1e-6
"""Largest difference of a parameter, relative to the largest of its symbol at any joint (identification rounds)."""


@pytest.fixture(scope="module")
def ur10e() -> Recording:
    pytest.importorskip("clarabel", reason="needs clarabel")
    if not UR10E.exists():
        pytest.skip("no ur10e/commissioning.mcap in ../shared/recordings/real")
    return replace(read_recording(UR10E).between(0.0, 30.0), command=None, temperatures={})


def parameters(log: Path, out: Path, *words: str) -> dict[tuple[str, str], float]:
    """Symbol and joint -> value, as the command identifies them."""
    named = ["identify", str(log), "--quiet", "--friction", "coulomb-viscous", "--out", str(out), *words]
    assert main(named) in (0, 3)
    model = load_model(out / "model.yaml")
    return {
        (parameter.symbol, parameter.joint): float(value)
        for parameter, value in zip(model.model.parameters, model.parameters, strict=True)
    }


def in_episodes(run: Recording) -> Recording:
    """What `write_lerobot` keeps: two episodes of even rows, a pause of a second between them, no velocity."""
    half = len(run.time) // 2
    rate = 1.0 / np.median(np.diff(run.time))
    time = np.arange(2 * half) / rate
    time[half:] += max(1.0, 100.0 / rate) - 1.0 / rate
    rows = slice(0, 2 * half)
    still = np.full_like(run.velocity[rows], np.nan)
    return replace(
        run, time=time, position=run.position[rows], velocity=still, effort=run.effort[rows],
        segments=(slice(0, half), slice(half, 2 * half)),
    )  # fmt: skip


@pytest.fixture(scope="module")
def expected(ur10e, tmp_path_factory):
    """Parameters from the bag, and from one with the stamps that a LeRobot dataset of it has."""
    folder = tmp_path_factory.mktemp("bags")
    runs = {"bag": ur10e, "episodes": in_episodes(ur10e)}
    for name, run in runs.items():
        write_recording(folder / f"{name}.mcap", run)
    return runs, {name: parameters(folder / f"{name}.mcap", folder / name) for name in runs}


def require_same(got: dict[tuple[str, str], float], wanted: dict[tuple[str, str], float]) -> None:
    assert got.keys() == wanted.keys()
    size: dict[str, float] = {}
    for (symbol, _), value in wanted.items():
        size[symbol] = max(size.get(symbol, 0.0), abs(value))
    off = {key: abs(got[key] - value) / (size[key[0]] or 1.0) for key, value in wanted.items()}
    assert max(off.values()) < SAME, max(off.items(), key=lambda item: item[1])


@pytest.mark.parametrize("form", ["csv", "mat", "db3", "lerobot"])
def test_a_log_of_the_ur10e_gives_the_parameters_of_its_bag_without_a_line_by_hand(form, expected, tmp_path):
    runs, wanted = expected
    source = "episodes" if form == "lerobot" else "bag"
    run = runs[source]
    arm = arm_file(tmp_path, run.urdf, dict(zip(run.joints, CONSTANTS.tolist())) if form == "csv" else None)
    log = tmp_path / f"log.{form}"
    match form:
        case "csv":
            german_csv(run, log, CONSTANTS)
        case "mat":
            write_mat(run, log)
        case "lerobot":
            write_lerobot(runs["bag"], log)
        case "db3":
            pytest.importorskip("rosbags", reason="needs rosbags")
            from test_ros_bags import write_bag

            write_bag(run, log)
    if form != "db3":  # a bag needs no mapping
        assert main(["import", str(log), "--arm", str(arm), "--quiet"]) == 0
    words = [] if form == "db3" else ["--arm", str(arm)]
    require_same(parameters(log, tmp_path / "result", *words), wanted[source])
