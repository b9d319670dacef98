"""figaroh's side of `peers.py`: runs in figaroh's own Python, answers one JSON line a request.

A subclass of `BaseIdentification` such as its users write: positions and torque from a CSV file, its own filter
and differentiation, every option of its model on (viscous and Coulomb friction, actuator inertia, offset), least
squares, then weighted least squares. Samples near the filter's edges are masked, with its own sample mask.
"""

from __future__ import annotations

import logging
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pandas
import yaml
from figaroh.data.trajectory import TrajectoryData
from figaroh.identification.base_identification import BaseIdentification
from figaroh.tools.load_robot import load_robot
from figaroh.tools.regressor import build_regressor_basic, build_regressor_reduced
from worker_loop import serve

EDGE_S = 0.5


class Identification(BaseIdentification):
    """An arm's identification from CSV files, all motions in one trajectory."""

    def __init__(self, robot, config, joints, files):
        self.joints, self.files = tuple(joints), files
        super().__init__(robot, str(config))
        # The unified configuration leaves the indices of the joints to the caller, as figaroh's examples do.
        indices = [robot.model.getJointId(joint) - 1 for joint in joints]
        self.identif_config.update(act_idxq=indices, act_idxv=indices)

    def load_trajectory_data(self, data_source=None):
        """The files one after another; the samples beside a seam or an end are masked."""
        frames = [read(path) for path in self.files]
        times, masks, end = [], [], 0.0
        for time_s, *_ in frames:
            masks.append((time_s > time_s[0] + EDGE_S) & (time_s < time_s[-1] - EDGE_S))
            times.append(end + time_s - time_s[0])
            end = times[-1][-1] + float(np.median(np.diff(time_s)))
        return TrajectoryData(
            t=np.concatenate(times),
            joint_names=self.joints,
            q=np.concatenate([frame[1] for frame in frames]),
            effort=np.concatenate([frame[2] for frame in frames]),
            effort_kind="joint_torque",
            effort_unit="N·m",
            mask=np.concatenate(masks),
        )


def read(path):
    frame = pandas.read_csv(path)
    joints = (len(frame.columns) - 1) // 2
    q, tau = ([f"{name}{k}" for k in range(joints)] for name in ("q", "tau"))
    return frame["t"].to_numpy(), frame[q].to_numpy(), frame[tau].to_numpy()


def configuration(folder, joints, rate_hz, cutoff_hz):
    zeros = [0.0] * len(joints)
    document = {
        "robot": {
            "name": "arm",
            "properties": {
                "joints": {"active_joints": list(joints)},
                "mechanics": {
                    "friction_coefficients": {"viscous": zeros, "static": zeros},
                    "actuator_inertias": zeros,
                    "joint_offsets": zeros,
                },
            },
        },
        "tasks": {
            "identification": {
                "enabled": True,
                "problem": {
                    "model_components": {"friction": True, "actuator_inertia": True, "joint_offset": True},
                    "wls": True,
                },
                "signal_processing": {"sampling_frequency": rate_hz, "cutoff_frequency": cutoff_hz},
            }
        },
    }
    path = Path(folder) / "figaroh.yaml"
    path.write_text(yaml.safe_dump(document))
    return path


class Worker:
    """What `peers.py` may ask for."""

    def __init__(self, urdf, joints, folder):
        self.robot = load_robot(urdf, load_by_urdf=True)
        self.joints, self.folder = joints, folder
        self.config = None

    def configure(self, rate_hz, cutoff_hz):
        """Write the configuration file."""
        self.config = configuration(self.folder, self.joints, rate_hz, cutoff_hz)
        return {}

    def identify(self, files, decimation, motions, out):
        """Time of everything after reading; predicted torque by motion."""
        task = Identification(self.robot, self.config, self.joints, files)
        data = task.load_trajectory_data()
        task.load_trajectory_data = lambda data_source=None: data
        start = time.process_time()
        task.initialize()
        task.solve(decimate=decimation > 1, decimation_factor=decimation, plotting=False, wls=True)
        seconds = time.process_time() - start
        torques = {}
        for number, motion in enumerate(motions):
            q, qd, qdd = (np.load(motion)[key] for key in ("q", "qd", "qdd"))
            matrix = build_regressor_basic(self.robot, q, qd, qdd, task.identif_config)
            base = build_regressor_reduced(matrix, task._idx_eliminated)[:, task._base_indices]
            torques[str(number)] = (base @ task.phi_base).reshape(len(self.joints), len(q)).T
        np.savez(out, **torques)
        return {"seconds": seconds, "parameters": len(task.phi_base)}


def main():
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    urdf, folder, *joints = sys.argv[1:]
    serve(lambda: Worker(urdf, joints, folder))


if __name__ == "__main__":
    main()
