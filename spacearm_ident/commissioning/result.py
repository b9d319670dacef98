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
    """A check that passed.

    Args:
        subject: What was checked.
        message: What was found.
    """
    return CheckResult(subject, Level.OK, message)


def warn(subject: str, message: str, advice: str) -> CheckResult:
    """A check that passed with a limitation that should be known.

    Args:
        subject: What was checked.
        message: What was found.
        advice: What to do about it.
    """
    return CheckResult(subject, Level.WARN, message, advice)


def fail(subject: str, message: str, advice: str) -> CheckResult:
    """A check that failed: the arm cannot work like this.

    Args:
        subject: What was checked.
        message: What was found.
        advice: What to do about it.
    """
    return CheckResult(subject, Level.FAIL, message, advice)
