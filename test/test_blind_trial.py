"""The blind trial of concealed physics: its plan, its arms, its score."""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from spacearm_ident.simulation.closed_loop import RunawayError
from spacearm_ident.simulation.concealed import EFFECTS

sys.path.insert(0, str(Path(__file__).parent.parent / "bench"))
import concealed as blind
import concealed_draw
import concealed_score
from concealed_arm import JOINTS, draw_arm

KNOWN = {name for name, kind in EFFECTS.items() if kind.known}


def test_trials_come_in_the_shares_and_in_turn():
    plans = [blind.plan(0, number) for number in range(1, 201)]
    kinds = [plan["kind"] for plan in plans]
    assert [kinds.count(kind) for kind in ("healthy", "two", "absent", "one")] == [40, 30, 20, 110]
    singles = [plan["effects"][0] for plan in plans if plan["kind"] == "one"]
    counts = [singles.count(name) for name in KNOWN]
    assert min(counts) >= 4 and max(counts) <= 5 and set(singles) == KNOWN
    assert {plan["multiple"] for plan in plans} == {None, 2.0, 5.0, 10.0}
    assert plans[:40] == [blind.plan(0, number) for number in range(1, 41)] != [blind.plan(1, n) for n in range(1, 41)]
    assert all(not EFFECTS[plan["effects"][0]].known for plan in plans if plan["kind"] == "absent")


@pytest.mark.parametrize("healthy", [False, True])
def test_a_series_of_healthy_arms_conceals_nothing_in_any(tmp_path, monkeypatch, healthy):
    drawn = []
    monkeypatch.setattr(blind, "draw_trial", lambda seed, *places, **concealed: drawn.append((seed, concealed["kind"])))
    options = argparse.Namespace(out=tmp_path, seed=3, form=None, healthy=healthy, draw_only=True)
    for number in range(1, 21):
        blind.one_trial(options, number)
    assert [seed for seed, _ in drawn] == list(range(300_001, 300_021))
    assert sum(kind == "healthy" for _, kind in drawn) == (20 if healthy else 4)


def test_a_drawn_arm_is_one_that_can_exist_and_comes_again_from_its_seed():
    first, again, other = (draw_arm(np.random.default_rng(seed), weightless=False) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.parameters.rigid_body, again.parameters.rigid_body)
    assert first.parameters.urdf == again.parameters.urdf != other.parameters.urdf
    model = pin.buildModelFromXML(first.parameters.urdf)
    for cad, true in zip(list(model.inertias)[1:], first.parameters.rigid_body, strict=True):
        body = pin.Inertia.FromDynamicParameters(true)
        assert np.linalg.eigvalsh(body.toPseudoInertia().toMatrix())[0] > 0
        assert 1e-4 < abs(cad.mass / body.mass - 1.0) < 0.11


class Fragile:
    """A trial whose arm shows an inertia of 1 kg m² at 50 times the noise, and bears less than `strongest`."""

    def __init__(self, strongest):
        self.rng, self.floor, self.strongest, self.arm = np.random.default_rng(1), np.ones(6), strongest, None

    def simulate(self, run, entries):
        inertia = entries[0]["parameters"]["inertia"]
        if inertia >= self.strongest:
            raise RunawayError("the simulated arm runs away")
        return inertia

    def amplitudes(self, inertia):
        return np.full(len(JOINTS), 50.0 * inertia)


@pytest.mark.parametrize("strongest, reached", [(9.0, 10.0), (0.21, 10.0), (0.05, None)])
def test_an_arm_that_cannot_carry_an_effect_gets_less_of_it(strongest, reached):
    entry, more = concealed_draw._scaled(Fragile(strongest), "rotor_coupling", 10.0)
    assert 0.0 < entry["parameters"]["inertia"] < strongest
    assert more["multiple"] == pytest.approx(reached or 50.0 * 0.04, rel=0.25 if reached else 0.5)


def hidden_effect(name="payload", joint="joint_6", **more):
    base = {"effect": name, "joints": [joint], "local": True, "law": "usual", "parameters": {"mass": 0.5}}
    base |= {"comparable": "mass", "asked_multiple": 5.0, "multiple": 5.1, "multiples": {joint: 5.1}}
    return base | more


def finding(name="payload", joint="joint_6", value=0.55, **more):
    parameters = {"mass": {"value": value, "unit": "kg", "ci95": [value - 0.1, value + 0.1]}}
    base = {"effect": name, "joints": [joint], "parameters": parameters, "confidence": 0.9, "alternatives": []}
    return base | {"validation": {"explained_fraction": 0.95}} | more


def write_case(out, number, kind, effects, findings, verdict=None):
    place, sealed = out / "trials" / f"{number:04}", out / "sealed" / f"{number:04}"
    (place / "result").mkdir(parents=True)
    sealed.mkdir(parents=True)
    (sealed / "answer.json").write_text(json.dumps({"kind": kind, "effects": effects}))
    (place / "finished.json").write_text(json.dumps({"seconds": 12.5, "exit": 0, "error": ""}))
    if verdict != "crashed":
        said = {"verdict": verdict or ("mismatch" if findings else "no_mismatch"), "findings": findings}
        (place / "result" / "mismatch.json").write_text(json.dumps(said))


def test_the_score_counts_what_was_said(tmp_path):
    twin = finding("base_tilt", alternatives=[{"effect": "payload", "score": 0.96, "why_not": ""}])
    far = finding("payload", joint="joint_1", value=1.0, alternatives=[{"effect": "base_tilt", "score": 0.9}])
    pair = [hidden_effect(), hidden_effect("stribeck", "joint_2")]
    gone = hidden_effect("loose_bolt")
    cases = [
        ("healthy", [], []),
        ("healthy", [], [finding("stribeck")]),
        ("one", [hidden_effect()], [finding()]),
        ("one", [hidden_effect()], [twin]),
        ("one", [hidden_effect()], [far]),
        ("one", [hidden_effect(asked_multiple=5.0, multiple=2.8)], []),
        ("two", pair, [finding("stribeck", "joint_2"), finding()]),
        ("two", pair, [finding()]),
        ("absent", [gone], [finding("unknown")]),
        ("absent", [gone], [finding("backlash")]),
    ]
    for number, case in enumerate(cases, start=1):
        write_case(tmp_path, number, *case)
    write_case(tmp_path, 11, "one", [hidden_effect()], [], "crashed")
    text = concealed_score.report(concealed_score.load_trials(tmp_path))

    def line(start):
        (found,) = [row for row in text.splitlines() if row.startswith(start)]
        return found

    assert "crashed or unfit: 1" in text
    assert "50.0 %  1 of 2" in line("false alarm")
    assert "3 of 5" in line("one effect: detected")
    assert "2 of 5" in line("  right effect first, strict, all")
    assert "3 of 5" in line("  right effect first, with twins, all")
    assert "2 of 4" in line("  right effect first, strict, 5 x noise")
    assert "0 of 1" in line("  right effect first, strict, 2 x noise")
    assert "2 of 3" in line("  right joint")
    assert "1 of 2" in line("two effects: both named, strict")
    assert "1 of 2" in line("absent effect: unknown or nothing")
    assert "0.950" in line("explained fraction")
    assert "  payload.mass" in text and "12.500" in line("seconds a case")
    assert "3 of 4" in line("truth in the 95 % interval")
    assert "payload                  payload 2, nothing 2, base_tilt 1" in text
    assert "   4 payload(usual) joint_6 x5.1: base_tilt joint_6" in text


def test_a_score_of_healthy_arms_alone_is_their_rate_of_false_alarms(tmp_path):
    for number in range(1, 5):
        write_case(tmp_path, number, "healthy", [], [finding("stribeck")] if number == 3 else [])
    text = concealed_score.report(concealed_score.load_trials(tmp_path))
    assert "25.0 %  1 of 4" in text and "4 trials" in text


def test_an_efficiency_is_compared_by_what_is_lost():
    truth = hidden_effect("gear_efficiency", parameters={"efficiency": 0.9}, comparable="efficiency")
    said = finding("gear_efficiency", parameters={"efficiency": {"value": 0.88, "ci95": [0.85, 0.91]}})
    scored = concealed_score.Scored(1, {"kind": "one", "effects": [truth]}, [said], False, 1.0)
    assert scored.compared() == concealed_score.Compared("gear_efficiency.efficiency", pytest.approx(0.2), True)


def test_wilsons_interval_is_printed():
    assert concealed_score.share("x", [True] * 9 + [False]).endswith("(95 %: 59.6 to 98.2)")
