"""What parameters that are left out hide: the same as fitting again with them free."""

from __future__ import annotations

import numpy as np
import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import TorqueModel, structure_of
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.noise.omitted import held_columns, hidden_shifts
from spacearm_ident.regression.prior import make_prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.separable import without_constants

LAWS = (Friction(k_1=0.8), Friction(f_c=3.0))


def test_the_shift_is_that_of_a_fit_with_the_spring_free():
    planted = two_link_run(LAWS, periodic=True)
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([planted.recording(noise=0.1)], arm.joint_names)
    held_structure = structure_of(arm, "coulomb-viscous")
    fits = []
    for structure in (held_structure, {**held_structure, "joint_spring": {"free": ["shoulder"]}}):
        model = TorqueModel(arm, structure)
        regression, prior = Regression(model, motions), make_prior(model, motions)
        for rows in regression.rows:
            rows.set_weight(np.full(len(rows.torque), 30.0))
        fits.append((regression, prior, without_constants(regression, prior)))
    regression, prior, held = fits[0]
    free = {p.name: v for p, v in zip(fits[1][0].model.parameters, fits[1][2].parameters)}
    names = [p.name for p in regression.model.parameters]
    expected = np.array([free[name] for name in names]) - held.parameters
    expected[names.index("k_1[shoulder]")] = 0.0

    # All columns without a constant: f_b is held, f_c's column is that of the sign.
    columns = [rows.fixed for rows in regression.rows]
    numbers = [list(rows.indices) for rows in regression.rows]
    for term, _, _ in regression.shaped_terms():
        for joint, (indices, shaped) in regression.shaped(term, (0.0, 0.0)).items():
            columns[joint] = np.column_stack([columns[joint], shaped])
            numbers[joint] = [*numbers[joint], *indices]
    weighted = [block * rows.weight[:, None] for block, rows in zip(columns, regression.rows)]
    information = prior.rows.T @ prior.rows
    for number, block in zip(numbers, weighted):
        information[np.ix_(number, number)] += block.T @ block
    inverse = np.zeros_like(information)
    inverse[np.ix_(prior.free, prior.free)] = np.linalg.inv(information[np.ix_(prior.free, prior.free)])
    residuals = [
        rows.torque - block @ held.parameters[number] for rows, block, number in zip(regression.rows, columns, numbers)
    ]
    constants = np.zeros(len(regression.model.constants))
    shifts = hidden_shifts(regression, constants, inverse, prior.rows, weighted, numbers, residuals)
    assert [joint for joint, _ in held_columns(regression)] == [0, 1]
    moved = np.abs(expected) > 1e-3
    assert moved.sum() >= 5
    np.testing.assert_allclose(shifts[0][moved], expected[moved], rtol=1e-2)


@pytest.mark.parametrize("spring", [0.0, 0.05, 0.2, 0.8])
def test_standard_errors_hold_whatever_spring_is_left_out(spring):
    scores = []
    for seed in range(4):
        planted = two_link_run((Friction(k_1=spring), Friction(f_c=3.0)), seed=seed, periodic=True)
        arm = arm_from_urdf(planted.urdf)
        settings = Settings(structure=structure_of(arm))
        result = identify([planted.recording(noise=0.3, seed=seed)], arm, settings)
        scores += [
            (estimate.value - planted.values[estimate.name]) / estimate.standard_error
            for estimate in result.estimates
            if estimate.identifiable and estimate.joint == "shoulder"
        ]
    assert len(scores) >= 16
    assert np.max(np.abs(scores)) < 3.5
    assert np.mean(np.abs(scores) < 1.96) > 0.85


def scores(planted, structure, noise: float, seed: int, joint: str) -> dict[str, float]:
    """Errors of a joint's parameters in standard errors, of those that are called determined by the data."""
    arm = arm_from_urdf(planted.urdf)
    result = identify([planted.recording(noise=noise, seed=seed)], arm, Settings(structure=structure, blend=False))
    return {
        estimate.name: (estimate.value - planted.values[estimate.name]) / estimate.standard_error
        for estimate in result.estimates
        if estimate.identifiable and estimate.joint == joint
    }


@pytest.mark.parametrize("offset", [0.0, 0.3, 1.0, -3.0])
def test_standard_errors_hold_whatever_offset_is_left_out(offset):
    found = []
    for seed in range(4):
        planted = two_link_run((Friction(offset=offset), Friction(f_c=3.0)), seed=seed, periodic=True)
        structure = structure_of(arm_from_urdf(planted.urdf))
        assert "torque_offset" not in structure
        found += scores(planted, structure, 0.3, seed, "shoulder").values()
    assert len(found) >= 16
    assert np.max(np.abs(found)) < 3.5
    assert np.mean(np.abs(found) < 1.96) > 0.85


@pytest.mark.parametrize("static", [5.0, 5.5, 6.5])
def test_standard_errors_hold_where_a_curve_stands_for_stribeck_friction(static):
    """k_v2 and k_v3 take the place of a Stribeck term: f_c and k_v1 are then off by what its absence may hide."""
    found = []
    for seed in range(4):
        law = Friction(f_b=static, v_b=0.2, k_v2=0.0, k_v3=0.0)
        planted = two_link_run((law, Friction(f_c=3.0)), seed=seed, periodic=True)
        structure = structure_of(arm_from_urdf(planted.urdf), "paper-odd")
        structure["stribeck_friction"] = {"stribeck": False, "presliding": False}
        found += scores(planted, structure, 0.3, seed, "shoulder").values()
    assert len(found) >= 6
    assert np.max(np.abs(found)) < 3.5
    assert np.mean(np.abs(found) < 1.96) > 0.85
