"""How much more of a motion a healthy arm leaves that is faster than its reference, and how often it is an alarm.

    .venv/bin/python bench/healthy_growth.py [--recordings DIR] [--draws DIR ...]

Pairs of healthy recordings of real arms (`real_pairs.py`) and, where given, the healthy arms of the blind series
(`blind_series/draw.py`). At every joint, of what is judged and of the field: the log ratio of what the reference's
model leaves to what is left of parts of the reference that a fit left out, the error of the prediction beside it,
against the log ratio of the joint's RMS accelerations where that is above zero (`mismatch.healthy.GROWS`).
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from pathlib import Path

os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")

import numpy as np
from real_pairs import trials

from spacearm_ident.dynamics.arm import Arm, arm_from_urdf, load_arm
from spacearm_ident.errors import UserError
from spacearm_ident.mismatch.base_structure import choose_base
from spacearm_ident.mismatch.explain import held_out_ends
from spacearm_ident.mismatch.healthy import healthy_levels
from spacearm_ident.mismatch.preparation import prepare_evidence
from spacearm_ident.mismatch.residuals import Residuals
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording import read_recording


def joints(arm: Arm, runs: RunSet) -> Iterator[tuple[float, float, float]]:
    """By joint and scene: log ratio of accelerations, log ratio of residuals, and residual over what is an alarm."""
    prepared = prepare_evidence(arm, runs, choose_base)
    evidence = prepared.evidence
    if not prepared.weighted or prepared.modelled or evidence.reference is None:
        return
    judged = [Residuals(evidence, scene, prepared.plain) for scene in (prepared.held_out.scene, evidence.field)]
    reference = Residuals(evidence.healthy, evidence.reference, prepared.plain)
    for rows, healthy in zip(judged, healthy_levels(evidence, prepared, judged)):
        left_out = healthy.left_out
        if left_out is None or not left_out.known:
            continue
        left = rows.rms(rows.of(healthy.parameters, [], np.zeros(0)))
        own = reference.rms(reference.of(healthy.parameters, [], np.zeros(0)))
        known = np.hypot(np.fmax(own, left_out.rms_Nm), left_out.error_Nm(rows))
        with np.errstate(divide="ignore", invalid="ignore"):
            faster = np.log(rows.acceleration() / reference.acceleration())
            found = np.stack([faster, np.log(left / known), left / healthy.detectable_Nm], axis=1)
        yield from map(tuple, found[np.isfinite(found).all(axis=1)].tolist())


def real(root: Path) -> Iterator[tuple[Arm, RunSet]]:
    """Pairs of real recordings, the field's last third held out."""
    for trial in trials(root):
        if trial.group == "pairs":
            references, field = trial.bags()
            fitted, ends = held_out_ends([field])
            yield load_arm(root / trial.arm / "arm.urdf"), RunSet(fitted, references, ends)


def simulated(draws: Path) -> Iterator[tuple[Arm, RunSet]]:
    """Healthy trials of a blind series."""
    for answer in sorted((draws / "answers").glob("*.json")):
        if json.loads(answer.read_text(encoding="utf-8"))["composition"] == "healthy":
            bags = draws / "bags" / answer.stem
            field, reference, judged = (
                [read_recording(bag) for bag in sorted(bags.glob(f"{part}*.mcap"))]
                for part in ("field", "reference", "validation")
            )
            yield arm_from_urdf(field[0].urdf or ""), RunSet(field, reference, judged)


def summary(name: str, found: list[tuple[float, float, float]]) -> str:
    """The slope with its standard error, and how many are an alarm."""
    faster, left, share = np.array(found).T
    columns = np.stack([np.maximum(faster, 0.0), np.ones(len(faster))], axis=1)
    slope, squares = np.linalg.lstsq(columns, left, rcond=None)[:2]
    error = np.sqrt(squares[0] / (len(left) - 2) * np.linalg.inv(columns.T @ columns)[0, 0])
    beyond = np.mean(share > 1.0)
    return f"{name}: {len(found)} joints, power {slope[0]:.2f} +- {error:.2f}; {beyond:.1%} above what is an alarm"


def main() -> None:
    """Print a line for the real arms, and one for each blind series."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("../shared/recordings/real"), metavar="DIR")
    parser.add_argument(
        "--draws", type=Path, nargs="+", default=[], metavar="DIR", help="of bench/blind_series/draw.py"
    )
    options = parser.parse_args()
    sources = {"real": real(options.recordings), **{str(draws): simulated(draws) for draws in options.draws}}
    for name, source in sources.items():
        found: list[tuple[float, float, float]] = []
        for arm, runs in source:
            try:
                found.extend(joints(arm, runs))
            except UserError as error:
                print(f"{name}: one pair left out: {error}")
        print(summary(name, found), flush=True)


if __name__ == "__main__":
    main()
