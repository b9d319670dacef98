"""After which stops a program may recover the arm and begin again by itself, and after which only a person may.

A program may where the stop has its cause in this machine and none in the arm: the driver's cycle was held up, or
set-points ceased, and what broke a limit is what bridging that asked for (`playback`). A person must where

- a person or a program halted the arm (`/driver/halt`), however it had been stopped before;
- a drive reported an error (EMCY), restarted, left operation or fell silent, or a bus failed: the drive knows more.
  One EMCY is this machine's own: 0x8130, "heartbeat error" (CiA 301), after the cycle was held up for longer than the
  drives wait for its heartbeat, as the driver itself has measured;
- a set-point was refused: the same run would be refused again, or somebody else streams;
- a joint is outside of its position limits;
- a limit of torque, velocity, acceleration or tracking was broken without a stall: then something touched the arm,
  or its limits do not fit it.
"""

from __future__ import annotations

from typing import Final

from spacearm_ident.canbus.events import Event, EventKind
from spacearm_ident.driver.safety import Fault, Rule
from spacearm_ident.errors import UserError

#: Rules that a bridged stall may break: the arm was asked for more than its path needs.
OF_A_STALL: Final = frozenset({Rule.VELOCITY, Rule.ACCELERATION, Rule.TORQUE, Rule.TRACKING})


def resumable(fault: Fault, bridging: bool = False) -> bool:
    """Whether a program may begin again after this stop.

    Args:
        fault: Why the arm was stopped.
        bridging: Whether a stall of the cycle was being bridged then (`Playback.bridging`).
    """
    return fault.rule is Rule.STARVATION or (bridging and fault.rule in OF_A_STALL)


class Silence:
    """Whether this driver, held up, was silent for longer than the drives wait for its heartbeat.

    Args:
        heartbeat: Interval of its heartbeats, s.
        timeout: How long the drives wait for one, s.
    """

    #: How long after a silence what drives say of it comes in, s: their EMCY waits in the socket.
    ECHO_S: Final = 1.0

    def __init__(self, heartbeat: float, timeout: float) -> None:
        # The last heartbeat may have been sent an interval before the silence began.
        self._least_ns = round(1e9 * (timeout - heartbeat))
        self._last_ns = self._until_ns = 0

    def cycle(self, now_ns: int) -> None:
        """A cycle begins, ns since the epoch."""
        if self._last_ns and now_ns - self._last_ns > self._least_ns:
            self._until_ns = now_ns + round(1e9 * self.ECHO_S)
        self._last_ns = now_ns

    def explains(self, event: Event) -> bool:
        """Whether an event is a drive's answer to it."""
        return event.kind is EventKind.MASTER_MISSED and self._last_ns < self._until_ns


class Latch:
    """Why the arm is stopped, until somebody recovers it.

    Attributes:
        fault: The first reason; None while it is not stopped.
    """

    def __init__(self) -> None:
        """Nothing is stopped."""
        self.fault: Fault | None = None
        self._resumable = self._halted = False

    @property
    def resumable(self) -> bool:
        """Whether the arm is stopped, and a program may begin again."""
        return self.fault is not None and self._resumable and not self._halted

    def trip(self, fault: Fault, may_resume: bool = False) -> None:
        """Stop for this reason; the first one stays.

        Args:
            fault: Why.
            may_resume: Whether a program may begin again after it.
        """
        if self.fault is None:
            self._resumable = may_resume
            self.fault = fault

    def halt(self, reason: str) -> None:
        """Stop because somebody wants it; from now on only `release` by somebody ends it, whatever came before."""
        self._halted = True
        self.trip(Fault(Rule.HALT, reason))

    def release(self) -> None:
        """Somebody asks to recover: they have seen to the arm."""
        self._halted = False

    def clear(self) -> None:
        """The arm has recovered; a halt that came meanwhile still stands."""
        self.fault = None
        if self._halted:
            self.trip(Fault(Rule.HALT, "halted while the arm recovered"))

    def require_resumable(self) -> Fault:
        """The fault, where a program may begin again.

        Raises:
            UserError: It may not, with the reason.
        """
        fault = self.fault
        if fault is None:
            raise UserError("nothing to resume from: the driver has not stopped the arm")
        if not self.resumable:
            why = "/driver/halt was called" if self._halted else f"{fault}; no held-up cycle was the cause"
            raise UserError(f"not resumed: {why}: see to the arm, then call /driver/recover")
        return fault
