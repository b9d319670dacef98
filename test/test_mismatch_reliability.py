"""Confidence of findings: weights among explanations times the frequencies of blind trials."""

import pytest
from made_finding import made_finding

from spacearm_ident.mismatch.reliability import RIGHT, Situation, calibrated, situations

RIPPLE, DRIFT, NOT_NAMED = (
    ("torque_ripple", ("elbow",)),
    ("friction_drift", ("elbow", "wrist")),
    ("unknown", ("elbow",)),
)
ELSEWHERE = ("unknown", ("base",))


@pytest.mark.parametrize(
    "one, others, expected",
    [
        (RIPPLE, [], Situation.NAMED_ALONE),
        (RIPPLE, [ELSEWHERE], Situation.NAMED_ALONE),
        (RIPPLE, [DRIFT], Situation.NAMED_BESIDE),
        (RIPPLE, [NOT_NAMED], Situation.NAMED_BESIDE),
        (NOT_NAMED, [], Situation.UNKNOWN_ALONE),
        (NOT_NAMED, [ELSEWHERE, NOT_NAMED], Situation.UNKNOWN_ALONE),
        (NOT_NAMED, [DRIFT], Situation.UNKNOWN_BESIDE),
    ],
)
def test_a_situation_is_what_stands_at_the_same_joints(one, others, expected):
    assert situations([one, *others])[0] is expected


def test_confidence_is_weight_times_the_frequency_of_the_finding_s_own_situation():
    weights = {RIPPLE: 0.99, NOT_NAMED: 0.8, ELSEWHERE: 1.0}
    ripple, left, elsewhere = calibrated(
        [made_finding(effect, *joints, confidence=weight) for (effect, joints), weight in weights.items()]
    )
    assert ripple.confidence == pytest.approx(0.99 * RIGHT[Situation.NAMED_BESIDE])
    assert left.confidence == pytest.approx(0.8 * RIGHT[Situation.UNKNOWN_BESIDE])
    assert elsewhere.confidence == pytest.approx(RIGHT[Situation.UNKNOWN_ALONE])
    assert [ripple.effect, left.effect, elsewhere.effect] == ["torque_ripple", "unknown", "unknown"]


def test_a_second_finding_at_the_joint_lowers_confidence():
    alone, beside = (
        calibrated([made_finding(effect, *joints) for effect, joints in all_of])
        for all_of in ([RIPPLE], [RIPPLE, DRIFT])
    )
    assert beside[0].confidence < alone[0].confidence < 0.9
