"""Drives that would move the arm wrongly: the driver refuses to enable them, and says what to do; over the real bus."""

import math
import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.datatypes import UNSIGNED8
from canopen.sdo import SdoAbortedError
from four_axes import ARM as FOUR
from live_nodes import LIVE, wait_for
from simulated_arm import CONFIG
from simulated_bus import SCALE, simulated_drives

from spacearm_ident.canbus.arm_bus import optional_writes
from spacearm_ident.canbus.cia402 import State, notes_of
from spacearm_ident.driver.arm_can import ArmCan, BusAddress, load_arm_can
from spacearm_ident.driver.arm_driver import ArmDriver
from spacearm_ident.driver.last_seen import SAG, LastSeen
from spacearm_ident.driver.safety import Limits
from spacearm_ident.driver.status import Phase
from spacearm_ident.errors import UserError
from spacearm_ident.simulation.drives.dictionary import OUT_OF_RANGE, key
from spacearm_ident.simulation.drives.drive import ERROR_CODE, MODE

pytestmark = [*LIVE, pytest.mark.alone, pytest.mark.usefixtures("own_buses")]
JOINTS = ("j1", "j2", "j3", "j4")
LIMITS = Limits(
    JOINTS,
    lower=np.full(4, -1.0),
    upper=np.full(4, 1.0),
    velocity=np.full(4, 2.0),
    acceleration=np.full(4, 20.0),
    torque=np.full(4, np.inf),
    tracking=np.full(4, 0.05),
)
BUS = replace(
    FOUR,
    heartbeat=0.05,
    heartbeat_timeout=1.5,
    axes=tuple(replace(axis, limits=(-1.0, 1.0), quick_stop_deceleration=60.0) for axis in FOUR.axes),
)
PER_RAD = 1.0 / SCALE.rad_per_count


def config(bus=BUS, limits=LIMITS):
    arm = load_arm_can(CONFIG / "paper_arm_can.yaml").arm
    return ArmCan(arm, (BusAddress("local", "a"), BusAddress("local", "b")), bus, limits)


@contextmanager
def driven(habit=None, bus=BUS):
    """Drives with a habit, and a driver that is connected to them."""
    with simulated_drives(("a", "b"), habit=habit) as process, driver_of(process, bus) as driver:
        yield process, driver


@contextmanager
def driver_of(process, bus=BUS, connected=True):
    driver = ArmDriver(config(bus), on_sample=lambda *_: None, priority=0)
    driver.start()
    try:
        if connected:
            wait_for(lambda: driver.phase is Phase.DISABLED, "a connection")
        yield driver
    finally:
        driver.close()


def positions(drives, arm):
    return arm.position.tolist()


def states(drives, arm):
    return [drive.state for drive in drives]


def held(process):
    """The arm does not move in a quarter of a second."""
    before = process.act(positions)
    time.sleep(0.25)
    np.testing.assert_allclose(process.act(positions), before, atol=1e-4)
    return before


# A position that was lost ----------------------------------------------------------------------------------


def place(position):
    def habit(drives, arm):
        arm.position[:] = position

    return habit


def power_cycle(drives, arm, joint, lost):
    """Switch a drive off and on; an incremental encoder (`lost`) then counts from zero."""
    drive = drives[joint]
    if lost:
        drive._zero = -arm.position[joint] * PER_RAD
    drive.reset()


@pytest.mark.parametrize("enabled", [False, True])
def test_drive_that_comes_back_with_another_position_is_not_enabled(enabled):
    with driven(place([0.0, 0.0, 0.5, 0.0])) as (process, driver):
        if enabled:
            assert driver.enable() == "enabled, the arm is held where it is"
        process.act(power_cycle, 2, True)
        wait_for(lambda: driver.fault, "the restart noticed")
        for _ in range(2):
            with pytest.raises(UserError, match=r"not recovered: j3 is at 0 rad .* but was at 0.5 rad .* Home it or"):
                driver.recover()
        with pytest.raises(UserError, match="not enabled"):
            driver.enable()
        assert any("j3 is at" in text for text in driver.status().warnings)
        assert State.OPERATION_ENABLED not in process.act(states)
        held(process)
        # A person has compared the posture, and says so.
        driver.close()
        with driver_of(process) as anew:
            assert anew.enable() == "enabled, the arm is held where it is"


@pytest.mark.parametrize("enabled", [False, True])
def test_drive_that_comes_back_where_it_was_is_recovered(enabled):
    with driven(place([0.0, 0.0, 0.5, 0.0])) as (process, driver):
        if enabled:
            driver.enable()
        process.act(power_cycle, 2, False)
        wait_for(lambda: driver.fault, "the restart noticed")
        assert "recovered" in driver.recover()
        assert driver.enable() == "enabled, the arm is held where it is"
        assert abs(held(process)[2] - 0.5) < 1e-3


def freeze(drives, arm, joint, elsewhere):
    drives[joint].faults.silent = True
    drives[joint].faults._frozen_until = drives[joint].faults._now + 0.5
    if elsewhere:
        drives[joint]._zero -= 0.1 * PER_RAD


@pytest.mark.parametrize("elsewhere", [False, True])
def test_silent_drive_is_compared_with_where_it_was(elsewhere):
    with driven() as (process, driver):
        driver.enable()
        driver.disable()
        process.act(freeze, 1, elsewhere)
        wait_for(lambda: driver.fault, "the silence noticed")
        time.sleep(0.6)
        if not elsewhere:
            assert "recovered" in driver.recover()
            return
        with pytest.raises(UserError, match=r"j2 is at -0.1 rad .* but was at"):
            driver.recover()


def test_connecting_makes_no_drive_lose_its_position():
    """A drive with an incremental encoder counts from zero after NMT reset node."""

    def incremental(drives, arm):
        arm.position[:] = 0.3
        for drive in drives:
            drive.node_resets = 0
            reset = drive.reset

            def counted(communication_only=False, drive=drive, reset=reset):
                drive.node_resets += not communication_only
                reset(communication_only)

            drive.reset = counted

    with driven(incremental) as (process, driver):
        driver.enable()
        driver.halt()
        driver.recover()
    with simulated_drives(("a", "b"), habit=incremental) as process, driver_of(process):
        pass
        # One is the power-on.
        assert process.act(node_resets) == [1] * 4


def node_resets(drives, arm):
    return [drive.node_resets for drive in drives]


seen_limits = replace(LIMITS, velocity=np.full(4, 1.0))


@pytest.fixture
def seen():
    return LastSeen(seen_limits, [4.0] * 4, 0.06, 0.004)


def test_bound_of_a_joint_at_rest_is_the_sag_however_long_it_was_away(seen):
    fresh, still = np.ones(4, dtype=bool), np.zeros(4)
    assert seen.compare(np.full(4, 9.0)) == "", "what was never seen can be anywhere"
    seen.observe(still, still, fresh, still, fresh)
    for _ in range(10000):
        seen.observe(np.full(4, 0.5), still, ~fresh, still, fresh)
    assert seen.compare(np.full(4, 0.9 * SAG)) == ""
    assert "j1 is at 0.04 rad" in seen.compare(np.array([0.9 * SAG + 1.1 * SAG, 0, 0, 0]))
    assert seen.compare(np.full(4, 0.9 * SAG)) == ""


def test_bound_of_a_moving_joint_is_what_it_was_asked_for_its_extrapolation_and_its_braking(seen):
    fresh, still, speed = np.ones(4, dtype=bool), np.zeros(4), np.array([0.8, 0.0, 0.0, 0.0])
    seen.observe(still, speed, fresh, still, fresh)
    for k in range(1, 26):
        seen.observe(still, still * math.nan, ~fresh, speed * 0.004 * k, fresh)
    reach = 0.08 + SAG + 0.8 * 0.06 + 0.8**2 / 8.0
    assert "can have moved by" in seen.compare(np.array([reach + 0.001, 0, 0, 0]))
    assert seen.compare(np.array([reach - 0.001, 0, 0, 0])) == ""


def test_drive_that_is_distrusted_is_not_followed_before_it_is_compared(seen):
    fresh, still = np.ones(4, dtype=bool), np.zeros(4)
    seen.observe(still, still, fresh, still, fresh)
    seen.distrust(1)
    seen.observe(np.full(4, 0.5), still, fresh, np.full(4, 0.5), ~fresh)
    assert "j2 is at 0.5 rad" in seen.compare(np.full(4, 0.5))
    seen.observe(np.full(4, 0.5), still, fresh, np.full(4, 0.5), ~fresh)
    assert seen.position.tolist() == [0.5, 0.0, 0.5, 0.5]


# Position limits -------------------------------------------------------------------------------------------


def position_limits(drives, arm):
    return [(drive.values[key(0x607D, 1)], drive.values[key(0x607D, 2)]) for drive in drives]


def test_joint_outside_of_its_limits_is_not_enabled_and_its_drive_is_not_told_to_move_it():
    with driven(place([0.0, 2.0, 0.0, 0.0])) as (process, driver):
        for _ in range(2):
            with pytest.raises(
                UserError, match=r"not enabled: j2 stands at 2 rad, its limits are -1 to 1: .*zero_counts"
            ):
                driver.enable()
            assert process.act(states) == [State.SWITCH_ON_DISABLED] * 4
            driver.halt()
            driver.recover()
        assert any("j2 stands at 2 rad" in text for text in driver.status().warnings)
        low, high = process.act(position_limits)[1]
        assert low <= 2.0 * PER_RAD - 1 and high >= 2.0 * PER_RAD - 1
        assert held(process)[1] == 2.0


def test_joint_just_outside_of_its_limits_as_after_an_overshoot_is_enabled_and_does_not_move():
    with driven(place([0.0, 1.04, 0.0, 0.0])) as (process, driver):
        driver.enable()
        assert held(process)[1] == pytest.approx(1.04, abs=1e-5)


def shift(drives, arm, joint, position):
    arm.position[joint] = position


def test_joint_that_was_moved_by_hand_without_power_is_enabled_where_it_is_now():
    with driven() as (process, driver):
        process.act(shift, 1, 1.03)
        time.sleep(0.1)
        driver.enable()
        assert held(process)[1] == pytest.approx(1.03, abs=1e-5)
        driver.disable()
        process.act(shift, 1, 1.3)
        time.sleep(0.1)
        with pytest.raises(UserError, match=r"j2 stands at 1.3 rad"):
            driver.enable()


# Modes of operation ----------------------------------------------------------------------------------------


def stays_in(mode, joint=2):
    def habit(drives, arm):
        stay_in(drives, arm, mode, joint)

    return habit


def stay_in(drives, arm, mode, joint=2):
    drive = drives[joint]

    def change():
        drive.values[key(0x6061)] = mode

    drive._change_mode = change
    change()


@pytest.mark.parametrize("mode, name", [(3, "profile velocity"), (1, "profile position"), (-2, "")])
def test_drive_that_stays_in_another_mode_is_not_enabled(mode, name):
    with driven(stays_in(mode)) as (process, driver):
        with pytest.raises(UserError) as refusal:
            driver.enable()
        words = f"node 3 is in mode of operation {mode}{name and ', ' + name} (0x6061), wanted is 8, cyclic synchronous"
        assert words in str(refusal.value)
        assert process.act(states) == [State.SWITCH_ON_DISABLED] * 4 and driver.phase is Phase.DISABLED


def test_mode_is_asked_for_again_at_every_recover_and_enable():
    with driven() as (process, driver):
        driver.enable()
        process.act(stay_in, 3)
        driver.halt()
        with pytest.raises(UserError, match="not recovered: node 3 is in mode of operation 3"):
            driver.recover()
        assert driver.phase is Phase.FAULT
        process.act(obeys)
        driver.recover()
        driver.enable()
        driver.disable()
        process.act(stay_in, 1)
        with pytest.raises(UserError, match="not enabled: node 3 is in mode of operation 1"):
            driver.enable()


def obeys(drives, arm):
    for drive in drives:
        vars(drive).pop("_change_mode", None)


def change_when_enabled(drives, arm):
    drive = drives[2]
    enter = drive._enter

    def entered(state):
        enter(state)
        drive.values[key(0x6061)] = 3 if drive.state is State.OPERATION_ENABLED else drive.values[MODE]

    drive._enter = entered


def test_drive_that_changes_its_mode_as_it_is_enabled_is_disabled_again():
    with driven(change_when_enabled) as (process, driver):
        with pytest.raises(UserError, match="not enabled: node 3 is in mode of operation 3"):
            driver.enable()
        wait_for(lambda: process.act(states) == [State.SWITCH_ON_DISABLED] * 4, "the drives disabled")


def run_away(drives, arm, joint, velocity):
    """Follow no target under power, but turn."""
    arm._time_constant = 1e9
    arm.runaway[joint] = velocity


def test_arm_is_said_to_be_held_only_once_it_stands():
    with driven() as (process, driver):
        process.act(run_away, 2, 0.03)
        with pytest.raises(UserError, match="j3"):
            driver.enable()
        wait_for(lambda: process.act(states) == [State.SWITCH_ON_DISABLED] * 4 or driver.fault, "the drives stopped")


# Faults ----------------------------------------------------------------------------------------------------


def silent_fault(drives, arm, joint, code):
    """A fault without EMCY."""
    drives[joint].values[ERROR_CODE] = code
    drives[joint]._enter(State.FAULT)


def test_drive_that_was_in_fault_before_the_first_enable_is_recovered():
    with simulated_drives(("a", "b")) as process:
        process.act(silent_fault, 1, 0x7305)
        with driver_of(process) as driver:
            assert any("j2 is in fault, node 2 has error code 0x7305" in text for text in driver.status().warnings)
            with pytest.raises(UserError, match=r"not enabled: j2 is in fault, .* 0x7305 .*call /driver/recover"):
                driver.enable()
            assert process.act(states)[1] is State.FAULT
            assert "recovered from: j2 is in fault, node 2 has error code 0x7305" in driver.recover()
            assert not driver.status().warnings
            assert driver.enable() == "enabled, the arm is held where it is"
            held(process)


def test_fault_without_emcy_while_disabled_is_recovered():
    with driven() as (process, driver):
        process.act(silent_fault, 3, 0x7500)
        wait_for(lambda: driver.status().warnings, "the fault shown")
        assert "0x7500" in driver.recover()
        driver.enable()


def hopeless(drives, arm):
    drive = drives[1]
    silent_fault(drives, arm, 1, 0x7305)
    drive._apply = lambda word: None


def test_fault_that_cannot_be_reset_is_told_with_its_code():
    with simulated_drives(("a", "b")) as process:
        process.act(hopeless)
        with driver_of(process) as driver, pytest.raises(UserError, match=r"not recovered: j2 stays in fault .*0x7305"):
            driver.recover()


def test_recover_without_a_fault_says_so():
    with driven() as (_, driver):
        assert driver.recover() == "there is no fault to recover from"
        driver.enable()
        assert driver.recover() == "there is no fault to recover from"
        assert driver.phase is Phase.ENABLED


def test_drives_of_a_killed_master_are_brought_to_rest_before_they_are_configured():
    """Reset communication does not take them out of power, and they are told not to stop by themselves."""

    def stays_enabled(drives, arm):
        for drive in drives:
            drive.connection_lost = lambda code: None

    with simulated_drives(("a", "b"), habit=stays_enabled) as process:
        with driver_of(process) as driver:
            driver.enable()
            driver.disable = lambda: ""
            driver._wanted = True
        assert process.act(states) == [State.OPERATION_ENABLED] * 4
        with driver_of(process) as driver:
            assert process.act(states) == [State.SWITCH_ON_DISABLED] * 4
            driver.enable()


# What is refused and what is found -------------------------------------------------------------------------


def refuses(index, sub, code):
    """Drive 2 refuses the write of an object with an abort code."""

    def habit(drives, arm):
        def refuse(_):
            raise SdoAbortedError(code)

        drives[1].dictionary.before_write[key(index, sub)] = refuse

    return habit


@pytest.mark.parametrize(
    "index, sub, code, words",
    [
        (0x1A00, 0, 0x06040042, [r"0x1A00:0 (TPDO 1 mapping) = 0 is refused", "PDO length exceeded", "slim: true"]),
        (0x1600, 1, 0x08000022, ["0x1600:1 (RPDO 1 mapping)", "present device state", "fixed", "slim: true"]),
        (0x6060, 0, 0x08000022, ["0x6060 (modes of operation) = 8", "end other tools"]),
        (0x1016, 1, 0x06020000, ["0x1016:1 (consumer heartbeat time)", "does not exist", "spacearm check"]),
    ],
)
def test_refused_object_is_named_with_what_was_written_why_and_what_to_do(index, sub, code, words):
    with (
        simulated_drives(("a", "b"), habit=refuses(index, sub, code)) as process,
        driver_of(process, connected=False) as driver,
    ):
        wait_for(lambda: "last attempt" in driver.connection, "an attempt")
        for word in ["node 2 cannot be configured: ", f"0x{code:08X}", *words]:
            assert word in driver.connection


def test_refused_setting_of_the_drives_own_watch_is_a_warning_with_its_name():
    with driven(refuses(0x6065, 0, OUT_OF_RANGE)) as (_, driver):
        assert any("node 2: 0x6065 (following error window) = " in text for text in driver.warnings)
        assert driver.enable()


def deaf_to(index):
    """Drive 3 answers no SDO request for an object."""

    def habit(drives, arm):
        dictionary = drives[2].dictionary
        answer = dictionary.on_sdo
        dictionary.on_sdo = lambda data: None if int.from_bytes(data[1:3], "little") == index else answer(data)

    return habit


def test_object_that_is_not_answered_is_named_with_how_long_it_was_waited_for():
    bus = replace(BUS, sdo_timeout=0.1)
    words = "node 3 cannot be configured: 0x60C2:1 (interpolation time period) = 4: no answer within 0.1 s"
    with (
        simulated_drives(("a", "b"), habit=deaf_to(0x60C2)) as process,
        driver_of(process, bus, connected=False) as driver,
    ):
        wait_for(lambda: words in driver.connection, "an attempt")


def narrow(drives, arm):
    drives[0].values[key(0x607D, 1)], drives[0].values[key(0x607D, 2)] = -100_000, 100_000


def test_position_limits_of_the_drive_that_are_widened_are_a_warning_with_both_ranges():
    with simulated_drives(("a", "b")) as process:
        process.act(narrow)
        with driver_of(process) as driver:
            (text,) = driver.warnings
            assert "node 1: its own position limits (0x607D) were -0.09587 to 0.09587 rad (-100000 to 100000" in text
            assert "sets -1 to 1 rad" in text
            process.act(power_cycle, 1, False)
            wait_for(lambda: driver.fault, "the restart noticed")
            driver.recover()
            assert driver.warnings == [text]


def inverted(drives, arm):
    dictionary = drives[3].dictionary
    polarity = ODVariable("Polarity", 0x607E)
    polarity.data_type = UNSIGNED8
    dictionary.object_dictionary.add_object(polarity)
    dictionary._variables[key(0x607E)] = polarity
    dictionary.values[key(0x607E)] = polarity.default = 0x80


def test_polarity_of_a_drive_is_a_warning():
    with driven(inverted) as (_, driver):
        assert [text for text in driver.warnings if "node 4 has polarity 0x80 (0x607E)" in text]


def remote_off(drives, arm):
    drive = drives[1]
    show = drive._show_status

    def shown():
        show()
        drive.values[key(0x6041)] &= ~0x0200

    drive._show_status, drive._apply = shown, lambda word: None


def test_statusword_says_why_a_drive_cannot_be_enabled():
    words = r"j2 stays in switch on disabled .*remote off"
    with driven(remote_off) as (_, driver), pytest.raises(UserError, match=words):
        driver.enable()


@pytest.mark.parametrize(
    "word, said",
    [
        (0x0250, ""),
        (0x0240, "no voltage, or safe torque off (bit 4)"),
        (0x0050, "remote off: another interface or tool controls it (bit 9)"),
        (0x0AD0, "internal limit active (bit 11); warning (bit 7)"),
    ],
)
def test_bits_of_the_statusword_in_words(word, said):
    assert notes_of(word) == (said and f"its statusword 0x{word:04X} says: {said}")


def test_quick_stop_deceleration_is_written_in_the_drives_unit():
    axis = replace(BUS.axes[0], quick_stop_deceleration=3.0)
    turns = 3.0 / (2 * math.pi) * SCALE.gear_ratio
    wanted = {"counts/s2": round(turns * SCALE.counts_per_turn), "rpm/s": round(60 * turns), "none": None}
    for unit, value in wanted.items():
        writes = optional_writes(replace(axis, quick_stop_unit=unit), BUS)
        assert [write.value for write in writes if write.index == 0x6085] == ([] if value is None else [value])
    with pytest.raises(UserError, match="quick_stop_unit is 'deg': give one of"):
        replace(axis, quick_stop_unit="deg")
