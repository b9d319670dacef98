"""`spacearm mismatch`: say what physics was left out."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..errors import UserError
from ..layers.comparison import Comparison
from ..layers.document import comparison_document, verdict
from ..layers.item import REST, Item, Mended
from ..mismatch.document import EXTENDED_MODEL, NEXT_RUN, to_document
from ..mismatch.finding import DATA_UNFIT, NO_MISMATCH, Explanation, Finding
from ..mismatch.rivals import UNKNOWN
from ..sessions.identification import locked_words
from ..sessions.mismatch import explain_session
from ..sessions.reading import Comparing
from ..sessions.simulation import compare_session, written_by_simulator
from . import common

DESCRIPTION = """
Compare recordings of an arm with its reference, and explain the difference: at which joint, which physics, how large;
with a model that includes it, validated on held-out recordings. The reference is a recording of the healthy arm, or a
model.yaml; without one, the arm's own fit is the base, and the residual of its structure is explained.

With --simulation the arm is compared with a simulation of it (MJCF, URDF, SDF, model.yaml, or a bag that a simulator
wrote), layer by layer: conventions and wiring, wrong parameters, physics that the simulation lacks, and the rest; with
a corrected file of the simulation.
"""
FILES = (
    ("--reference", "BAG|MODEL", "recordings of the healthy arm, or one model.yaml"),
    (
        "--simulation",
        "SIM",
        "a simulation to compare with: MJCF, URDF (then also the arm of logs, without --arm), SDF, model.yaml, "
        "or bags that a simulator wrote",
    ),
    (
        "--validate",
        "BAG",
        "recordings to validate on; default: the last third of the motion in each BAG is held out",
    ),
)


def add(command: argparse.ArgumentParser) -> None:
    """Add the command's options to its parser."""
    command.description = DESCRIPTION
    command.add_argument("bags", nargs="*", type=Path, metavar="BAG", help="recordings to explain")
    for name, metavar, what in FILES:
        common.add_files_option(command, name, what, metavar=metavar, action="append")
    common.add_arm_options(command)
    common.add_base_option(command)
    common.add_namespace_option(command)
    common.add_mapping_option(command)
    command.add_argument("--out", required=True, type=Path, metavar="DIR", help="where to")
    command.add_argument("--without", nargs="+", default=[], metavar="EFFECT", help="effects to leave out")
    common.add_output_options(command)
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Read, explain, write."""
    if options.simulation:
        return _simulation(options)
    bags, references, judges = sort_bags(options.bags, options.reference, options.validate)
    if written_by_simulator(references, common.reading_of(options)):
        common.note(options, "the torque of the reference is free of noise: treated as a simulation (--simulation)")
        options.bags, options.reference, options.validate = bags, [], [judges] if judges else []
        options.simulation = [references]
        return _simulation(options)
    with common.progress(options) as report:
        session = explain_session(
            bags,
            references,
            judges,
            options.out,
            _comparing(options),
            command=options.command_line,
            progress=report,
        )
    if options.json:
        print(json.dumps(to_document(session.explanation), indent=2, allow_nan=False))
    else:
        print(summary(session.explanation, session.page, session.arm.effort_unit))
    for line in locked_words(session.arm):
        common.note(options, line)
    common.note_findings(options, session.recordings)
    return 1 if session.explanation.verdict == DATA_UNFIT else 0


def _comparing(options: argparse.Namespace) -> Comparing:
    """How the recordings are compared."""
    gravity = None if options.gravity is None else tuple(options.gravity)
    return Comparing(common.reading_of(options), gravity, tuple(options.without))


def _simulation(options: argparse.Namespace) -> int:
    """Compare with a simulation."""
    if options.reference:
        raise UserError("name --simulation or --reference (the healthy arm), not both")
    bags, simulation, judges = sort_bags(options.bags, options.simulation, options.validate)
    with common.progress(options) as report:
        session = compare_session(
            simulation,
            bags,
            judges,
            options.out,
            _comparing(options),
            command=options.command_line,
            progress=report,
        )
    comparison, mended = session.comparison, session.mended
    if options.json:
        document = comparison_document(comparison, session.simulation.source, mended)
        print(json.dumps(document, indent=2, allow_nan=False))
    else:
        print(comparison_summary(comparison, session.page, mended, session.simulation.arm.effort_unit))
    common.note_findings(options, session.recordings)
    return 0 if comparison.fit else 1


MOST_LINES = 6
"""Items of a layer on a terminal; the page has all of them."""
LEAST_SHARE = 0.001
"""Smallest share of the residual variance that is printed as a number; ratio."""
ITEM_WORDS = (
    "value in the simulation -> in the arm [95 % interval] (share of the simulation's residual variance that the item "
    "removes; replicated: found in the held-out recordings by themselves)"
)
RESIDUAL_WORDS = (
    "healthy: noise floor, of the reference where that is recorded; detectable: residual above which a joint counts as "
    "a mismatch; before, after: without and with the findings"
)
NOTHING_OF_IT = (
    "the held-out data have nothing of what was found: their residuals say nothing of it (mismatch.json has them)"
)
UNFIT_NEXT = "next: correct the recordings or their description as listed, then repeat the command"


def comparison_summary(comparison: Comparison, page: Path, mended: Mended | None, unit: str = "N m") -> str:
    """The result as text for a terminal: verdict, next step, layers and residuals.

    Args:
        comparison: The comparison; where its data are unfit, only the reasons are given.
        page: The HTML report written.
        mended: The simulation's file with corrected values, written beside `page`; None: there is none.
        unit: Unit of torque shown above the residuals.
    """
    if not comparison.fit:
        return "\n".join(
            ["data unfit", *(f"  {reason}" for reason in comparison.reasons), UNFIT_NEXT, f"report: {page}"]
        )
    lines = [f"{verdict(comparison).replace('_', ' ')}: {comparison.headline}"]
    if mended is not None:
        lines.append(f"next: {_next_step(comparison, page, mended)}")
        if mended.lost:
            lines.append(f"the simulation's format cannot hold: {', '.join(mended.lost)}")
    lines.append(f"report: {page}")
    for layer in comparison.layers:
        lines.append(f"{layer.name}{'' if layer.items else ': no significant difference'}")
        lines += [f"  {_item_line(layer.name, item)}" for item in layer.items[:MOST_LINES]]
        if len(layer.items) > MOST_LINES:
            lines.append(f"  and {len(layer.items) - MOST_LINES} more, see the report")
        lines += [f"  {note}" for note in layer.notes]
    if any(layer.items for layer in comparison.layers):
        lines.append(ITEM_WORDS)
    lines.append(f"residual RMS, {unit}, on {comparison.judged_on}")
    names = [layer.name for layer in comparison.layers[:3]]
    columns = (
        comparison.torque_Nm,
        comparison.before_Nm,
        *(layer.after_Nm for layer in comparison.layers[:3]),
        comparison.ceiling_Nm,
        comparison.mended_Nm,
    )
    heads = ("torque", "simulation", *names, "ceiling", "corrected")
    lines += _table(13, heads, comparison.joints, columns)
    if mended is not None and mended.closed_loop is not None:
        was, now = mended.closed_loop
        lines.append(f"closed loop in MuJoCo along the held-out motion: feedback RMS, {unit}; distance RMS, rad (m)")
        lines.append(
            f"{'joint':24}" + "".join(f"{head:>13}" for head in ("feedback", "corrected", "distance", "corrected"))
        )
        for joint in comparison.joints:
            feedback = [(run.feedback_Nm[joint], ".3f") for run in (was, now)]
            shown = [*feedback, *((run.position[joint], ".4f") for run in (was, now))]
            cells = (format(value, form) if math.isfinite(value) else "unstable" for value, form in shown)
            lines.append(f"{joint:24}" + "".join(f"{cell:>13}" for cell in cells))
    return "\n".join(lines)


def _table(width: int, heads: Sequence[str], joints: Sequence[str], columns: Sequence[FloatArray]) -> list[str]:
    """Torques by joint: a line of heads, a line a joint, all with as many places."""
    places = common.decimals(np.ravel(columns).tolist())
    return [
        f"{'joint':24}" + "".join(f"{head:>{width}}" for head in heads),
        *(
            f"{joint:24}" + "".join(f"{value:{width}.{places}f}" for value in values)
            for joint, *values in zip(joints, *columns)
        ),
    ]


def _next_step(comparison: Comparison, page: Path, mended: Mended) -> str:
    file = page.with_name(mended.name)
    if verdict(comparison) == NO_MISMATCH:
        return f"keep the simulation; {file} has the values that fit best, all of them within what the data can tell"
    if comparison.file_is_better:
        return f"use the corrected simulation, {file}, or look at {page}"
    return (
        f"look at {page}: the simulation's format cannot hold what differs, and {file} predicts no better than before"
    )


def _item_line(layer: str, item: Item) -> str:
    if layer == REST:
        return f"{', '.join(item.joints)}: {item.value:.3g}{_unit(item.unit)}; {item.where}"
    if not math.isfinite(item.value):
        return f"{item.name}: {item.where}"
    was = f"{item.was:.4g} -> " if math.isfinite(item.was) else ""
    replicated = {True: ", replicated", False: ", NOT replicated", None: ""}[item.replicated]
    value = f"{was}{item.value:.4g} [{item.low:.4g}, {item.high:.4g}]{_unit(item.unit)}"
    share = f"< {LEAST_SHARE:.1%}" if item.share < LEAST_SHARE else f"{item.share:.1%}"
    share = share if math.isfinite(item.share) else "share not known"
    place = "" if any(joint in item.where for joint in item.joints) else f" at {', '.join(item.joints)}"
    return f"{item.title}, {item.where}{place}: {value} ({share}{replicated})"


def sort_bags(
    bags: list[Path], reference: list[list[Path]], validate: list[list[Path]]
) -> tuple[list[Path], list[Path], list[Path]]:
    """Which file is what: bags to explain, the reference's, those to judge on.

    In `--reference R BAG ...` the option has taken the bags as well: where none is left, the first of its group is
    the reference and the others are what is to be explained.

    Args:
        bags: Bags named as arguments of the command, to be explained.
        reference: Bags of the healthy arm, one list for each `--reference`; may be shortened in place.
        validate: Held-out bags, one list for each `--validate`; may be shortened in place.

    Returns:
        Bags to explain, bags of the reference, and held-out bags.

    Raises:
        UserError: There is nothing to explain.
    """
    if not bags:
        for groups in (validate, reference):
            if groups and len(groups[-1]) > 1:
                bags, groups[-1] = groups[-1][1:], groups[-1][:1]
                break
        else:
            raise UserError("no bag to explain: name at least one, as in 'spacearm mismatch BAG --reference BAG'")
    return bags, [path for group in reference for path in group], [path for group in validate for path in group]


def summary(explanation: Explanation, page: Path, unit: str) -> str:
    """The result as text for a terminal: verdict, next step, findings and residuals.

    Args:
        explanation: The analysis; where its data are unfit, no residuals are given.
        page: The HTML report written.
        unit: Unit of torque shown above the residuals.
    """
    lines = [_verdict_line(explanation)]
    lines += [f"  {reason}" for reason in explanation.reasons]
    lines += [*_next_lines(explanation, page), f"report: {page}"]
    for finding in explanation.findings:
        lines += _finding_lines(finding)
    if explanation.unchecked:
        # Residuals of data that have nothing of it would read as an all-clear.
        lines.append(NOTHING_OF_IT)
    elif explanation.verdict != DATA_UNFIT:
        lines.append(f"residual RMS, {unit}, on {explanation.judged_on}")
        heads = ("healthy", "detectable", *(("before", "after") if explanation.findings else ("residual",)))
        columns = [explanation.noise_floor_Nm, explanation.detectable_Nm, explanation.before_Nm]
        columns += [explanation.after_Nm] if explanation.findings else []
        lines += [*_table(11, heads, explanation.joints, columns), RESIDUAL_WORDS]
    for left in explanation.unexplained:
        share = f"{100 * left.fraction:.0f} % of the residual variance"
        lines.append(f"unexplained at {', '.join(left.joints)}: {share}; {left.where}")
    if explanation.already_there:
        lines.append(f"in the reference as well: {'; '.join(explanation.already_there)}")
    return "\n".join(lines)


def _verdict_line(explanation: Explanation) -> str:
    """The verdict with what it rests on."""
    words = explanation.verdict.replace("_", " ")
    if explanation.verdict == NO_MISMATCH:
        if len(explanation.compared) < len(explanation.joints):
            where = ", ".join(explanation.compared)
            return f"{words} at {where}, whose residual lies within the healthy range; nothing is known of the others"
        return f"{words}: the residual of every joint lies within the healthy range"
    if explanation.verdict == DATA_UNFIT:
        return words
    found = [f"{one.effect} at {', '.join(one.joints)}" for one in explanation.findings]
    return ": ".join([words, *filter(None, ["; ".join(found)])])


def _next_lines(explanation: Explanation, page: Path) -> list[str]:
    """What to do with the result."""
    if explanation.verdict == DATA_UNFIT:
        return [UNFIT_NEXT]
    if explanation.next_experiment:
        lines = [f"next: {explanation.next_experiment}"]
        if explanation.next_motion:
            lines.append(f"  {page.with_name(NEXT_RUN)} is that motion: {explanation.next_motion}")
        return lines + [f"  {caution}" for caution in explanation.next_cautions]
    if explanation.findings:
        to_do = f"{explanation.findings[0].remedy}; see {page}" if explanation.findings[0].remedy else f"look at {page}"
        return [f"next: {to_do}; {page.with_name(EXTENDED_MODEL)} predicts torque with what was found"]
    return []


def _finding_lines(finding: Finding) -> list[str]:
    sure = f"{finding.confidence:.2f}{' that no known effect is the cause' if finding.effect == UNKNOWN else ''}"
    lines = [f"{finding.effect} at {', '.join(finding.joints)} (confidence {sure}): {finding.where}"]
    values = [
        f"{name} {q.value:.4g} [{q.low:.4g}, {q.high:.4g}]{_unit(q.unit)}" if q.known else f"{name} unknown"
        for name, q in finding.parameters.items()
    ]
    if values:
        lines.append(f"    {'; '.join(values)}")
    when = "while it lasts" if finding.unchecked else "there"
    if math.isfinite(finding.explained):
        lines.append(
            f"    explains {100 * finding.explained:.0f} % of the residual variance above the noise floor {when}"
        )
    elif not finding.unchecked:
        lines.append("    without it the held-out residual is within the noise floor: its share is not testable")
    if finding.unchecked:
        lines.append(f"    {finding.unchecked}")
    if finding.remedy:
        lines.append(f"    what to do: {finding.remedy}")
    for other in finding.alternatives:
        where = ", ".join(other.joints) or "the whole arm"
        lines.append(f"    rather than {other.effect} at {where}: {other.why_not}")
    return lines


def _unit(unit: str) -> str:
    """A unit after a value; of a ratio, nothing."""
    return "" if unit == "1" else f" {unit}"
