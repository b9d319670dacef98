"""What a driver's drives said when they were connected is in its status and its log, once."""

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import pytest

from spacearm_ident.driver.status import DriverStatus, Phase
from spacearm_ident.nodes.canopen_driver import CanopenDriver
from spacearm_ident.nodes.runtime import Level

RATED = "node 2 states a rated value of 6.1 A (0x6075), configured are 3.05 A"
REFUSED = "node 3 refuses 0x6065:0"


def a_node(phase: Phase, warnings: list[str], notes: tuple[str, ...] = ()) -> tuple[Any, list[tuple[Level, str]]]:
    """A driver node without a graph, and what it logs."""
    plain = dict.fromkeys((field.name for field in fields(DriverStatus)), 0)
    logged: list[tuple[Level, str]] = []

    def status() -> DriverStatus:
        other = {"phase": phase, "fault": None, "connection": "connected", "warnings": tuple(warnings)}
        return DriverStatus(**(plain | {"states": {}, "lateness_s": (0.0,) * 3, "loads": ()} | other))  # type: ignore[arg-type]

    driver = SimpleNamespace(status=status, findings=warnings, notes=notes)
    return SimpleNamespace(_driver=driver, _logged=set(), log=lambda *said: logged.append(said)), logged


@pytest.mark.parametrize("phase", [Phase.ENABLED, Phase.DISABLED])
def test_a_status_that_warns_says_of_what(phase):
    node, _ = a_node(phase, [RATED, REFUSED])
    (status,) = CanopenDriver.diagnose(node)
    assert status.level is Level.WARN
    assert status.message == f"{phase.value}; warning: {RATED}; {REFUSED}"
    (status,) = CanopenDriver.diagnose(a_node(phase, [])[0])
    assert (status.level, status.message) == (Level.OK, phase.value)


def test_a_warning_is_logged_once_however_often_the_drives_are_connected():
    warnings = [RATED]
    node, logged = a_node(Phase.DISABLED, warnings, ("node 6 states 0x6076 in µN·m",))
    CanopenDriver._log_once(node)
    CanopenDriver._log_once(node)
    assert logged == [(Level.WARN, RATED), (Level.OK, "node 6 states 0x6076 in µN·m")]
    warnings.append(REFUSED)
    CanopenDriver._log_once(node)
    assert logged[2:] == [(Level.WARN, REFUSED)]
