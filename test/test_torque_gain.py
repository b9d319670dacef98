"""A torque gain that is off moves parameters as predicted, and is a component of its own beside the standard error."""

from __future__ import annotations

import csv
import io
import math
from dataclasses import replace

import numpy as np
import pytest
from planted_arm import Friction, Planted, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.estimate.identified import GAIN_DEVIATION, Determination
from spacearm_ident.identification.fit import fit_model
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.torque_gain import gain_shifts
from spacearm_ident.results.tables import parameters_csv
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.separable import system

LAW = Friction(f_c=5.0, k_v1=4.0, k_v2=0.0, k_v3=0.0)


@pytest.fixture(scope="module")
def planted() -> Planted:
    return two_link_run((LAW, LAW))


def fitted(planted: Planted, gain=(1.0, 1.0)):
    recording = planted.recording(noise=0.05)
    recording = replace(recording, effort=recording.effort * np.array(gain))
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([recording], arm.joint_names, 20.0)
    return fit_model(TorqueModel(arm, structure_of(arm, "coulomb-viscous")), motions)


def shifts_of(fit) -> np.ndarray:
    matrix, _ = system(fit.regression, fit.prior, fit.solution.constants)
    return gain_shifts(fit, matrix)


@pytest.mark.parametrize("joint", [0, 1])
def test_a_gain_off_by_five_percent_at_one_joint_shifts_friction_as_predicted(planted, joint):
    right, wrong = fitted(planted), fitted(planted, [1.05 if k == joint else 1.0 for k in range(2)])
    friction = [k for k, p in enumerate(right.regression.model.parameters) if p.symbol in ("f_c", "k_v1")]
    moved = (wrong.solution.parameters - right.solution.parameters)[friction]
    expected = 0.05 * shifts_of(right)[joint][friction]
    np.testing.assert_allclose(moved, expected, atol=0.03 * np.abs(expected).max())


def test_gains_off_alike_scale_every_parameter(planted):
    fit = fitted(planted)
    free = [k for k in fit.prior.free if fit.regression.model.parameters[k].symbol in ("f_c", "k_v1", "offset")]
    np.testing.assert_allclose(shifts_of(fit).sum(axis=0)[free], fit.solution.parameters[free], rtol=0.02, atol=0.02)


def test_friction_carries_the_whole_gain_error_of_its_joint_and_constants_none(planted):
    arm = arm_from_urdf(planted.urdf)
    result = identify([planted.recording(noise=0.05)], arm, Settings(structure=structure_of(arm, "coulomb-viscous")))
    found = {item.name: item for item in result.estimates}
    f_c = found["f_c[shoulder]"]
    assert f_c.gain_error == pytest.approx(GAIN_DEVIATION * f_c.value, rel=0.05)
    low, high = f_c.interval_with_gain
    assert high - low > f_c.interval[1] - f_c.interval[0]
    for item in result.estimates:
        if item.determination in (Determination.FIXED, Determination.PRIOR):
            assert math.isnan(item.gain_error)
    rows = {(row["name"], row["joint"]): row for row in csv.DictReader(io.StringIO(parameters_csv(result)))}
    assert float(rows["f_c", "shoulder"]["ci95_with_gain_low"]) == low
