"""What a model leaves of its own recordings: measured by fits that leave parts out, kept in its file, and used."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from planted_arm import Friction, two_link_run
from scipy.signal import lfilter

from spacearm_ident.dynamics.arm import arm_from_urdf, load_arm
from spacearm_ident.dynamics.model import FRICTION_LAWS, IdentifiedModel, OwnRecordings, TorqueModel
from spacearm_ident.dynamics.model_file import load_model, save_model
from spacearm_ident.errors import UserError
from spacearm_ident.identification.block_grams import BlockGrams
from spacearm_ident.identification.fit import Fit, fit_model
from spacearm_ident.identification.identify import identify
from spacearm_ident.identification.own_recordings import own_recordings, parts_left_out
from spacearm_ident.mismatch.explain import explain
from spacearm_ident.mismatch.left_out import LeftOfOwn
from spacearm_ident.mismatch.run_set import RunSet
from spacearm_ident.recording import read_recording
from spacearm_ident.regression.held_out import time_blocks
from spacearm_ident.signals.prepare import prepare
from spacearm_ident.solvers.solution_columns import columns_at

REAL = Path(__file__).parents[2] / "shared" / "recordings" / "real"
LAW = Friction(k_v2=0.0, k_v3=0.0, f_b=1.0, f_c=1.0)


@pytest.fixture(scope="module")
def fit() -> Fit:
    planted = two_link_run((LAW, LAW), seconds=20.0, seed=1, speed=2.0)
    arm = arm_from_urdf(planted.urdf)
    motions, _ = prepare([planted.recording(noise=0.2, seed=1)], arm.joint_names)
    structure = {"rigid_body": {}, "rotor_inertia": {}, "stribeck_friction": {"stribeck": [], "presliding": []}}
    return fit_model(TorqueModel(arm, structure), motions)


def departures(fit: Fit) -> np.ndarray:
    """A tenth of every value, one at a time."""
    return np.diag(0.1 * np.abs(fit.solution.parameters))


def test_parts_are_predicted_by_least_squares_on_the_other_parts_and_the_prior(fit: Fit) -> None:
    grams = BlockGrams(fit.regression, fit.solution.constants)
    parts = parts_left_out(fit, grams)
    own = own_recordings(fit, grams, parts, fit.solution.parameters, departures(fit))
    assert own is not None and own.recordings == 1 and len(parts) == 5
    assert sorted(number for part in parts for number in part.fold) == list(range(len(grams.recording)))
    block_of, _ = time_blocks(fit.regression.motions)
    columns, numbers = columns_at(fit.regression, fit.solution.constants)
    free, fixed = fit.prior.free, fit.prior.held.copy()
    fixed[free] = 0.0
    for k, part in enumerate(parts):
        normal, side = [fit.prior.rows[:, free]], [fit.prior.target - fit.prior.rows @ fixed]
        for rows, own_columns, own_numbers in zip(fit.regression.rows, columns, numbers):
            others = ~np.isin(rows.group(block_of), part.fold)
            wide = np.zeros((others.sum(), len(fit.solution.parameters)))
            wide[:, own_numbers] = own_columns[others]
            normal.append(wide[:, free] * rows.weight[others, None])
            side.append((rows.torque[others] - wide @ fixed) * rows.weight[others])
        brute = fixed.copy()
        unit = fit.prior.scale[free]
        brute[free] = unit * np.linalg.lstsq(np.concatenate(normal) * unit, np.concatenate(side), rcond=None)[0]
        for j, (rows, own_columns, own_numbers) in enumerate(zip(fit.regression.rows, columns, numbers)):
            inside = np.isin(rows.group(block_of), part.fold)
            predicted = own_columns[inside] @ part.free[own_numbers]
            np.testing.assert_allclose(predicted, own_columns[inside] @ brute[own_numbers], atol=1e-6)
            left = rows.torque[inside] - own_columns[inside] @ part.possible[own_numbers]
            worth = rows.weight[inside] ** 2
            assert own.left_out_Nm[k, j] == pytest.approx(np.sqrt(worth @ left**2 / worth.sum()))
            assert own.rows[k, j] == pytest.approx(worth.sum() / rows.weight.max() ** 2)


def test_more_is_left_of_a_part_that_was_left_out_than_of_one_that_was_fitted(fit: Fit) -> None:
    grams = BlockGrams(fit.regression, fit.solution.constants)
    own = own_recordings(fit, grams, parts_left_out(fit, grams), fit.solution.parameters, departures(fit))
    assert own is not None
    mean = [np.sum(own.rows * figure**2) for figure in (own.left_out_Nm, own.fitted_Nm)]
    assert 1.0 < mean[0] / mean[1] < 1.5


@pytest.mark.parametrize(("time_constant_s", "least", "most"), [(0.0, 0.6, 1.6), (0.2, 20.0, 300.0)])
def test_density_is_that_of_the_noise_and_higher_where_noise_is_slow(
    time_constant_s: float, least: float, most: float
) -> None:
    """White noise of s N m at a rate f has the density s^2 / f, a process of first order (T) 2 T f times that."""
    noise, rate_hz, found = 0.2, 500.0, []
    slow = np.exp(-1.0 / rate_hz / time_constant_s) if time_constant_s else 0.0
    structure = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
    for seed in range(4):
        planted = two_link_run((LAW, LAW), seconds=30.0, seed=seed, speed=2.0)
        run = planted.recording(noise=0.0, seed=seed)
        white = np.random.default_rng(seed).standard_normal(run.effort.shape) * noise * np.sqrt(1.0 - slow**2)
        run = replace(run, effort=run.effort + lfilter([1.0], [1.0, -slow], white, axis=0))
        motions, _ = prepare([run], run.joints)
        fit = fit_model(TorqueModel(arm_from_urdf(planted.urdf), structure), motions)
        grams = BlockGrams(fit.regression, fit.solution.constants)
        own = own_recordings(fit, grams, parts_left_out(fit, grams), fit.solution.parameters, departures(fit))
        assert own is not None and own.density is not None
        found.append(own.density)
    assert least < np.mean(found) / (noise**2 / rate_hz) < most


def known(parts: int = 3) -> OwnRecordings:
    rng = np.random.default_rng(0)
    rows = np.tile([100.0, 200.0], (parts, 1))
    fitted = np.full((parts, 2), 0.5)
    return OwnRecordings(2, np.array([1.5, 2.5]), rows, 1.2 * fitted, fitted, rng.uniform(size=(parts, 20)))


def test_figures_are_those_of_the_file_in_the_scale_of_another_bandwidth() -> None:
    left = LeftOfOwn(known(), np.array([0.25, 1.0]))
    np.testing.assert_allclose(left.rms_Nm, [0.3, 1.2])
    np.testing.assert_allclose(left.largest_Nm, [0.25, 1.0])  # all parts alike
    idle = replace(known(), rows=np.array([[0.0, 200.0]] * 3))
    assert np.isnan(LeftOfOwn(idle, np.array([0.25, 1.0])).rms_Nm[0])


@pytest.fixture(scope="module")
def model() -> IdentifiedModel:
    planted = two_link_run((LAW, LAW), seconds=20.0, seed=1, speed=2.0)
    return identify([planted.recording(noise=0.2, seed=1)], arm_from_urdf(planted.urdf)).model


def test_a_model_file_keeps_them(model: IdentifiedModel, tmp_path: Path) -> None:
    save_model(model, tmp_path / "model.yaml")
    own, read = model.own, load_model(tmp_path / "model.yaml").own
    assert own is not None and read is not None and read.recordings == own.recordings
    for field in ("acceleration", "rows", "left_out_Nm", "fitted_Nm", "parameters", "density"):
        np.testing.assert_array_equal(getattr(read, field), getattr(own, field))


@pytest.mark.parametrize(
    ("was", "now"),
    [("parameters: [", "parameters: [1.0, "), ("left_out_Nm:\n      shoulder: ", "left_out_Nm:\n      shoulder: -")],
)
def test_a_file_that_was_edited_wrongly_is_refused(model: IdentifiedModel, tmp_path: Path, was: str, now: str) -> None:
    path = tmp_path / "model.yaml"
    save_model(model, path)
    text = path.read_text()
    assert was in text
    path.write_text(text.replace(was, now, 1))
    with pytest.raises(UserError, match="own_recordings"):
        load_model(path)


@pytest.mark.parametrize(("arm", "field", "reference"), [("rokae", "run_2", "run_1"), ("airbot", "run_3", "run_2")])
def test_a_healthy_real_arm_is_quiet_against_its_model_alone(arm: str, field: str, reference: str) -> None:
    if not (REAL / arm).exists():
        pytest.skip(f"no {arm} in ../shared/recordings/real")
    described = load_arm(REAL / arm / "arm.urdf")
    known = identify([read_recording(REAL / arm / f"{reference}.mcap")], described).model
    found = explain(known.model.arm, RunSet([read_recording(REAL / arm / f"{field}.mcap")], known, []))
    assert found.verdict == "no_mismatch"
