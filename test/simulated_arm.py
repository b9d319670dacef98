"""The paper's arm for tests: its parameters, limits and drives from config/."""

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from spacearm_ident.excitation.trajectory import MotionLimits
from spacearm_ident.simulation.plant import PlantParameters
from spacearm_ident.simulation.servo import DriveData

CONFIG = Path(__file__).parent.parent / "config"


@cache
def paper_arm() -> PlantParameters:
    document = yaml.safe_load((CONFIG / "paper_arm_model.yaml").read_text())
    return PlantParameters.from_model(document, (CONFIG / "paper_arm.urdf").read_text())


@cache
def arm_document() -> dict:
    return yaml.safe_load((CONFIG / "paper_arm.yaml").read_text())


def column(key: str) -> np.ndarray:
    return np.array([arm_document()["joints"][name][key] for name in paper_arm().joints], dtype=float)


def paper_limits() -> MotionLimits:
    model = pin.buildModelFromXML(paper_arm().urdf)
    return MotionLimits(
        model.lowerPositionLimit,
        model.upperPositionLimit,
        column("velocity_limit_rad_s"),
        column("acceleration_limit_rad_s2"),
    )


def paper_drives() -> DriveData:
    return DriveData.plain(
        6,
        gear_ratio=column("gear_ratio"),
        torque_constant=column("torque_constant_Nm_per_A"),
        torque_limit=column("torque_limit_Nm"),
    )
