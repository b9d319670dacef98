"""The CiA 402 state machine: every transition of the standard by its number, and nothing else."""

import itertools

import pytest
from canopen.profiles.p402 import State402
from hypothesis import given
from hypothesis import strategies as st

from spacearm_ident.canbus.cia402 import (
    Command,
    Event,
    Goal,
    State,
    after_command,
    after_event,
    command_of,
    controlword_toward,
    state_of,
    statusword_of,
)

N, D, R, S, O, Q, A, F = State  # noqa: E741 (in the order of the figure)

#: CiA 402-2 figure 6 and table 3, written out independently: number, from, controlword, to.
BY_COMMAND = [
    (2, D, 0x06, R), (3, R, 0x07, S), (4, S, 0x0F, O), (5, O, 0x07, S), (6, S, 0x06, R), (7, R, 0x00, D),
    (7, R, 0x02, D), (8, O, 0x06, R), (9, O, 0x00, D), (10, S, 0x00, D), (10, S, 0x02, D), (11, O, 0x02, Q),
    (12, Q, 0x00, D), (15, F, 0x80, D), (16, Q, 0x0F, O),
]  # fmt: skip
BY_EVENT = [
    (1, N, Event.INITIALISED, D), (12, Q, Event.STOP_DONE, D), (14, A, Event.REACTION_DONE, F),
    *((13, state, Event.FAULT, A) for state in (N, D, R, S, O, Q)),
]  # fmt: skip


@pytest.mark.parametrize("number, before, word, after", BY_COMMAND)
def test_transitions_by_controlword(number, before, word, after):
    assert after_command(before, word, previous=0) is after


@pytest.mark.parametrize("number, before, event, after", BY_EVENT)
def test_transitions_by_event(number, before, event, after):
    assert after_event(before, event) is after


def test_nothing_else_changes_the_state():
    commands = {(before, command_of(word)) for _, before, word, _ in BY_COMMAND}
    commands.add((R, Command.ENABLE_OPERATION))
    for state, command in itertools.product(State, Command):
        moves = after_command(state, command.value, 0) is not state
        assert moves == ((state, command) in commands)
    events = {(before, event) for _, before, event, _ in BY_EVENT}
    for state, event in itertools.product(State, Event):
        assert (after_event(state, event) is not state) == ((state, event) in events)


@pytest.mark.parametrize(
    "pattern, command",
    [("0xxxx110", Command.SHUTDOWN), ("0xxx0111", Command.SWITCH_ON), ("0xxx1111", Command.ENABLE_OPERATION),
     ("0xxxxx0x", Command.DISABLE_VOLTAGE), ("0xxxx01x", Command.QUICK_STOP),
     ("1xxxxxxx", Command.FAULT_RESET)],
)  # fmt: skip
def test_controlword_patterns(pattern, command):
    care = [(7 - i, int(bit)) for i, bit in enumerate(pattern) if bit != "x"]
    words = [w for w in range(0x100) if all(w >> bit & 1 == value for bit, value in care)]
    assert words and {command_of(w) for w in words} == {command}
    assert {command_of(w | 0x1F00) for w in words} == {command}


def test_fault_reset_needs_a_rising_edge():
    assert after_command(F, 0x80, previous=0x80) is F
    assert after_command(F, 0x80, previous=0x0F) is D
    assert after_command(F, 0x0F, previous=0x00) is F


@given(st.integers(0, 0xFFFF))
def test_statuswords_read_as_the_canopen_library_reads_them(word):
    expected = [name for name, (mask, bits) in State402.SW_MASK.items() if word & mask == bits]
    found = state_of(word)
    assert [found.label.upper()] == expected if found else not expected


@given(st.sampled_from(State), st.integers(0, 0xFFFF))
def test_statuswords_there_and_back(state, other_bits):
    assert state_of(statusword_of(state)) is state
    assert state_of(statusword_of(state) | other_bits & 0xFF90) is state


def _run(state, goal, steps=12):
    word, seen = 0, [state]
    for _ in range(steps):
        previous, word = word, controlword_toward(goal, state, word)
        state = after_command(state, word, previous)
        seen.append(state)
    return seen


@pytest.mark.parametrize("start", [D, R, S, O, Q])
def test_the_goals_are_reached_from_everywhere_and_kept(start):
    assert _run(start, Goal.ENABLED)[-3:] == [O] * 3
    assert _run(start, Goal.DISABLED)[-3:] == [D] * 3
    assert _run(start, Goal.QUICK_STOP)[1:] == [Q if start in (O, Q) else D] * 12


@pytest.mark.parametrize("goal", [Goal.ENABLED, Goal.DISABLED, Goal.QUICK_STOP])
@pytest.mark.parametrize("stuck", [F, A, N])
def test_only_an_explicit_request_leaves_a_fault(goal, stuck):
    assert _run(stuck, goal) == [stuck] * 13


def test_reset_leaves_the_fault_and_never_enables():
    assert _run(F, Goal.RESET)[1:] == [D] * 12
    for start in (D, R, S, O, Q):
        assert _run(start, Goal.RESET)[1:] == [D] * 12


def test_a_failed_reset_is_tried_again_with_a_new_edge():
    words = [0]
    for _ in range(4):
        words.append(controlword_toward(Goal.RESET, F, words[-1]))
    assert words == [0, 0x80, 0, 0x80, 0]


def test_enabling_never_resumes_directly_out_of_a_quick_stop():
    assert _run(Q, Goal.ENABLED)[:3] == [Q, D, R]


def test_disabling_goes_down_step_by_step():
    assert _run(O, Goal.DISABLED)[:4] == [O, S, R, D]


def test_an_unknown_state_gets_no_power():
    assert state_of(0x01) is None
    assert command_of(controlword_toward(Goal.ENABLED, None)) is Command.DISABLE_VOLTAGE


def test_power():
    assert {state for state in State if state.powered} == {S, O, Q, A}
