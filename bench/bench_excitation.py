"""Excitation: which criterion, how fast, and what slow segments are worth.

    python bench/bench_excitation.py [--seeds 5] [--only ur10|criteria|slow]

- *ur10*: the problem that others' tools were measured on: a UR10, Coulomb and viscous friction and rotor inertia, 52
  columns, 10 s, 0.1 Hz, 5 harmonics, limits of motion alone. Column-scaled condition number on 5000 samples, and
  seconds of processor and of clock (the machine is shared).
- *criteria*: that UR10 again, and the paper's arm under all its limits, five periods of 10 s. Every criterion is
  optimised and judged by the standard deviation of torques predicted on random motions that no optimiser has seen,
  for torque noise of 0.35 % of each joint's limit, white, at 1 kHz. Medians over the seeds.
- *slow*: the same run with and without slow sines; relative errors of the Stribeck velocities.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from spacearm_ident.config import config_path
from spacearm_ident.dynamics.arm import Arm, arm_from_urdf, load_arm
from spacearm_ident.dynamics.model import IdentifiedModel, TorqueModel
from spacearm_ident.dynamics.model_file import load_model
from spacearm_ident.excitation.clearance import Clearance
from spacearm_ident.excitation.composite import with_slow_segment
from spacearm_ident.excitation.constraints import Requirements
from spacearm_ident.excitation.criteria import CONDITION, CRITERIA, D_OPTIMAL, SCALED_CONDITION, Information, Question
from spacearm_ident.excitation.genetic import evolve
from spacearm_ident.excitation.nominal import nominal_model
from spacearm_ident.excitation.optimise import Excitation, optimise
from spacearm_ident.excitation.problem import Problem
from spacearm_ident.excitation.run import limits_of
from spacearm_ident.excitation.trajectory import FourierTrajectory, MotionLimits, draw_coefficients

HALF_TURN = np.pi / 2
UR10 = (  # name, rpy y, xyz, axis, mass, centre of mass z, inertia about it xx = yy, zz (ur_description, BSD)
    ("shoulder_pan", 0.0, (0, 0, 0.1273), "0 0 1", 7.778, 0.0, 0.0314743125769, 0.021875625),
    ("shoulder_lift", HALF_TURN, (0, 0.220941, 0), "0 1 0", 12.93, 0.306, 0.421753803798, 0.036365625),
    ("elbow", 0.0, (0, -0.1719, 0.612), "0 1 0", 3.87, 0.28615, 0.111069694097, 0.010884375),
    ("wrist_1", HALF_TURN, (0, 0, 0.5723), "0 1 0", 1.96, 0.0, 0.0051082479567, 0.0055125),
    ("wrist_2", 0.0, (0, 0.1149, 0), "0 0 1", 1.96, 0.0, 0.0051082479567, 0.0055125),
    ("wrist_3", 0.0, (0, 0, 0.1157), "0 1 0", 0.202, 0.0, 0.000526462289415, 0.000568125),
)
UR10_TORQUE = {"shoulder_pan": 330, "shoulder_lift": 330, "elbow": 150, "wrist_1": 54, "wrist_2": 54, "wrist_3": 54}
UR10_CENTRE = np.array([0.0, -1.3, 0.6, 0.0, 0.0, 0.0])
UR10_HALF = np.array([2.8, 1.5, 2.0, 2.8, 2.8, 2.8])
UR10_VELOCITY = np.array([2.0, 2.0, 2.5, 3.0, 3.0, 3.0])
UR10_ACCELERATION = np.array([6.0, 6.0, 8.0, 12.0, 12.0, 12.0])
JUDGES = 10


def ur10() -> Arm:
    parts, parent = ['<robot name="ur10"><link name="base"/>'], "base"
    for name, turn, xyz, axis, mass, com, across, along in UR10:
        parts.append(
            f'<joint name="{name}" type="revolute"><origin rpy="0 {turn!r} 0" xyz="{xyz[0]} {xyz[1]} {xyz[2]}"/>'
            f'<parent link="{parent}"/><child link="{name}_link"/><axis xyz="{axis}"/>'
            f'<limit effort="{UR10_TORQUE[name]}" lower="-6.28" upper="6.28" velocity="3.2"/></joint>'
            f'<link name="{name}_link"><inertial><mass value="{mass}"/><origin xyz="0 0 {com}"/>'
            f'<inertia ixx="{across}" ixy="0" ixz="0" iyy="{across}" iyz="0" izz="{along}"/></inertial></link>'
        )
        parent = f"{name}_link"
    return arm_from_urdf("".join([*parts, "</robot>"]))


def ur10_problem() -> Problem:
    identified = nominal_model(ur10(), "coulomb-viscous")
    limits = MotionLimits(UR10_CENTRE - UR10_HALF, UR10_CENTRE + UR10_HALF, UR10_VELOCITY, UR10_ACCELERATION)
    needs = Requirements(limits, np.full(6, np.inf), identified)
    return Problem(Question.of(identified), needs, SCALED_CONDITION, 0.1, 5, 1, UR10_CENTRE)


def information(problem: Problem, series: FourierTrajectory) -> Information:
    return problem.question.information(series.evaluate(np.arange(5000) / 500.0), 500.0)


def bench_ur10(seeds: int) -> None:
    problem = ur10_problem()
    scaled, raw = [], []
    for seed in range(20):
        values = information(problem, drawn(problem, seed)).values()
        scaled.append(values[SCALED_CONDITION])
        raw.append(values[CONDITION])
    print(f"UR10, {len(problem.question.leads)} columns, 10 s, 5 harmonics of 0.1 Hz")
    print(f"  {'':28}{'scaled cond':>12}{'raw cond':>10}{'processor s':>13}{'clock s':>9}")
    print(f"  {'random feasible, median of 20':28}{np.median(scaled):11.2f}{np.median(raw):10.1f}")
    methods: list[tuple[str, Callable[[Problem, int], Excitation], range]] = [
        ("gradient", optimise, range(seeds)),
        ("genetic", evolve, range(min(seeds, 2))),
    ]
    for name, method, tried in methods:
        for seed in tried:
            processor, clock = time.process_time(), time.perf_counter()
            found = method(problem, seed)
            processor, clock = time.process_time() - processor, time.perf_counter() - clock
            values = information(problem, found.series).values()
            print(
                f"  {f'{name}, seed {seed}':28}{values[SCALED_CONDITION]:12.2f}{values[CONDITION]:10.1f}"
                f"{processor:13.1f}{clock:9.1f}",
                flush=True,
            )


def paper_problem() -> Problem:
    arm = load_arm(config_path("paper_arm.yaml"))
    known = load_model(config_path("paper_arm_model.yaml"))
    identified = IdentifiedModel(TorqueModel(arm, known.model.structure), known.parameters, known.constants)
    limits = limits_of(arm, arm.joint_names)
    needs = Requirements.of(identified, limits, clearance=Clearance(arm, 0.0, limits.lower, limits.upper))
    return Problem(Question.of(identified), needs, D_OPTIMAL, 0.1, 5, 5, np.zeros(6))


def bench_criteria(name: str, problem: Problem, seeds: int) -> None:
    judges = [drawn(problem, 1000 + k) for k in range(JUDGES)]
    tests = [information(problem, judge) for judge in judges]
    print(f"{name}; sd of torques predicted on motions not seen, mN·m")
    print(f"  {'optimised':20}{'raw cond':>9}{'scaled':>8}{'D':>7}   " + "".join(f"{f'J{k}':>7}" for k in range(1, 7)))
    for criterion in CRITERIA:
        wanted = replace(problem, criterion=criterion)
        show(criterion, [judged(problem, optimise(wanted, seed).series, tests) for seed in range(seeds)])
    wanted = replace(problem, criterion=SCALED_CONDITION)
    show("scaled, genetic", [judged(problem, evolve(wanted, 0).series, tests)])
    show("random feasible", [judged(problem, drawn(problem, seed), tests) for seed in range(20)])


def drawn(problem: Problem, seed: int) -> FourierTrajectory:
    a, b, centre = draw_coefficients(np.random.default_rng(seed), problem.needs.motion, 0.1, 5, (0.6, 0.9))
    return FourierTrajectory(problem.joints, centre, a, b, 0.1, 5)


def judged(problem: Problem, series: FourierTrajectory, tests: list[Information]) -> list[float]:
    found = information(problem, series)
    return [*found.values().values(), *(1e3 * found.prediction_sd(tests, 50_000))]


def show(name: str, rows: list[list[float]]) -> None:
    raw, scaled, volume, *sd = np.median(rows, axis=0)
    print(f"  {name:20}{raw:9.0f}{scaled:8.1f}{volume:7.2f}   " + "".join(f"{value:7.2f}" for value in sd), flush=True)


def bench_slow() -> None:
    problem = paper_problem()
    found = optimise(problem, 0)
    print("relative standard errors of v_b, %, one run of the paper's arm")
    for periods in (0, 1, 3):
        run = with_slow_segment(found.run, problem.needs, periods) if periods else found.run
        times = np.arange(0.0, run.duration_s, 1e-3)
        told = problem.question.information(run.evaluate(times), 1000.0)
        errors = told.relative_errors(len(times))
        words = f"{periods} slow sines of 10 s" if periods else "without"
        print(f"  {words:24}{run.duration_s:6.1f} s   " + "".join(f"{100 * value:8.2f}" for value in errors.values()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--only", choices=("ur10", "criteria", "slow"))
    options = parser.parse_args()
    if options.only in (None, "ur10"):
        bench_ur10(options.seeds)
    if options.only in (None, "criteria"):
        bench_criteria("UR10, limits of motion, 5 x 10 s", ur10_problem(), options.seeds)
        bench_criteria("the paper's arm, all limits, 5 x 10 s", paper_problem(), options.seeds)
    if options.only in (None, "slow"):
        bench_slow()


if __name__ == "__main__":
    main()
