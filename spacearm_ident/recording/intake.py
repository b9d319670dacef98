"""Joint-state messages to sound samples: choose the clock, drop what cannot be used, keep the account of it.

The rules are those of `reader`; this module applies them to one topic.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Self, TypeVar

import numpy as np

from spacearm_ident.arrays import BoolArray, FloatArray, IntArray
from spacearm_ident.errors import UserError
from spacearm_ident.recording import cdr, messages
from spacearm_ident.recording.contents import Stream
from spacearm_ident.recording.recording import Issue

_VELOCITY_LOSS = 0.01  # share of samples without velocity above which velocity is given up, not the samples
EPOCH_NS = 10**17
"""Stamp, ns, from which a clock says the date (3 March 1973): below, it counts from its start, as a simulation's or one
that nobody has set. A stamp of zero among such that say the date is an unset one."""

GAP_MEDIANS = 5.0
"""How many median intervals make a gap."""
_LATEST_NS = 2**62
_Row = TypeVar("_Row", bound=tuple[Any, ...])


@dataclass(frozen=True)
class Finding:
    """An issue whose place is still a stamp, in ns of the recording's clock."""

    kind: str
    message: str
    count: int
    stamp_ns: int | None = None

    def as_issue(self, start_ns: int) -> Issue:
        """The issue of a recording that starts at `start_ns`."""
        where = None if self.stamp_ns is None else max(0.0, (self.stamp_ns - start_ns) / 1e9)
        return Issue(self.kind, self.message, self.count, where)


@dataclass(frozen=True)
class Samples:
    """Messages as rows in recorded order, `joints` as columns. NaN where a message has no value."""

    joints: tuple[str, ...]
    stamp_ns: IntArray
    position: FloatArray
    velocity: FloatArray
    effort: FloatArray

    def rows(self, keep: BoolArray) -> Samples:
        """The messages to keep."""
        if keep.all():
            return self
        arrays = (self.position, self.velocity, self.effort)
        return Samples(self.joints, self.stamp_ns[keep], *(array[keep] for array in arrays))

    def columns(self, keep: BoolArray) -> Samples:
        """The joints to keep."""
        joints = tuple(joint for joint, kept in zip(self.joints, keep, strict=True) if kept)
        arrays = (self.position, self.velocity, self.effort)
        return Samples(joints, self.stamp_ns, *(array[:, keep] for array in arrays))


def increasing(stamps: IntArray) -> BoolArray:
    """Mask of a longest strictly increasing subsequence; of equal stamps the first is kept.

    Patience sorting (Fredman 1975), O(N log N); all True at once where the stamps increase already.
    """
    keep = np.ones(len(stamps), dtype=bool)
    if bool((np.diff(stamps) > 0).all()):
        return keep
    tails: list[int] = []  # smallest last stamp of an increasing run of each length
    tail_rows: list[int] = []
    before = np.full(len(stamps), -1, dtype=np.int64)
    for row, stamp in enumerate(stamps.tolist()):
        length = bisect_left(tails, stamp)
        if length < len(tails) and tails[length] == stamp:
            before[row] = -2  # a repetition never replaces the first
            continue
        before[row] = tail_rows[length - 1] if length else -1
        tails[length : length + 1] = [stamp]
        tail_rows[length : length + 1] = [row]
    keep[:] = False
    row = tail_rows[-1]
    while row >= 0:
        keep[row] = True
        row = int(before[row])
    return keep


def listing(names: Sequence[str], most: int = 8) -> str:
    """Names for a person, the first `most` of them.

    Args:
        names: Joints, columns or topics.
        most: Names beyond so many are replaced by "...".
    """
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


def int64_ns(times_ns: Sequence[int]) -> IntArray:
    """Log times are unsigned on disk; one past the year 2116 is damage, and becomes zero here.

    So no difference of two times, stamps of 32-bit seconds among them, leaves 64 bits.
    """
    times = np.array(times_ns, dtype=np.uint64)
    return np.where(times < _LATEST_NS, times, 0).astype(np.int64)


def gap_threshold_s(time: FloatArray) -> float:
    """Interval above which a gap is declared, seconds (inf for fewer than three samples)."""
    steps = np.diff(time)
    if len(steps) < 2:
        return float("inf")
    return float(max(GAP_MEDIANS * np.median(steps), 2.0 * np.percentile(steps, 95)))


def _main_joints(blocks: Sequence[cdr.JointStateBlock], preferred: Sequence[str] = ()) -> tuple[str, ...]:
    """The joints of the messages with most of `preferred`, then most data, in the order of the first such message."""
    weight: Counter[frozenset[str]] = Counter()
    order: dict[frozenset[str], tuple[int, tuple[str, ...]]] = {}
    for block in blocks:
        names = frozenset(block.names)
        weight[names] += len(block.rows) * len(names)
        first = (int(block.rows[0]), tuple(dict.fromkeys(block.names)))
        order[names] = min(order.get(names, first), first)
    wanted = set(preferred)
    return order[max(weight, key=lambda names: (len(names & wanted), weight[names], len(names)))][1] if weight else ()


def _carries_no_time(stamps: IntArray) -> bool:
    return bool((stamps == stamps[0]).all()) and (len(stamps) > 1 or stamps[0] == 0)


def _counts_backwards(stamps: IntArray) -> bool:
    """Whether most stamps are earlier than the one before."""
    return len(stamps) > 2 and bool(np.mean(np.diff(stamps) < 0) > 0.5)


def _gather(
    stamps: IntArray, blocks: Sequence[cdr.JointStateBlock], joints: tuple[str, ...]
) -> tuple[Samples, BoolArray]:
    """Columns of `joints` from the messages that name them all, and which messages (N,) those are.

    The others get no row: one message of a million joints among a million of one joint would be a table of 10¹².
    """
    wanted = set(joints)
    whole = [block for block in blocks if joints and wanted.issubset(block.names)]
    named = np.zeros(len(stamps), dtype=bool)
    for block in whole:
        named[block.rows] = True
    row_of = np.cumsum(named) - 1
    position, velocity, effort = (np.full((int(named.sum()), len(joints)), np.nan) for _ in range(3))
    for block in whole:
        # Of a name that is there twice the first counts.
        place = {name: number for number, name in reversed(list(enumerate(block.names)))}
        columns = [place[joint] for joint in joints]
        for target, values in ((position, block.position), (velocity, block.velocity), (effort, block.effort)):
            if values is not None:
                target[row_of[block.rows]] = values[:, columns]
    return Samples(joints, stamps[named], position, velocity, effort), named


class Intake:
    """Rows of joint states, of a topic or of a log, on their way to sound samples, and the account of what was dropped.

    Attributes:
        samples: What is left.
        findings: What was left out and why.
        effortless: Lowest and highest position, rad, of the joints left out since they have no effort.
        seams: Samples that do not continue the one before, whatever their stamps say.
        clock_shift_ns: Median of stamp minus log time: from the recorder's clock to that of the stamps.
    """

    def __init__(self, label: str, samples: Samples, *, on_log_time: bool = False, clock_shift_ns: int = 0) -> None:
        self.findings: list[Finding] = []
        self.effortless: dict[str, tuple[float, float]] = {}
        self.seams: IntArray = np.zeros(0, dtype=np.int64)
        self._label = label
        self._topic = messages.STATES_TOPIC
        self.samples = samples
        self.known = sorted(samples.joints)
        self.on_log_time = on_log_time
        self.clock_shift_ns = clock_shift_ns

    def decoded(self, stream: Stream, decode: Callable[[bytes], _Row]) -> tuple[IntArray, list[_Row]]:
        """Stamps (K,) on the clock of the states, and messages of another topic: those that can be decoded."""
        rows, logs = [], []
        for payload, log_time in zip(stream.payloads, stream.log_times_ns, strict=True):
            with suppress(cdr.CdrError):
                rows.append(decode(payload))
                logs.append(log_time)
        stamps = np.array([stamp for stamp, *_ in rows], dtype=np.int64)
        return int64_ns(logs) if self.on_log_time or not stamps.any() else stamps, rows

    @classmethod
    def of_stream(
        cls,
        topic: str,
        stream: Stream,
        joints: Sequence[str] | None,
        use_log_time: bool,
        preferred: Sequence[str] = (),
    ) -> Self:
        """The messages of a topic.

        Args:
            topic: Its name.
            stream: What a bag holds of it.
            joints: The joints wanted; None: those of the messages that carry most data.
            use_log_time: Whether the header stamps are not to be used.
            preferred: Joints that are meant where messages of several arms are mixed.
        """
        notes: list[tuple[str, str, int]] = []
        commanded = topic == messages.COMMAND_TOPIC
        blocks, bad = cdr.decode_joint_states(stream.payloads, stream.channel.type_name, commanded=commanded)
        decoded = np.ones(len(stream.payloads), dtype=bool)
        decoded[bad] = False
        stamps = np.zeros(len(decoded), dtype=np.int64)
        for block in blocks:
            stamps[block.rows] = block.stamp_ns
        log_times = int64_ns(stream.log_times_ns)
        constant = bool(decoded.any()) and _carries_no_time(stamps[decoded])
        if constant:
            text = f"the {decoded.sum()} header stamps carry no time; the time of recording is used"
            notes.append(("log_time_used", text, int(decoded.sum())))
        backward = not constant and bool(decoded.any()) and _counts_backwards(stamps[decoded])
        if backward:
            text = "the header stamps count backwards; the order of recording is kept"
            notes.append(("backward_clock", text, len(stamps)))
        on_log_time = constant or use_log_time
        if backward:
            stamps = log_times if not _counts_backwards(log_times) else stamps.max() + stamps.min() - stamps
        elif on_log_time:
            stamps = log_times
        elif bad and decoded.any():  # a place for the report: the stamp of the nearest message before
            before = np.maximum.accumulate(np.where(decoded, np.arange(len(decoded)), np.argmax(decoded)))
            stamps = stamps[before]
        shift_ns = int(np.median((stamps - log_times)[decoded])) if decoded.any() else 0
        samples, named = _gather(stamps, blocks, tuple(_main_joints(blocks, preferred) if joints is None else joints))
        label = "" if topic == messages.STATES_TOPIC else f"{topic}: "
        intake = cls(label, samples, on_log_time=on_log_time, clock_shift_ns=shift_ns)
        intake._topic = stream.channel.topic
        for note in notes:
            intake.note(*note)
        intake.known = sorted({name for block in blocks for name in block.names})
        intake._left_out(stamps[~decoded], "undecodable_message", "messages left out that cannot be decoded")
        text = f"messages without all of {listing(samples.joints)} left out"
        intake._left_out(stamps[decoded & ~named], "missing_joint", text)
        return intake

    def note(self, kind: str, message: str, count: int = 1, stamp_ns: int | None = None) -> None:
        """Add a finding to `findings`.

        Args:
            kind: Short identifier of the defect, such as `nan`.
            message: One line for a person; the label of the topic is put before it.
            count: How many messages or samples are concerned.
            stamp_ns: Stamp of the first of them, ns; None: of no particular moment.
        """
        self.findings.append(Finding(kind, self._label + message, count, stamp_ns))

    def drop(self, bad: BoolArray, kind: str, message: str) -> None:
        """Drop samples and note how many.

        Args:
            bad: (N,) true where a sample of `samples` is dropped.
            kind: Short identifier of the defect, such as `nan`.
            message: What is dropped and why; begins with a plural noun ("samples ..."), before which the count is put.
        """
        if bad.any():
            self._left_out(self.samples.stamp_ns[bad], kind, message)
            self.samples = self.samples.rows(~bad)

    def _left_out(self, stamps_ns: IntArray, kind: str, message: str) -> None:
        if count := len(stamps_ns):
            what, rest = message.split(" ", 1)
            text = f"{count} {what if count > 1 else what.removesuffix('s')} {rest}"
            self.note(kind, text, count, int(stamps_ns[0]))

    def drop_joints_without_effort(self, chosen: bool) -> None:
        """Leave out joints that never have position and effort, unless the user chose them.

        Raises:
            UserError: No joint has them, or not one the user chose.
        """
        samples = self.samples
        if len(samples.stamp_ns) == 0:
            return
        for what, values in (("position", samples.position), ("effort", samples.effort)):
            present = np.asarray(np.isfinite(values).any(axis=0))
            if present.all():
                continue
            lacking = listing([name for name, has in zip(samples.joints, present, strict=True) if not has])
            if chosen or not present.any():
                raise UserError(f"{self._topic} has no {what} for {lacking}; record it, or choose other joints")
            self.note(f"joint_without_{what}", f"{lacking} left out: no {what} in any message")
            if what == "effort":
                for k in np.flatnonzero(~present):
                    own = samples.position[np.isfinite(samples.position[:, k]), k]
                    self.effortless[samples.joints[k]] = float(own.min()), float(own.max())
            samples = self.samples.columns(present)
            self.samples = samples
            return self.drop_joints_without_effort(chosen)

    def drop_not_finite(self, *, effort: bool) -> None:
        """Drop samples without a finite position (and effort) of every joint."""
        samples = self.samples
        lacking = ~np.isfinite(samples.position)
        if effort:
            lacking |= ~np.isfinite(samples.effort)
        names = [name for name, column in zip(samples.joints, lacking.T, strict=True) if column.any()]
        text = f"samples with NaN, infinite or absent values ({listing(names)}) left out"
        self.drop(np.asarray(lacking.any(axis=1)), "nan", text)

    def put_in_time(self) -> None:
        """Drop unset, repeated and backward stamps until the stamps increase strictly."""
        stamps = self.samples.stamp_ns
        if len(stamps) and np.median(stamps) > EPOCH_NS:
            self.drop(stamps == 0, "zero_stamp", "samples without a stamp (zero) left out")
        stamps = self.samples.stamp_ns
        keep = increasing(stamps)
        repeated = ~keep & np.concatenate(([False], stamps[1:] == stamps[:-1]))
        late = ~keep & ~repeated
        # One wrong stamp is one sample lost; several in a row are a clock set back, and what was sampled
        # before and after it does not belong together although its stamps would.
        self.seams = np.flatnonzero(np.diff(np.cumsum(late)[keep]) > 1) + 1
        text = "samples with the stamp of the one before left out"
        if self.on_log_time:
            # Under simulated time a recorder stamps by the last tick of /clock, which may be slower than the states.
            text = "samples with the time of recording of the one before left out (a recorder with use_sim_time?)"
        self.drop(repeated, "repeated_stamp", text)
        text = "samples with stamps out of order (a clock set back?) left out"
        self.drop(late[~repeated], "backward_stamp", text)

    def settle_velocity(self) -> bool:
        """Whether the velocities can be used; if so, the few samples without one are dropped."""
        finite = np.isfinite(self.samples.velocity)
        if not finite.any():
            return False
        lacking = np.asarray(~finite.all(axis=1))
        if lacking.mean() > _VELOCITY_LOSS:
            count, stamp = int(lacking.sum()), int(self.samples.stamp_ns[np.argmax(lacking)])
            text = f"recorded velocity not used: {count} of {len(lacking)} samples lack a finite one"
            self.note("velocity_unusable", text, count, stamp)
            return False
        self.drop(lacking, "nan", "samples with NaN, infinite or absent velocity left out")
        return True
