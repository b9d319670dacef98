"""A ground model updated by five seconds, or by 500 samples: coverage, what the prior holds, what the data move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from planted_arm import TWO_LINKS, Friction, incommensurate, two_link_run, urdf_of
from scipy.signal import lfilter

from spacearm_ident.bayes.from_prior import CHANGES, GroundPrior, update
from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.dynamics.model import (
    FRICTION_LAWS,
    IdentifiedModel,
    OwnRecordings,
    Plain,
    TorqueModel,
    Unbounded,
)
from spacearm_ident.errors import UnfitDataError
from spacearm_ident.identification.identify import Settings, identify
from spacearm_ident.identification.plain import plain_structure
from spacearm_ident.recording.recording import Recording
from spacearm_ident.signals.motion import Motion
from spacearm_ident.signals.prepare import prepare

V_B = 0.05


def ground() -> GroundPrior:
    """Two links known to a few per cent, with correlated errors of inertia and rotor."""
    arm = arm_from_urdf(urdf_of(TWO_LINKS))
    model = TorqueModel(arm, {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["vacuum"]})
    known = {"f_c": (6.0, 3.0), "f_b": (8.0, 4.0), "k_v1": (4.0, 2.0), "J_m": (0.5, 0.2)}
    values = [
        known[p.symbol][arm.joint_names.index(p.joint)] if p.symbol in known else p.prior for p in model.parameters
    ]
    spread = {"f_c": 0.05, "f_b": 0.1, "k_v1": 0.05, "J_m": 0.05, "m": 0.05}
    root = np.diag(
        [spread.get(p.symbol, 0.02) for p in model.parameters]
        + [0.01 if c.symbol == "v_b" else 0.0 for c in model.constants]
    )
    names = [p.name for p in model.parameters]
    root[names.index("Iyy[elbow]"), names.index("J_m[elbow]")] = -0.05
    constants = [V_B if c.symbol == "v_b" else 0.0 for c in model.constants]
    return GroundPrior(IdentifiedModel(model, np.array(values), np.array(constants), 10.0), root @ root.T)


def orbit(prior: GroundPrior, truth: np.ndarray, seed: int, seconds: float, rate: float, ar: float) -> Recording:
    """A run of an arm whose parameters and constants are `truth`."""
    count = len(prior.model.parameters)
    arm = IdentifiedModel(prior.model.model, truth[:count], truth[count:])
    return run_of(arm, seed, seconds, rate, ar)


def run_of(arm: IdentifiedModel, seed: int, seconds: float, rate: float, ar: float, noise: float = 0.3) -> Recording:
    """A run of an arm that is a model, with noise of a first order."""
    model = arm.model
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / rate)
    q, qd, qdd = incommensurate(time, 2, seed, 0.8)
    motion = Motion(model.arm.joint_names, rate, 0.0, q, qd, qdd, q, np.full(2, 1e-6), np.zeros(2))
    white = rng.standard_normal((len(q) + 500, 2))
    noisy = noise * lfilter([np.sqrt(1 - ar**2)], [1.0, -ar], white, axis=0)[500:]
    return Recording(
        joints=model.arm.joint_names,
        time=time,
        position=q + 1e-6 * rng.standard_normal(q.shape),
        velocity=None,
        effort=arm.torque(motion) + noisy,
        segments=(slice(0, len(time)),),
    )


@pytest.mark.parametrize(
    ("seconds", "rate", "ar"), [(5.0, 200.0, 0.0), (5.0, 100.0, 0.0), (5.0, 200.0, 0.9), (5.0, 200.0, 0.967)]
)
def test_intervals_cover_what_they_say(seconds, rate, ar):
    """150 arms drawn from the prior; 5 s, or 500 samples; noise white, and with time constants of 50 and 150 ms."""
    prior = ground()
    wider = prior.widened(CHANGES)
    centre = np.concatenate([prior.model.parameters, prior.model.constants])
    free = np.diag(wider.covariance) > 0
    inside, decided = [], []
    for seed in range(150):
        truth = np.random.default_rng(seed).multivariate_normal(centre, wider.covariance)
        result = update([orbit(prior, truth, seed, seconds, rate, ar)], prior)
        low, high = result.intervals.T
        held = (low <= truth) & (truth <= high)
        inside.append(held[free])
        decided.extend(held[free & (result.variance_reduction > 0.5)])
    assert 0.93 <= np.mean(inside) <= 0.97
    # What the data decided: some 1500 intervals, twelve or so of them of one run.
    assert len(decided) > 900
    assert 0.93 <= np.mean(decided) <= 0.975


def test_data_that_say_much_say_all():
    """A minute of data: friction no longer depends on the prior; what moves no torque stays where it was."""
    prior = ground()
    centre = np.concatenate([prior.model.parameters, prior.model.constants])
    names = list(prior.names)
    truth = centre.copy()
    for name, value in {"f_c[shoulder]": 3.0, "f_b[shoulder]": 4.0, "k_v1[elbow]": 3.0}.items():
        truth[names.index(name)] = value
    result = update([orbit(prior, truth, 1, 60.0, 200.0, 0.0)], prior)
    for name in ("f_c[shoulder]", "k_v1[elbow]"):
        number = names.index(name)
        assert result.variance_reduction[number] > 0.99
        assert abs(result.model.parameters[number] - truth[number]) < 4 * result.standard_errors[number] < 0.3
    for name in ("Ixx[shoulder]", "mcy[elbow]"):
        number = names.index(name)
        assert result.variance_reduction[number] == pytest.approx(0.0, abs=1e-6)
        assert result.model.parameters[number] == pytest.approx(centre[number], abs=1e-9)
        assert result.standard_errors[number] == pytest.approx(np.sqrt(prior.covariance[number, number]), rel=1e-6)


def test_constants_are_found_where_the_ground_is_far_off():
    """v_b a quarter off, and half of the Stribeck peak gone, whose height its column was linearised with."""
    prior = ground()
    names = list(prior.names)
    number, peak = names.index("v_b[shoulder]"), names.index("f_b[shoulder]")
    covariance = prior.covariance.copy()
    covariance[number, number] = (0.2 * V_B) ** 2
    truth = np.concatenate([prior.model.parameters, prior.model.constants])
    truth[number], truth[peak] = 1.25 * V_B, 7.0
    result = update([orbit(prior, truth, 1, 30.0, 200.0, 0.0)], replace(prior, covariance=covariance))
    found = np.concatenate([result.model.parameters, result.model.constants])
    misses = np.abs(found - truth)[[number, peak]] / result.standard_errors[[number, peak]]
    assert result.variance_reduction[number] > 0.8 and misses.max() < 3.0


def test_changes_widen_friction_only_and_f_b_follows_f_c():
    prior = ground()
    extra = prior.widened({"f_c": 0.3, "f_b": 0.5}).covariance - prior.covariance
    names = list(prior.names)
    c, b = names.index("f_c[shoulder]"), names.index("f_b[shoulder]")
    assert extra[c, c] == pytest.approx(1.8**2) and extra[c, b] == pytest.approx(1.8**2)
    assert extra[b, b] == pytest.approx(1.8**2 + 1.0**2)
    assert np.count_nonzero(np.diag(extra)) == 4
    # An arm that may not have changed is believed: the same data move it less.
    truth = np.concatenate([prior.model.parameters, prior.model.constants])
    truth[c] += 2.0
    run = orbit(prior, truth, 3, 5.0, 200.0, 0.0)
    moved = [update([run], prior, room).model.parameters[c] - 6.0 for room in ({}, None)]
    assert moved[0] < moved[1] and abs(moved[1] - 2.0) < 0.5


def test_f_b_of_a_ground_model_without_stribeck_friction_is_f_c_afterwards_as_well():
    """It moves no torque there: with an error and a value of its own it was called determined by the data."""
    structure = FRICTION_LAWS["coulomb-viscous"]
    arm = arm_from_urdf(urdf_of(TWO_LINKS))
    laws = (Friction(f_c=5.0, k_v2=0.0, k_v3=0.0), Friction(f_c=3.0, k_v2=0.0, k_v3=0.0))
    whole = {"rigid_body": {}, "rotor_inertia": {}, **structure}
    ground_run = two_link_run(laws, 20.0, 250.0, 1).recording(0.2)
    prior = GroundPrior.of(identify([ground_run], arm, Settings(structure=whole)))
    after = tuple(replace(law, f_c=1.2 * law.f_c) for law in laws)
    run = two_link_run(after, 5.0, 250.0, 2).recording(0.2, 5)
    found = {one.name: one for one in identify([run], arm, Settings(prior=prior)).estimates}
    for joint in arm.joint_names:
        level, static = found[f"f_c[{joint}]"], found[f"f_b[{joint}]"]
        assert static.value == pytest.approx(level.value, rel=1e-6) and not static.identifiable
        assert "equal to f_c" in static.note


def test_an_identified_ground_run_is_a_prior():
    """Ground: 20 s, identified. Orbit: five seconds, friction 20 % lower; the update predicts another run better."""
    before = (Friction(f_c=5.0, k_v2=0.0, k_v3=0.0), Friction(f_c=3.0, k_v1=2.0, J_m=0.2, k_v2=0.0, k_v3=0.0))
    after = tuple(replace(law, f_c=0.8 * law.f_c) for law in before)
    structure = {"rigid_body": {}, "rotor_inertia": {}, **FRICTION_LAWS["coulomb-viscous"]}
    arm = arm_from_urdf(urdf_of(TWO_LINKS))
    identified = identify([two_link_run(before, 20.0, 250.0, 1).recording(0.2)], arm, Settings(structure=structure))
    prior = GroundPrior.of(identified)
    result = update([two_link_run(after, 5.0, 250.0, 2).recording(0.2, 5)], prior)
    for joint, level in (("shoulder", 4.0), ("elbow", 2.4)):
        number = list(prior.names).index(f"f_c[{joint}]")
        low, high = result.intervals[number]
        assert low - 0.1 < level < high + 0.1 and high - low < 1.0
    assert result.model.value("m", "shoulder") == pytest.approx(identified.model.value("m", "shoulder"), rel=0.2)


def test_rest_is_refused():
    prior = ground()
    run = orbit(prior, np.concatenate([prior.model.parameters, prior.model.constants]), 1, 5.0, 200.0, 0.0)
    with pytest.raises(UnfitDataError, match="no joint moves"):
        update([replace(run, position=np.zeros_like(run.position))], prior)


def blended_ground() -> GroundPrior:
    """With a fifth of least squares without bounds, and a plain model in half of the shoulder's and all of the elbow's
    torque."""
    prior = ground()
    model = prior.model.model
    simple = TorqueModel(model.arm, plain_structure(model.arm))
    known = prior.model.by_term
    rng = np.random.default_rng(3)
    values = [
        known.get((term.kind, item.name), 0.0) * rng.uniform(0.8, 1.2)
        for term in simple.terms
        for item in term.parameters
    ]
    plain = Plain(simple, np.array(values), np.zeros(len(simple.constants)), np.array([0.5, 0.8]))
    unbounded = Unbounded(prior.model.parameters * 1.1, np.array([0.2, 0.2]))
    return replace(prior, model=replace(prior.model, unbounded=unbounded, plain=plain))


def test_what_is_blended_into_a_ground_model_is_still_there_after_an_update():
    """Data that the ground predicts as they are leave it as it is, whatever its torque consists of."""
    prior = blended_ground()
    run = run_of(prior.model, 5, 5.0, 200.0, 0.0, noise=0.0)
    motions, _ = prepare([run], run.joints, average=False)
    updated = update([run], prior)
    np.testing.assert_allclose(updated.residual_Nm, 0.0, atol=0.02)
    errors = np.sqrt(np.diag(prior.covariance))[: len(prior.model.parameters)]
    moved = np.abs(updated.model.parameters - prior.model.parameters) / np.where(errors > 0, errors, 1.0)
    assert moved.max() < 0.5
    before, after = (one.torque(motions[0]) for one in (prior.model, updated.model))
    assert np.sqrt(np.mean((after - before) ** 2)) < 0.002 * np.sqrt(np.mean(before**2))


def test_a_departure_reaches_as_much_of_the_torque_as_its_share_says():
    prior = blended_ground()
    model, rng = prior.model, np.random.default_rng(1)
    departure = 0.1 * rng.standard_normal(len(model.parameters)) * np.abs(model.parameters)
    # A plain model has no Stribeck friction: near rest its f_c is not the same column.
    departure[[p.symbol == "f_c" for p in model.model.parameters]] = 0.0
    run = orbit(prior, np.concatenate([model.parameters, model.constants]), 5, 5.0, 200.0, 0.0)
    (motion,), _ = prepare([run], run.joints, average=False)
    moved = model.moved_to(model.parameters + departure, model.constants).torque(motion) - model.torque(motion)
    alone = [
        model.model.torque(motion, np.where(np.arange(len(departure)) == k, one, 0.0), model.constants)
        for k, one in enumerate(departure)
    ]
    np.testing.assert_allclose(moved, np.einsum("pnj,jp->nj", np.stack(alone), model.departure_share), atol=1e-9)


def test_an_update_believes_no_more_than_a_model_leaves_of_its_own_recordings():
    """What a model leaves is in the next recording as well, and looks smaller in seconds that a fit may follow."""
    prior = ground()
    truth = np.concatenate([prior.model.parameters, prior.model.constants])
    run = orbit(prior, truth, 5, 5.0, 200.0, 0.0)
    one, none = np.ones(2), np.zeros((0, 2))
    own = OwnRecordings(1, one, none, none, none, np.zeros((0, len(prior.model.parameters))), density=0.5 * one)
    doubting = update([run], replace(prior, model=replace(prior.model, own=own)))
    trusting = update([run], prior)
    assert np.all(doubting.standard_errors >= trusting.standard_errors * (1 - 1e-9))
    assert np.median(doubting.variance_reduction) < 0.7 * np.median(trusting.variance_reduction)
