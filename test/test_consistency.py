"""Physical consistency: links that could exist, the data's answer kept, and the nearest of all such answers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planted_arm import THREE_LINKS, real, urdf_of

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.base_parameters import base_parameters
from spacearm_ident.dynamics.model import FRICTION_LAWS, TorqueModel
from spacearm_ident.estimate.consistency import is_consistent, link_parameters, make_consistent, pseudo_inertia

STRUCTURE = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
MODEL = TorqueModel(arm_from_urdf(urdf_of(THREE_LINKS)), STRUCTURE)
TRUTH = np.array([{"J_m": 0.4, "f_c": 3.0, "f_b": 3.0, "k_v1": 2.0}.get(p.symbol, p.prior) for p in MODEL.parameters])
SCALE = np.array([0.0 if p.held else p.scale or 1.0 for p in MODEL.parameters])
FREE = np.flatnonzero(SCALE > 0)
BASE = base_parameters(MODEL)


def link_eigenvalues(parameters: np.ndarray) -> list[float]:
    return [float(np.linalg.eigvalsh(pseudo_inertia(parameters[link]))[0]) for link in link_parameters(MODEL)]


def within_bounds(parameters: np.ndarray) -> bool:
    return all(p.lower <= value <= p.upper for p, value in zip(MODEL.parameters, parameters))


def objective(seed: int, prior: float = 0.1) -> np.ndarray:
    """Rows of a well-posed problem: random data on the base parameters, and a weak prior on each parameter."""
    rng = np.random.default_rng(seed)
    data = rng.standard_normal((60, len(BASE.regrouping))) @ BASE.regrouping
    return np.concatenate([30.0 * data, prior * np.diag(1.0 / np.where(SCALE > 0, SCALE, 1.0))])


def wrong(seed: int, size: float = 1.5) -> np.ndarray:
    parameters = TRUTH.copy()
    parameters[FREE] += size * SCALE[FREE] * np.random.default_rng(seed).standard_normal(len(FREE))
    return parameters


def feasible(seed: int) -> np.ndarray:
    """Links of random point masses, friction and rotors of random positive size."""
    rng = np.random.default_rng(seed)
    parameters = TRUTH.copy()
    parameters[FREE] = np.abs(parameters[FREE]) * rng.uniform(0.1, 3.0, len(FREE))
    for link in link_parameters(MODEL):
        points = rng.normal(0, 0.3, (6, 3)) + rng.normal(0, 0.2, 3)
        weights = rng.uniform(0.05, 2.0, 6)
        inertia = sum(w * (p @ p * np.eye(3) - np.outer(p, p)) for w, p in zip(weights, points))
        i = inertia
        parameters[link] = [weights.sum(), *(weights @ points), i[0, 0], i[0, 1], i[1, 1], i[0, 2], i[1, 2], i[2, 2]]
    return parameters


@settings(max_examples=30, deadline=None)
@given(values=st.lists(real(-2, 2), min_size=10, max_size=10))
def test_the_pseudo_inertia_is_pinocchios(values):
    mine = pseudo_inertia(np.array(values))
    np.testing.assert_allclose(mine, pin.PseudoInertia.FromDynamicParameters(np.array(values)).toMatrix(), atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_an_impossible_estimate_becomes_a_possible_one(seed):
    estimate = wrong(seed)
    assert min(link_eigenvalues(estimate)) < 0.0
    consistent = make_consistent(MODEL, objective(seed), estimate, SCALE)
    assert min(link_eigenvalues(consistent)) > 0.0
    assert within_bounds(consistent)
    held = np.flatnonzero(SCALE == 0)
    np.testing.assert_array_equal(consistent[held], estimate[held])


def test_a_possible_estimate_stays_as_it_is():
    assert is_consistent(MODEL, TRUTH, SCALE)
    assert make_consistent(MODEL, objective(0), TRUTH, SCALE) is TRUTH


@pytest.mark.parametrize("seed", range(4))
def test_what_the_data_determine_is_kept(seed):
    """A wrong estimate whose base parameters are right moves only within what no torque shows."""
    _, _, basis = np.linalg.svd(BASE.regrouping[:, FREE])
    unseen = basis[len(BASE.regrouping) :].T
    estimate = TRUTH.copy()
    estimate[FREE] += unseen @ (4.0 * np.random.default_rng(seed).standard_normal(unseen.shape[1]))
    assert not is_consistent(MODEL, estimate, SCALE)
    consistent = make_consistent(MODEL, objective(seed, prior=1e-3), estimate, SCALE)
    assert is_consistent(MODEL, consistent, 0.9 * SCALE)
    assert np.abs(consistent - estimate).max() > 0.1
    np.testing.assert_allclose(BASE.regrouping @ consistent, BASE.regrouping @ TRUTH, atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_no_possible_set_is_nearer(seed):
    """The variational inequality that singles out the projection on a convex set, on many other possible sets."""
    estimate, rows = wrong(seed), objective(seed)
    consistent = make_consistent(MODEL, rows, estimate, SCALE)
    away = rows @ (consistent - estimate)
    others = np.array([feasible(1000 * seed + k) for k in range(200)])
    assert all(within_bounds(other) and min(link_eigenvalues(other)) > 0 for other in others)
    toward = (others - consistent) @ rows.T
    assert np.all(toward @ away >= -1e-4 * np.linalg.norm(away) * np.linalg.norm(toward, axis=1))
