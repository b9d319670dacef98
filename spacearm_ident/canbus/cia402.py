"""The CiA 402 power state machine as a table, for both ends of the bus.

The drive's side: `command_of` reads a controlword, `after_command` and `after_event` give the next state,
`statusword_of` reports it. The master's side: `state_of` reads a statusword, `controlword_toward` says what
to send next to come closer to a goal. Numbers in comments are the transitions of CiA 402-2, figure 6.

Two things are stricter than the standard asks. A fault is left only on the goal `RESET`, which ends in
"switch on disabled" and never enables. And the way from "quick stop active" back to "operation enabled"
leads through "switch on disabled", so no motion resumes out of a quick stop where it was interrupted.
"""

from __future__ import annotations

from enum import Enum
from typing import Final


class State(Enum):
    """Power states; the value is what the statusword shows in bits 0 to 3, 5 and 6."""

    NOT_READY_TO_SWITCH_ON = 0x00
    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08

    @property
    def powered(self) -> bool:
        """Whether the motor is under power (and the brake open)."""
        return self in _POWERED

    @property
    def label(self) -> str:
        """For people: `operation enabled`."""
        return self.name.lower().replace("_", " ")


class Command(Enum):
    """What a controlword asks for; the value is the word to send."""

    SHUTDOWN = 0x0006
    #: Also "disable operation", which is the same pattern (transition 5).
    SWITCH_ON = 0x0007
    ENABLE_OPERATION = 0x000F
    QUICK_STOP = 0x0002
    DISABLE_VOLTAGE = 0x0000
    FAULT_RESET = 0x0080


class Event(Enum):
    """What happens inside the drive."""

    INITIALISED = "initialised"
    FAULT = "fault"
    REACTION_DONE = "reaction done"
    STOP_DONE = "stop done"


class Goal(Enum):
    """Where the master wants a drive to be."""

    ENABLED = "enabled"
    DISABLED = "disabled"
    QUICK_STOP = "quick stop"
    RESET = "reset"


_S, _C, _E = State, Command, Event
_POWERED: Final = frozenset((_S.SWITCHED_ON, _S.OPERATION_ENABLED, _S.QUICK_STOP_ACTIVE, _S.FAULT_REACTION_ACTIVE))

#: State and command to next state; a pair that is not here changes nothing.
TRANSITIONS: Final[dict[tuple[State, Command], State]] = {
    (_S.SWITCH_ON_DISABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 2
    (_S.READY_TO_SWITCH_ON, _C.SWITCH_ON): _S.SWITCHED_ON,  # 3
    # "Switch on and enable": the enabling follows while the word stands.
    (_S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION): _S.SWITCHED_ON,  # 3
    (_S.SWITCHED_ON, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 4
    (_S.OPERATION_ENABLED, _C.SWITCH_ON): _S.SWITCHED_ON,  # 5
    (_S.SWITCHED_ON, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 6
    (_S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 7
    (_S.READY_TO_SWITCH_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 7
    (_S.OPERATION_ENABLED, _C.SHUTDOWN): _S.READY_TO_SWITCH_ON,  # 8
    (_S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 9
    (_S.SWITCHED_ON, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 10
    (_S.SWITCHED_ON, _C.QUICK_STOP): _S.SWITCH_ON_DISABLED,  # 10
    (_S.OPERATION_ENABLED, _C.QUICK_STOP): _S.QUICK_STOP_ACTIVE,  # 11
    (_S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.FAULT, _C.FAULT_RESET): _S.SWITCH_ON_DISABLED,  # 15
    (_S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION): _S.OPERATION_ENABLED,  # 16
}

#: State and internal event to next state; a pair that is not here changes nothing.
EVENTS: Final[dict[tuple[State, Event], State]] = {
    (_S.NOT_READY_TO_SWITCH_ON, _E.INITIALISED): _S.SWITCH_ON_DISABLED,  # 1
    (_S.QUICK_STOP_ACTIVE, _E.STOP_DONE): _S.SWITCH_ON_DISABLED,  # 12
    (_S.FAULT_REACTION_ACTIVE, _E.REACTION_DONE): _S.FAULT,  # 14
    **{
        (state, _E.FAULT): _S.FAULT_REACTION_ACTIVE  # 13
        for state in State
        if state not in (_S.FAULT, _S.FAULT_REACTION_ACTIVE)
    },
}

#: Goal and state to the command that leads there; what is not here stays with DISABLE_VOLTAGE.
_TOWARD: Final[dict[tuple[Goal, State], Command]] = {
    (Goal.ENABLED, _S.SWITCH_ON_DISABLED): _C.SHUTDOWN,
    (Goal.ENABLED, _S.READY_TO_SWITCH_ON): _C.SWITCH_ON,
    (Goal.ENABLED, _S.SWITCHED_ON): _C.ENABLE_OPERATION,
    (Goal.ENABLED, _S.OPERATION_ENABLED): _C.ENABLE_OPERATION,
    # Step by step down, so that the drive stops on its ramp instead of coasting.
    (Goal.DISABLED, _S.OPERATION_ENABLED): _C.SWITCH_ON,
    (Goal.DISABLED, _S.SWITCHED_ON): _C.SHUTDOWN,
}

#: Bits of the statusword beside the state.
VOLTAGE_ENABLED: Final = 0x0010
WARNING: Final = 0x0080
REMOTE: Final = 0x0200
INTERNAL_LIMIT: Final = 0x0800
#: In the interpolated and cyclic modes: the drive follows the set-points.
FOLLOWING: Final = 0x1000
FOLLOWING_ERROR: Final = 0x2000

_MASKS: Final[dict[State, int]] = {
    state: 0x4F
    if state in (_S.NOT_READY_TO_SWITCH_ON, _S.SWITCH_ON_DISABLED, _S.FAULT_REACTION_ACTIVE, _S.FAULT)
    else 0x6F
    for state in State
}
_BY_LOW_BITS: Final = tuple(
    next((state for state in State if low & _MASKS[state] == state.value), None) for low in range(0x80)
)


def state_of(statusword: int) -> State | None:
    """The state a statusword shows; None for a pattern CiA 402 does not define."""
    return _BY_LOW_BITS[statusword & 0x7F]


def notes_of(statusword: int) -> str:
    """What a statusword says beside the state of what keeps a drive from being enabled, for a person; may be empty.

    Safe torque off has no bit of its own in CiA 402: drives show it as a missing voltage, if at all.
    """
    notes = (
        (not statusword & VOLTAGE_ENABLED, "no voltage, or safe torque off (bit 4)"),
        (not statusword & REMOTE, "remote off: another interface or tool controls it (bit 9)"),
        (statusword & INTERNAL_LIMIT, "internal limit active (bit 11)"),
        (statusword & WARNING, "warning (bit 7)"),
    )
    said = "; ".join(text for holds, text in notes if holds)
    return f"its statusword 0x{statusword:04X} says: {said}" if said else ""


def statusword_of(state: State) -> int:
    """The statusword of a drive in `state`, remote controlled, with no other bit set."""
    return state.value | REMOTE | (VOLTAGE_ENABLED if state.powered else 0)


def command_of(controlword: int) -> Command:
    """What a controlword asks for (CiA 402-2, table 4); every word is some command.

    A fault reset is a rising edge of bit 7: the drive must compare with the word before.
    """
    if controlword & 0x80:
        return Command.FAULT_RESET
    if not controlword & 0x02:
        return Command.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return Command.QUICK_STOP
    if not controlword & 0x01:
        return Command.SHUTDOWN
    return Command.ENABLE_OPERATION if controlword & 0x08 else Command.SWITCH_ON


def after_command(state: State, controlword: int, previous: int) -> State:
    """The drive's state after `controlword`, where the word before was `previous`.

    Args:
        state: State of the drive before the command.
        controlword: The 16-bit controlword (0x6040) received.
        previous: The controlword received before it: bit 7 resets a fault only on a rising edge.

    Returns:
        The new state; `state` itself where CiA 402 defines no transition for the command.
    """
    command = command_of(controlword)
    if command is Command.FAULT_RESET and previous & 0x80:
        return state
    return TRANSITIONS.get((state, command), state)


def after_event(state: State, event: Event) -> State:
    """The drive's state after something happened inside it.

    Args:
        state: The state before.
        event: What happened: `INITIALISED`, `FAULT`, or the end of a fault reaction or of a quick stop.

    Returns:
        The next state by `EVENTS`; the same state where the event changes nothing there.
    """
    return EVENTS.get((state, event), state)


def controlword_toward(goal: Goal, state: State | None, previous: int = 0) -> int:
    """The controlword that brings a drive one step closer to `goal`.

    Args:
        goal: `ENABLED` never leaves a fault, `RESET` leaves it without enabling.
        state: As its statusword shows; None (unknown) is answered with "disable voltage".
        previous: The word sent before, for the edge of the fault reset.
    """
    if goal is Goal.QUICK_STOP:
        return Command.QUICK_STOP.value
    if goal is Goal.RESET:
        wanted = state is State.FAULT and not previous & 0x80
        return Command.FAULT_RESET.value if wanted else Command.DISABLE_VOLTAGE.value
    if state is None:
        return Command.DISABLE_VOLTAGE.value
    return _TOWARD.get((goal, state), Command.DISABLE_VOLTAGE).value
