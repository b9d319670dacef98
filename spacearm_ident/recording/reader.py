"""`read_recording`: from a bag to a `Recording`, with an account of everything that was left out.

What counts as sound (contracts.md §1):

* Time is `header.stamp`. Where the stamps carry no time (all equal) the log time stands in, and says so.
* Stamps must increase. The fewest samples are dropped that make them increase (a longest increasing
  subsequence), so that one stamp far ahead costs one sample and not all behind it. Nothing is sorted.
* A sample is used when its message names all joints and gives each a finite position and effort.
* Velocity is optional, everything here can do without: it is given for all samples or not at all. Where at
  most 1 % of the samples lack a finite velocity those samples are dropped, otherwise the velocity is.
* Positions that go to and fro between two courses come from two sources; nothing is dropped for it (`interleaved`).
* An interval is a gap when it exceeds both 5 times the median interval and twice its 95th percentile (uneven
  sampling is no gap).
* Topics are those of one arm, with or without a namespace: see `namespace`.
* Where a sensor on the base is recorded, joint states without it are of no use: see `base_intake`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from spacearm_ident.arrays import FloatArray, IntArray
from spacearm_ident.errors import UserError
from spacearm_ident.recording import cdr, messages
from spacearm_ident.recording.base_intake import read_base
from spacearm_ident.recording.contents import Bag
from spacearm_ident.recording.intake import Finding, Intake, Samples, gap_threshold_s, increasing, listing
from spacearm_ident.recording.interleaved import TWO_SOURCES, steps_back
from spacearm_ident.recording.mcap_reader import Defect, Progress
from spacearm_ident.recording.namespace import read_arm
from spacearm_ident.recording.recording import TEMPERATURE_UNIT, Issue, Recording, Series, Source


def _read_states(bag: Bag, path: str, joints: Sequence[str] | None, preferred: Sequence[str]) -> tuple[Intake, bool]:
    """The joint states, sound and in order of time, and whether their velocities can be used."""
    stream = bag.streams.get(messages.STATES_TOPIC)
    if stream is None:
        there = listing([f"{topic} ({kind or 'no type'})" for topic, kind in sorted(bag.topics.items())])
        damage = "".join(f"; {defect.text}" for defect in bag.defects[:2])
        named = listing([topic for topic, kind in sorted(bag.topics.items()) if kind == messages.JOINT_STATE.name])
        otherwise = f", or say which is the arm's with --topic ({named})" if named else ""
        raise UserError(
            f"{path}: no {messages.STATES_TOPIC} of type {messages.JOINT_STATE.name}; "
            f"record that topic{otherwise} (found: {there or 'nothing'}{damage})"
        )
    intake = Intake.of_stream(messages.STATES_TOPIC, stream, joints, use_log_time=False, preferred=preferred)
    unknown = [name for name in joints or () if name not in intake.known]
    if unknown:
        raise UserError(f"{path}: no joint {listing(unknown)}; the recording has {listing(intake.known)}")
    return intake, _settle(intake, path, joints is not None, [defect.text for defect in bag.defects])


def _settle(intake: Intake, path: str, chosen: bool, damage: Sequence[str]) -> bool:
    """Drop what is not sound of joint states; returns whether their velocities can be used.

    Args:
        intake: The joint states.
        path: Where they come from, for errors.
        chosen: Whether the user named the joints.
        damage: What was found wrong before, for errors.

    Raises:
        UserError: Fewer than two samples are left, or the joints that the user named have no data.
    """
    intake.drop_joints_without_effort(chosen=chosen)
    intake.drop_not_finite(effort=True)
    has_velocity = intake.settle_velocity()
    samples = intake.samples
    if back := steps_back(samples.position):
        text = f"in {back} of {len(samples.position)} samples the joints are back where they were before the last one"
        intake.note(TWO_SOURCES, f"{text}: two sources give the joint states by turns", back)
    intake.put_in_time()
    if len(intake.samples.stamp_ns) < 2:
        reasons = "; ".join([*damage, *(finding.message for finding in intake.findings)])
        raise UserError(f"{path}: fewer than two usable joint states ({reasons or 'too short'}); record again")
    return has_velocity


def _read_command(bag: Bag, states: Intake) -> tuple[Series | None, list[Finding]]:
    """Set-points of a bag, on the clock of the states."""
    stream = bag.streams.get(messages.COMMAND_TOPIC)
    if stream is None:
        return None, []
    return _command(Intake.of_stream(messages.COMMAND_TOPIC, stream, states.samples.joints, states.on_log_time), states)


def _command(intake: Intake, states: Intake) -> tuple[Series | None, list[Finding]]:
    """Set-points of the states' joints on their own clock."""
    intake.drop_not_finite(effort=False)
    intake.put_in_time()
    samples = intake.samples
    if len(samples.stamp_ns) == 0:
        return None, intake.findings
    return Series(_seconds(samples.stamp_ns, states.samples.stamp_ns[0]), samples.position), intake.findings


def _read_temperatures(bag: Bag, states: Intake) -> tuple[dict[str, Series], list[Finding]]:
    """Temperatures by joint, °C, finite, possible and in order of time."""
    stream = bag.streams.get(messages.TEMPERATURES_TOPIC)
    if stream is None:
        return {}, []
    stamps, rows = states.decoded(stream, cdr.decode_temperature)
    places: dict[str, list[int]] = {}
    for place, (_, name, _) in enumerate(rows):
        places.setdefault(name, []).append(place)
    values = np.array([value for _, _, value in rows], dtype=np.float64)
    result, kept = {}, 0
    finite = np.isfinite(values)
    impossible = finite & ((values < messages.TEMPERATURES_C[0]) | (values > messages.TEMPERATURES_C[1]))
    for name, of_name in places.items():
        mine = np.array(of_name)
        mine = mine[finite[mine] & ~impossible[mine]]
        mine = mine[increasing(stamps[mine])]
        kept += len(mine)
        if len(mine):
            result[name] = Series(_seconds(stamps[mine], states.samples.stamp_ns[0]), values[mine])
    findings = []
    if beyond := int(impossible.sum()):
        names = listing([name for name, of_name in places.items() if impossible[of_name].any()])
        least, most = messages.TEMPERATURES_C
        text = (
            f"{messages.TEMPERATURES_TOPIC}: {beyond} of {len(values)} readings left out, of {names}, from "
            f"{values[impossible].min():.5g} to {values[impossible].max():.5g}: the unit is °C, and no joint is below "
            f"{least:g} or above {most:g} °C (kelvin, or tenths of a degree?)"
        )
        findings.append(Finding(TEMPERATURE_UNIT, text, beyond))
    if lost := len(stream.payloads) - kept - beyond:
        text = f"{messages.TEMPERATURES_TOPIC}: {lost} unreadable, not finite or untimely messages left out"
        findings.append(Finding("temperature", text, lost))
    return result, findings


def _read_description(bag: Bag) -> tuple[str | None, list[Finding]]:
    stream = bag.streams.get(messages.DESCRIPTION_TOPIC)
    lost = 0
    for payload in stream.payloads if stream else ():
        try:
            if text := cdr.decode_string(payload):
                return text, []
        except cdr.CdrError:
            lost += 1
    text = f"{messages.DESCRIPTION_TOPIC}: cannot be decoded, left out"
    return None, [Finding("undecodable_message", text, lost)] if lost else []


def _seconds(stamps_ns: IntArray, start_ns: int | np.int64) -> FloatArray:
    """(N,) s since the start, by a difference of integers: a float64 resolves epoch nanoseconds to 256 ns only."""
    return (stamps_ns - start_ns) / 1e9


def _split(time: FloatArray, seams: IntArray) -> tuple[tuple[slice, ...], list[Issue]]:
    """Segments without a gap or seam inside, and the issue that reports the gaps."""
    steps = np.diff(time)
    threshold = gap_threshold_s(time)
    breaks = np.flatnonzero(steps > threshold)
    edges = [0, *np.union1d(breaks + 1, seams).tolist(), len(time)]
    segments = tuple(slice(start, stop) for start, stop in pairwise(edges))
    if len(breaks) == 0:
        return segments, []
    longest = breaks[np.argmax(steps[breaks])]
    text = (
        f"{len(breaks)} {'gaps' if len(breaks) > 1 else 'gap'} longer than {threshold * 1e3:.3g} ms, "
        f"the longest {steps[longest]:.3g} s at {time[longest]:.3f} s; the runs between are used as pieces"
    )
    return segments, [Issue("gap", text, len(breaks), float(time[breaks[0]]))]


def _bag_findings(bag: Bag, shift_ns: int) -> list[Finding]:
    """Damage to the files, one finding a kind."""
    by_kind: dict[str, list[Defect]] = {}
    for defect in bag.defects:
        by_kind.setdefault(defect.kind, []).append(defect)
    findings = []
    for kind, defects in by_kind.items():
        first = defects[0]
        text = first.text if len(defects) == 1 else f"{len(defects)} places, the first: {first.text}"
        stamp = None if first.log_time_ns is None else first.log_time_ns + shift_ns
        findings.append(Finding(kind, text, sum(defect.count for defect in defects), stamp))
    return findings


def read_recording(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    preferred: Sequence[str] = (),
    namespace: str | None = None,
    progress: Progress | None = None,
) -> Recording:
    """Read a bag into arrays.

    Args:
        path: MCAP file or rosbag2 folder.
        joints: The joints wanted, in that order; None takes those of the messages that carry most data, less
            any that never have an effort.
        preferred: With `joints` None, joints of the arm meant: where several arms publish on one topic, the messages
            with most of these are taken.
        namespace: Of the arm to read, such as `arm_1`; `/` is none; or the full name of its topic of joint states.
            None: the arm without a namespace, or the only one there is.
        progress: Called with the fraction done, 0 to 1.

    Returns:
        What is sound in the bag; `issues` says what was left out. See the module's docstring for the rules.

    Raises:
        UserError: No such bag, not readable, or without usable joint states of the wanted joints; or there are several
            arms in namespaces, and none was asked for.
    """
    bag, others = read_arm(str(path), namespace, progress)
    states, has_velocity = _read_states(bag, str(path), joints, preferred)
    command, command_findings = _read_command(bag, states)
    temperatures, temperature_findings = _read_temperatures(bag, states)
    base, base_findings = read_base(bag, states)
    urdf, description_findings = _read_description(bag)
    findings = [
        *_bag_findings(bag, states.clock_shift_ns),
        *others,
        *states.findings,
        *command_findings,
        *temperature_findings,
        *base_findings,
        *description_findings,
    ]
    recording = _assembled(states, has_velocity, command, findings, tuple(bag.sources), urdf)
    return replace(recording, temperatures=temperatures, base=base)


def _assembled(
    states: Intake,
    has_velocity: bool,
    command: Series | None,
    findings: Sequence[Finding],
    sources: tuple[Source, ...],
    urdf: str | None,
) -> Recording:
    """A recording of sound joint states, cut where they have gaps."""
    samples = states.samples
    start_ns = int(samples.stamp_ns[0])
    time = _seconds(samples.stamp_ns, start_ns)
    segments, gaps = _split(time, states.seams)
    return Recording(
        joints=samples.joints,
        time=time,
        position=samples.position,
        velocity=samples.velocity if has_velocity else None,
        effort=samples.effort,
        segments=segments,
        start_ns=start_ns,
        command=command,
        urdf=urdf,
        effortless=states.effortless,
        issues=(*(finding.as_issue(start_ns) for finding in findings), *gaps),
        sources=sources,
    )


def recording_of(
    samples: Samples,
    command: Samples | None,
    sources: tuple[Source, ...],
    urdf: str | None = None,
    issues: Sequence[Issue] = (),
) -> Recording:
    """A recording of rows that come from no bag, by the rules of one.

    Args:
        samples: (N, n) joint states; NaN where there is no value.
        command: Set-points of the same joints, where there are any.
        sources: The files behind them.
        urdf: Text of the arm's URDF.
        issues: What was found before.

    Raises:
        UserError: Fewer than two usable rows.
    """
    states = Intake("", samples)
    has_velocity = _settle(states, sources[0].path, False, [])
    set_points: Series | None = None
    findings: list[Finding] = []
    if command is not None:
        kept = command.columns(np.isin(command.joints, states.samples.joints))
        set_points, findings = _command(Intake("set-points: ", kept), states)
    recording = _assembled(states, has_velocity, set_points, (*states.findings, *findings), sources, urdf)
    return replace(recording, issues=(*issues, *recording.issues))


def describe(recording: Recording) -> list[str]:
    """What was found in a recording and what was dropped, a line each, for a person."""
    duration = float(recording.time[-1])
    lines = [f"{source.path} ({source.bytes / 1e6:.2f} MB)" for source in recording.sources]
    lines.append(
        f"{len(recording.time)} samples of {len(recording.joints)} joints ({listing(recording.joints)}), "
        f"{duration:.2f} s at {recording.rate_hz:.5g} Hz"
    )
    also = [
        name
        for name, present in (
            ("velocity", recording.velocity is not None),
            ("set-points", recording.command is not None),
            (f"temperatures of {len(recording.temperatures)} joints", bool(recording.temperatures)),
            (f"base motion on {recording.base.topic}" if recording.base else "", recording.base is not None),
            ("robot description", recording.urdf is not None),
        )
        if present
    ]
    lines.append(f"with {', '.join(also)}" if also else "without velocity, set-points, temperatures, description")
    for issue in recording.issues:
        place = "" if issue.where_s is None else f" (from {issue.where_s:.3f} s)"
        lines.append(f"{issue.kind}: {issue.message}{place}")
    return lines
