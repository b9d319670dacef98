"""What the data demand beyond the paper's law is found where it was planted, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import pytest
from planted_arm import Friction, two_link_run

from spacearm_ident.dynamics.arm import arm_from_urdf
from spacearm_ident.identification.identified import Identified
from spacearm_ident.identification.identify import identify
from spacearm_ident.identification.structure import GATE

LAWS = (Friction(), Friction(f_c=3.0, k_v1=2.0, J_m=0.2))
ODD = "quadratic friction"
LOAD = "friction that grows with the load at"
OFFSET = "constant torque offset at"


def found(result: Identified) -> set[str]:
    return {choice.term for choice in result.choices if choice.accepted}


def run(shoulder: Friction, elbow: Friction, seed: int = 0, speed: float = 2.0) -> Identified:
    planted = two_link_run((shoulder, elbow), seconds=40.0, seed=seed, speed=speed)
    return identify([planted.recording(noise=0.2, seed=seed)], arm_from_urdf(planted.urdf))


@pytest.mark.parametrize("seed", range(4))
def test_the_papers_law_asks_for_nothing_more(seed):
    result = run(*LAWS, seed=seed)
    assert found(result) == set()
    assert len(result.choices) == 5
    assert all(choice.gain < GATE for choice in result.choices)


@pytest.mark.parametrize("seed", range(3))
def test_load_friction_is_found_at_its_joint(seed):
    result = run(replace(LAWS[0], mu=0.08), LAWS[1], seed=seed)
    assert found(result) == {f"{LOAD} shoulder"}
    assert result.model.value("mu", "shoulder") == pytest.approx(0.08, rel=0.15)


@pytest.mark.parametrize("seed", [1, 2])
def test_an_offset_is_found_at_its_joint(seed):
    result = run(LAWS[0], replace(LAWS[1], offset=0.6), seed=seed, speed=1.0)
    assert found(result) == {f"{OFFSET} elbow"}
    assert result.model.value("offset", "elbow") == pytest.approx(0.6, abs=0.15)


@pytest.mark.parametrize("seed", range(3))
def test_quadratic_friction_that_always_resists_is_told_from_the_papers(seed):
    laws = [replace(law, k_v2=1.0, k_v3=0.0, odd=True) for law in LAWS]
    result = run(*laws, seed=seed)
    assert any(term.startswith(ODD) for term in found(result))
    assert not any(term.startswith((LOAD, OFFSET)) for term in found(result))
