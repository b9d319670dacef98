"""What the identifier says of a result: what speaks against using it is told apart from what does not."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from made_result import arm, fit, identification, identified_model, validation

pytest.importorskip("rclpy", reason="needs ROS 2 (or its wheels: pip install spacearm_ident[ros])")

from spacearm_ident.conventions.finding import ConventionReport, Finding, Level
from spacearm_ident.estimate.identified import JointValidation
from spacearm_ident.nodes.identifier_messages import doubts_and_notes
from spacearm_ident.sessions.identification import Session


def session(moving: float, *levels: Level) -> Session:
    model = identified_model(arm())
    names = model.model.arm.joint_names
    figures = replace(
        validation(names), joints={name: JointValidation(fit(moving), fit(moving), fit(moving)) for name in names}
    )
    findings = tuple(Finding("clock_jitter", level, (), "uneven", "stamp") for level in levels)
    return Session(identification(model), figures, Path("report.html"), ConventionReport(findings, (), ("bag",)))


def test_a_good_result_of_sound_data_is_said_without_a_warning():
    doubts, notes = doubts_and_notes(session(0.01, Level.NOTE))
    assert doubts == [] and notes[0].startswith("Good fit") and any("clock_jitter" in line for line in notes)


@pytest.mark.parametrize("moving", [0.01, 0.5])
def test_of_unfit_data_the_warning_is_theirs_and_the_model_has_no_verdict(moving):
    doubts, notes = doubts_and_notes(session(moving, Level.UNFIT))
    assert doubts[0].startswith("data unfit: clock jitter") and doubts[-1].startswith("do not use the model")
    assert notes == [] and not any(" fit." in line for line in doubts)


def test_a_model_that_is_not_to_be_used_is_a_warning_whatever_the_data():
    doubts, notes = doubts_and_notes(session(0.5))
    assert doubts[0].startswith("Poor fit") and notes == []
