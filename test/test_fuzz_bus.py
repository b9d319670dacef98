"""Hostile traffic on the bus, and hostile text in what is printed; see test_fuzz."""

from __future__ import annotations

import struct
from html.parser import HTMLParser

import can
import canopen
import numpy as np
import pytest
from fuzzing import EXAMPLES, FEW, ends_well
from hypothesis import given
from hypothesis import strategies as st
from simulated_bus import SCALE

from spacearm_ident.canbus import frames, master
from spacearm_ident.canbus.arm_bus import ArmBus, Axis
from spacearm_ident.canbus.cycle import Cycle
from spacearm_ident.canbus.eds import eds_path
from spacearm_ident.errors import LONGEST, UserError
from spacearm_ident.report.pages import environment
from spacearm_ident.simulation.drives.drive import DriveConfig, SimulatedDrive

# --- the bus ------------------------------------------------------------------------------------------------

FRAMES = st.builds(
    lambda can_id, data, fd, remote, error: can.Message(
        arbitration_id=can_id,
        data=None if remote else data,
        is_extended_id=can_id > 0x7FF,
        is_fd=fd,
        is_remote_frame=remote and not fd,
        is_error_frame=error,
        dlc=len(data) if remote else None,
    ),
    st.sampled_from([0x000, 0x080, 0x081, 0x181, 0x182, 0x281, 0x301, 0x581, 0x601, 0x701, 0x77F, 0x7FF, 0x1FFFFFFF]),
    st.binary(max_size=8),
    st.just(False),
    st.booleans(),
    st.booleans(),
)


class Played:
    """A bus that delivers the given frames, oldest first, and keeps what is sent."""

    def __init__(self, messages):
        self.messages, self.sent = list(messages), []

    def recv(self, timeout=None):
        return self.messages.pop(0) if self.messages else None

    def send(self, message, timeout=None):
        self.sent.append(message)

    def shutdown(self):
        pass


@EXAMPLES
@given(received=st.lists(FRAMES, max_size=30), slim=st.booleans())
def test_no_frame_ends_the_cycle(received, slim):
    arm = ArmBus((Axis(1, SCALE), Axis(2, SCALE)), answer_time=0.0001)
    bus = Played(received)
    network = canopen.Network(bus)
    for axis in arm.axes:
        network.add_node(axis.node_id, DICTIONARY)
    cycle = Cycle(arm, [bus], [network])
    for _ in range(3):
        cycle.run()
    assert cycle.cycles == 3 and len(cycle.events) <= 40 and np.isfinite(cycle.feedback.position).all()


@EXAMPLES
@given(raw=st.binary(max_size=100) | st.binary(min_size=frames.CLASSIC.size, max_size=frames.CLASSIC.size))
def test_no_bytes_on_the_local_bus_raise_anything_but_what_its_reader_expects(raw):
    try:
        message, _ = frames.unpack(raw, "x")
    except struct.error:
        assert len(raw) not in (frames.CLASSIC.size, frames.FD.size)
    else:
        assert len(message.data) <= 64


EDS = str(eds_path())
DICTIONARY = canopen.import_od(EDS)


class Answering(Played):
    """A drive that answers every SDO request with the next of the given answers, for ever."""

    def __init__(self, network, answers):
        super().__init__([])
        self.network, self.answers, self.asked = network, answers, 0

    def send(self, message, timeout=None):
        if message.arbitration_id == 0x601:
            self.asked += 1
            assert self.asked < 3000, "the master asks for ever"
            self.network.notify(0x581, bytearray(self.answers[self.asked % len(self.answers)]), 0.0)


def configured(answers):
    """What the master makes of a drive with these answers, and how often it asked."""
    arm = ArmBus((Axis(1, SCALE),))
    idle = Played([])
    booted = master.DriveMaster(arm, [idle], EDS)
    network = booted.networks[0]
    bus = network.bus = Answering(network, answers)
    booted.nodes[0].sdo.RESPONSE_TIMEOUT = 0.001
    return ends_well(lambda: set_up(booted)), bus.asked


def set_up(booted):
    """What `boot` asks of one drive that is without power."""
    booted._identify(booted.arm.axes[0], booted.nodes[0])
    booted._configure(0)
    booted.prepare(0)
    booted.error(0)


@FEW
@given(
    st.lists(
        st.builds(
            lambda command, index, sub, data: struct.pack("<BHB", command, index, sub) + data,
            st.integers(0, 255) | st.sampled_from([0x43, 0x4F, 0x60, 0x80, 0x41, 0x00, 0x10, 0x20, 0x30]),
            st.sampled_from([0x1000, 0x1400, 0x1800, 0x1A00, 0x6060]),
            st.integers(0, 4),
            st.binary(min_size=4, max_size=4),
        ),
        min_size=1,
        max_size=8,
    )
)
def test_no_answers_of_a_drive_hang_or_crash_its_configuration(answers):
    configured(answers)


def test_a_drive_that_never_ends_an_object_is_cut_off():
    begin = struct.pack("<BHBI", 0x41, 0x1000, 0, 2**31)  # segmented, two gigabytes announced
    segments = [bytes([0x10 * (k % 2)]) + b"x" * 7 for k in range(2)]
    _, asked = configured([segments[1], begin, segments[0]])  # the first request gets the second
    assert asked < 10


class Endless(Answering):
    """Answers the first request with a segmented transfer, and every segment with another."""

    def send(self, message, timeout=None):
        if message.arbitration_id != 0x601:
            return
        self.asked += 1
        assert self.asked < 1000, "the master asks for ever"
        command = message.data[0]
        if command == 0x80:
            return
        answer = struct.pack("<BHBI", 0x41, 0x1000, 0, 2**31) if command == 0x40 else bytes([command & 0x10]) + b"x" * 7
        self.network.notify(0x581, bytearray(answer), 0.0)


def test_a_drive_that_sends_segments_for_ever_is_refused():
    arm = ArmBus((Axis(1, SCALE),))
    booted = master.DriveMaster(arm, [Played([])], EDS)
    bus = booted.networks[0].bus = Endless(booted.networks[0], [])
    with pytest.raises(UserError, match=r"node 1 cannot be configured: 0x1000 is longer than 8 bytes"):
        set_up(booted)
    assert bus.asked < 10


@FEW
@given(st.lists(st.binary(min_size=8, max_size=8) | st.binary(max_size=9), max_size=12), st.lists(FRAMES, max_size=10))
def test_no_request_crashes_a_simulated_drive(requests, others):
    drive = SimulatedDrive(DriveConfig(1, SCALE), lambda can_id, data: None)
    drive.reset()
    for message in [*others, *(can.Message(arbitration_id=0x601, data=data[:8]) for data in requests)]:
        for can_id, route in drive.routes().items():
            if can_id == message.arbitration_id and not message.is_remote_frame:
                route(message)
    drive.on_sync()
    drive.after_sync()
    drive.advance(0.001, 0.001)


# --- what is printed ----------------------------------------------------------------------------------------


class Tags(HTMLParser):
    def __init__(self, text):
        super().__init__()
        self.tags, self.words = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_data(self, data):
        self.words.append(data)


PLAIN = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0\r"), max_size=40)


TEMPLATE = environment().from_string('<p title="{{ attribute }}">{{ text }}<b>{{ text|breakable }}</b></p>')


@EXAMPLES
@given(text=PLAIN, attribute=PLAIN)
def test_no_text_becomes_markup(text, attribute):
    page = Tags(TEMPLATE.render(text=text, attribute=attribute))
    assert [tag for tag in page.tags if tag[0] != "wbr"] == [("p", {"title": attribute}), ("b", {})]
    assert "".join(page.words) == text + text


def test_an_error_is_one_printable_line_of_bounded_length():
    text = str(UserError("joint '\x1b[2J\n\t' " + "x" * 100_000 + " mend it"))
    assert text.isprintable() and len(text) <= LONGEST + 10
    assert text.startswith("joint '") and text.endswith("mend it")
