"""What the identifier says about a model, as standard messages and as figures for `/diagnostics`."""

from __future__ import annotations

from collections.abc import Iterable

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from sensor_msgs.msg import JointState

from ..arrays import FloatArray
from ..conventions.finding import UNFIT_MODEL
from ..dynamics.model import IdentifiedModel
from ..dynamics.term import Constant, Parameter
from ..estimate.identified import Estimate, Identified, Validation
from ..identification.verdict import judge_result
from ..layers.comparison import Comparison
from ..layers.document import verdict
from ..mismatch.finding import Explanation
from ..sessions.identification import Session
from ..tracking.layout import TrackedValue
from ..tracking.tracker import TrackingState

FROM_FILE = "from a model file"
TRACKED = "tracked"


def parameters_message(stamp: Time, statuses: Iterable[DiagnosticStatus]) -> DiagnosticArray:
    """`/identifier/parameters`: one status a parameter.

    Args:
        stamp: Time of the header.
        statuses: Of identified parameters (`parameter_statuses`), then of followed ones (`tracked_statuses`).
    """
    message = DiagnosticArray(status=list(statuses))
    message.header.stamp = stamp
    return message


def parameter_statuses(arm: str, model: IdentifiedModel, known: Identified | None) -> list[DiagnosticStatus]:
    """Identified parameters, named as `f_c[joint_1]`; the message of each says what it rests on.

    Numbers have all their digits: they read back to those of `model.yaml`.

    Args:
        arm: Name of the arm, the hardware id.
        model: Whose values to publish.
        known: The identification it comes from; None: a model file, which knows no standard errors.
    """
    if known is not None:
        return [
            _status(arm, one, one.value, one.standard_error, one.determination.value, one.note)
            for one in known.estimates
        ]
    items: tuple[Parameter | Constant, ...] = (*model.model.parameters, *model.model.constants)
    values = (*model.parameters.tolist(), *model.constants.tolist())
    return [_status(arm, one, value, float("nan"), FROM_FILE) for one, value in zip(items, values)]


def tracked_statuses(arm: str, state: TrackingState) -> list[DiagnosticStatus]:
    """Followed parameters as they are now, named as `tracked f_c[joint_1]`, beside where each was identified.

    Args:
        arm: Name of the arm.
        state: What the tracking knows; the stamps' time of its last row goes with each.
    """
    statuses = []
    for item in state.parameters:
        note = "" if item.informed else "not excited by any motion yet"
        status = _status(arm, item, item.value, item.standard_error, TRACKED, note)
        status.name = f"{TRACKED} {status.name}"
        further = {"identified": repr(item.identified), "time_s": f"{state.time_s:.3f}"}
        status.values = [*status.values, *(KeyValue(key=key, value=value) for key, value in further.items())]
        statuses.append(status)
    return statuses


def _status(
    arm: str,
    item: Estimate | Parameter | Constant | TrackedValue,
    value: float,
    standard_error: float,
    determination: str,
    note: str = "",
) -> DiagnosticStatus:
    """A parameter as it is published; the standard error is NaN where there is none."""
    values = {
        "symbol": item.symbol,
        "joint": item.joint,
        "value": repr(float(value)),
        "unit": item.unit,
        "standard_error": repr(float(standard_error)),
        "determination": determination,
        "note": note,
    }
    return DiagnosticStatus(
        level=DiagnosticStatus.OK,
        name=f"{item.symbol}[{item.joint}]",
        message=determination,
        hardware_id=arm,
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def torque_message(joints: tuple[str, ...], stamp_ns: int, effort: FloatArray) -> JointState:
    """A joint state with torques, for `/identifier/residuals` and `/identifier/predicted`.

    Args:
        joints: Names of the n joints.
        stamp_ns: Time that the torque belongs to, ns since the epoch.
        effort: (n,) torque, N·m or N.
    """
    message = JointState(name=joints, effort=effort)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 1_000_000_000)
    return message


def validation_figures(validation: Validation) -> dict[str, object]:
    """The figures of `validation.json` that a person watches, by joint."""
    figures: dict[str, object] = {"validated": validation.what, "held_out": validation.held_out}
    for joint, judged in validation.joints.items():
        fit = judged.everything
        figures[f"rmse_Nm[{joint}]"] = fit.rmse
        figures[f"max_Nm[{joint}]"] = fit.largest
        figures[f"r[{joint}]"] = fit.correlation
        figures[f"moving_relative_rms[{joint}]"] = judged.moving.relative_rms
    return figures


def doubts_and_notes(session: Session) -> tuple[list[str], list[str]]:
    """Reasons against the use of a result, and further notes on it, a line each, as `spacearm identify` prints them.

    Args:
        session: Result. Of unfit data the verdict is theirs, and the model has none; a verdict of poor or suspect is a
            doubt, any other a note.
    """
    conventions, judged = session.conventions, judge_result(session.identified, session.validation)
    about = conventions.lines() if conventions.findings else []
    if not conventions.fit:
        return [*about, UNFIT_MODEL], []
    return (list(judged.lines), about) if not judged.usable else ([], [*judged.lines, *about])


def mismatch_figures(explanation: Explanation) -> dict[str, object]:
    """What `mismatch.json` says, as far as a person watches it."""
    figures: dict[str, object] = {"verdict": explanation.verdict, "judged_on": explanation.judged_on}
    for finding in explanation.findings:
        name = f"{finding.effect}[{', '.join(finding.joints)}]"
        figures[name] = "; ".join(f"{key} {value.value:.4g} {value.unit}" for key, value in finding.parameters.items())
        figures[f"confidence of {name}"] = finding.confidence
        figures[f"explained by {name}"] = finding.explained
    for left in explanation.unexplained:
        figures[f"unexplained[{', '.join(left.joints)}]"] = left.fraction
    by_joint = (explanation.noise_floor_Nm, explanation.before_Nm, explanation.after_Nm)
    for joint, *rms in zip(explanation.joints, *by_joint):
        figures |= {f"{what}_Nm[{joint}]": value for what, value in zip(("noise", "before", "after"), rms)}
    return figures


def layer_figures(comparison: Comparison) -> dict[str, object]:
    """What the layers of `mismatch.json` say, as far as a person watches it."""
    figures: dict[str, object] = {"verdict": verdict(comparison), "judged_on": comparison.judged_on}
    for layer in comparison.layers:
        for item in layer.items:
            name = f"{layer.name}: {item.name}[{', '.join(item.joints)}]"
            figures[name] = f"{item.was:.4g} -> {item.value:.4g} {item.unit}"
    for joint, *rms in zip(comparison.joints, comparison.before_Nm, comparison.after_Nm):
        figures |= {f"{what}_Nm[{joint}]": value for what, value in zip(("before", "after"), rms)}
    return figures
