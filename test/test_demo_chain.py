"""How the demo goes through a chain of nodes that falls out, refuses or is too slow: without processes or a clock."""

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="ROS 2 (rclpy) is not installed")

from spacearm_ident.cli import demo as demo_command
from spacearm_ident.driver.arm_can import load_arm_can
from spacearm_ident.errors import UserError


class FakeChain:
    """A chain whose drives fall out before a run is started, and which refuses runs for `reason`."""

    def __init__(self, falls: int, reason: str = "", broken: str = "") -> None:
        self.ending = {"reason": broken, "complete": not broken}
        self.falls, self.reason, self.enabled, self.calls = falls, reason, True, []
        self.excitation = {}

    def set_parameter(self, node: str, name: str, value: str) -> None:
        pass

    def values(self, name: str) -> dict[str, str]:
        return {"operation_enabled": str(self.enabled).lower()}

    status = values

    def wait(self, reached, what: str, longest_s: float) -> None:
        assert reached(), what

    def call(self, service: str, value: bool | None = None) -> str:
        self.calls.append(service)
        if service == "/driver/enable":
            self.enabled = True
        if service == "/excitation/start":
            if self.falls:
                self.falls, self.enabled = self.falls - 1, False
            if not self.enabled or self.reason:
                raise UserError(f"/excitation/start refused: {self.reason or 'the drives are not enabled'}")
            self.excitation = {"run": "1", "begun_as": "1", "restarts": 0, "state": "done"} | self.ending
        return "run 1: started"


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr(demo_command, "REASON_S", 0.0)


def test_drives_that_fall_out_before_a_run_are_enabled_again(impatient, capsys):
    falls = demo_command.ATTEMPTS - 1
    chain = FakeChain(falls)
    demo_command.go_through(chain, demo_command.FAST_PLANS[0], Path("excitation.yaml"), lambda done, doing: None)
    assert chain.excitation["complete"]
    assert chain.calls.count("/driver/enable") == falls
    assert capsys.readouterr().err.count("the drives are not enabled") == falls


@pytest.mark.parametrize(
    "falls, reason, message, starts",
    [
        (99, "", f"{demo_command.ATTEMPTS} times", demo_command.ATTEMPTS),
        (0, "joint_2 would leave its limits", "joint_2 would leave", 1),
    ],
)
def test_a_run_that_cannot_begin_ends_the_demo(impatient, falls, reason, message, starts):
    chain = FakeChain(falls, reason)
    with pytest.raises(UserError, match=message):
        demo_command.go_through(chain, demo_command.FAST_PLANS[0], Path("excitation.yaml"), lambda done, doing: None)
    assert chain.calls.count("/excitation/start") == starts


def test_a_run_that_the_node_gave_up_is_begun_again_aloud_and_ends_the_demo_with_its_reason(impatient, capsys):
    """The driver leaves the stop to a person, for whom the demo stands in: the arm is simulated."""
    chain = FakeChain(0, broken="the drives are no longer enabled (drive: node 3); not begun again: EMCY")
    with pytest.raises(
        UserError, match=rf"{demo_command.ATTEMPTS} times .*at last: the drives are no longer enabled .drive: node 3"
    ):
        demo_command.go_through(chain, demo_command.FAST_PLANS[0], Path("excitation.yaml"), lambda done, doing: None)
    assert chain.calls.count("/excitation/start") == demo_command.ATTEMPTS
    assert capsys.readouterr().err.count("was stopped: the drives are no longer enabled") == demo_command.ATTEMPTS


def test_a_machine_too_busy_for_the_cycle_gets_a_slower_one_and_is_told(monkeypatch, tmp_path, capsys):
    tried = []

    def live_at(cycle_ms, directory, *_):
        tried.append(cycle_ms)
        parameters = demo_command.node_parameters(directory, cycle_ms)
        file = parameters.get("canopen_driver", {}).get("can_config", demo_command.config_path(demo_command.CAN))
        assert load_arm_can(Path(file)).bus.period == pytest.approx(1e-3 * cycle_ms)
        if cycle_ms < 4:
            raise demo_command.TooBusyError("the drives do not stay enabled")

    monkeypatch.setattr(demo_command, "_live_at", live_at)
    demo_command._live(tmp_path, demo_command.FAST_PLANS, [], lambda done, doing: None)
    assert tried == [1, 2, 4]
    printed = capsys.readouterr().err
    assert "does not keep a cycle of 1 ms" in printed and "again with 4 ms" in printed
