"""What a check found: one line, and what to do where it is not well."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Level(StrEnum):
    """How a check came out."""

    OK = "ok"
    WARN = "warn"
    FAIL = "fail"


@dataclass(frozen=True)
class CheckResult:
    """One line of `spacearm check`.

    Attributes:
        subject: What was looked at.
        level: How it is.
        message: What was found.
        advice: What to do about it; empty where nothing needs doing.
    """

    subject: str
    level: Level
    message: str
    advice: str = ""


def ok(subject: str, message: str) -> CheckResult:
    """All is well."""
    return CheckResult(subject, Level.OK, message)


def warn(subject: str, message: str, advice: str) -> CheckResult:
    """It works, with a limit that should be known."""
    return CheckResult(subject, Level.WARN, message, advice)


def fail(subject: str, message: str, advice: str) -> CheckResult:
    """It cannot work like this."""
    return CheckResult(subject, Level.FAIL, message, advice)
