"""The page of a mismatch: nothing in it loads, runs or breaks, and it shows what was found where the eye can see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from made_finding import made_finding
from made_result import Page
from small_arm import JOINTS, URDF

from spacearm_ident.dynamics.arm import Arm, arm_from_urdf
from spacearm_ident.dynamics.effects import EFFECTS
from spacearm_ident.mismatch.finding import (
    DATA_UNFIT,
    MISMATCH,
    NO_MISMATCH,
    Alternative,
    Detectable,
    Explanation,
    Finding,
    Quantity,
    Trace,
    Unexplained,
    unfit,
)
from spacearm_ident.report.mismatch_figures import OVER, TIME, signals, view_of
from spacearm_ident.report.mismatch_html import mismatch_html, typeset

CYCLES = 24.0
NOISE = np.array([0.1, 0.05])
EVIL = "<b>x</b>\"'><script>alert(1)</script>&$\\frac$"
SOURCES = {
    "command": "spacearm mismatch",
    "fitted_on": [{"path": "field.mcap", "bytes": 12, "sha256": "ab" * 32}],
    "reference": [{"path": "healthy.mcap", "bytes": 13, "sha256": "cd" * 32}],
    "validated_on": [],
}


def arm() -> Arm:
    return arm_from_urdf(URDF)


def trace(rows: int = 900) -> Trace:
    """Ripple at the shoulder, friction over position at the elbow; both gone afterwards."""
    rng = np.random.default_rng(1)
    time = np.linspace(0.0, 15.0, rows)
    position = np.stack([1.2 * np.sin(0.7 * time), 0.9 * np.sin(1.1 * time + 1.0)], axis=1)
    velocity = np.stack([0.84 * np.cos(0.7 * time), 0.99 * np.cos(1.1 * time + 1.0)], axis=1)
    after = NOISE * rng.standard_normal((rows, 2))
    left = np.stack([np.sin(CYCLES * position[:, 0]), np.sin(2 * position[:, 1]) * np.sign(velocity[:, 1])], axis=1)
    before = after + left
    before[100:130] = after[100:130] = np.nan
    return Trace(time, position, velocity, before, after)


def finding(effect: str = "torque_ripple", joint: str = JOINTS[0], **changes: object) -> Finding:
    ripple: dict[str, object] = {
        "where": "24 cycles a joint revolution",
        "equation": "a sin(N q) + b cos(N q)",
        "source": "Olsen and Petersen 2001",
        "parameters": {"amplitude": Quantity(1.0, "N m", 0.97, 1.03), "cycles": Quantity(CYCLES, "1/rev", 23.9, 24.1)},
        "confidence": 0.98,
        "alternatives": (Alternative("harness_spring", (joint,), 0.3, "explains 30 %"),),
    }
    return made_finding(effect, joint, **{**ripple, **changes})


def explanation(*findings: Finding, **changes: object) -> Explanation:
    made = Explanation(
        verdict=MISMATCH if findings else NO_MISMATCH,
        joints=JOINTS,
        noise_floor_Nm=NOISE,
        detectable_Nm=1.6 * NOISE,
        before_Nm=np.array([0.71, 0.7]),
        after_Nm=np.array([0.1, 0.05]),
        findings=findings,
        traces=(trace(), trace(300)),
        judged_on="held-out recordings",
    )
    return replace(made, **changes)  # type: ignore[arg-type]


def page(of: Explanation) -> Page:
    return Page(mismatch_html(of, arm(), SOURCES))


def test_page_refers_to_nothing_outside_itself() -> None:
    text = mismatch_html(explanation(finding()), arm(), SOURCES)
    parsed = Page(text)
    assert parsed.references, "the point clouds are images"
    assert all(reference.startswith(("data:image/png;base64,", "#")) for reference in parsed.references)
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(parsed.tags)
    assert "Content-Security-Policy" in text
    assert "://" not in text and "@import" not in text and "url(" not in text.replace("url(#", "")


def test_every_table_scrolls_in_its_own_frame_where_the_page_is_narrow() -> None:
    text = mismatch_html(explanation(finding()), arm(), SOURCES)
    assert text.count("<table") == text.count('<div class="wide"><table') > 3


def test_page_says_when_runs_were_recorded_and_never_a_mapping_of_python() -> None:
    runs = [
        {"start": "2025-06-15T15:06:40+00:00", "duration_s": 50.085999},
        {"start": "1970-01-01T00:00:00", "duration_s": 9},
    ]
    words = Page(mismatch_html(explanation(finding()), arm(), {**SOURCES, "recorded": runs})).text
    assert "2025-06-15 15:06, 50.09 s; no date, 9 s" in words and "'start'" not in words


def test_page_says_it_in_the_order_an_engineer_reads() -> None:
    words = page(
        explanation(
            finding(),
            unexplained=(Unexplained(("elbow",), "weakly follows its own speed", 0.4),),
            already_there=("a delay",),
            next_experiment="move slowly",
        )
    ).text
    order = (
        *("Mismatch at shoulder: torque ripple over the joint's position, 0.70 N·m RMS", "98 %", "96 %"),
        *("Residual at a glance", "Findings", "0.9700 to 1.030", "explains 30 %", "Residual over time"),
        *("weakly follows its own speed", "a delay", "move slowly", "How it was obtained"),
        *("field.mcap", "ab" * 32, "healthy.mcap"),
    )
    places = [words.find(item) for item in order]
    assert -1 not in places
    assert places == sorted(places)


def test_page_says_which_effects_no_size_would_have_shown() -> None:
    sizes = (
        Detectable("friction_drift", ("elbow",), 0.4, "N m", "df_c"),
        Detectable("backlash", ("shoulder",), np.inf, ""),
    )
    words = page(explanation(would_have_seen=sizes)).text
    _, table = " ".join(words.split()).split("smallest that would have been detected ")
    assert table.startswith("friction drift elbow df c 0.400 N·m backlash shoulder none ")


def test_text_from_outside_cannot_become_markup() -> None:
    names = (EVIL, JOINTS[1])
    small = arm()
    small = replace(small, joints=(replace(small.joints[0], name=EVIL), *small.joints[1:]))
    hostile = finding(
        EVIL,
        EVIL,
        where=EVIL,
        equation=EVIL,
        source=EVIL,
        parameters={EVIL: Quantity(1.0, EVIL, 0.5, 1.5)},
        alternatives=(Alternative(EVIL, (EVIL,), 0.5, EVIL),),
    )
    of = explanation(
        hostile,
        joints=names,
        unexplained=(Unexplained((EVIL,), EVIL, 0.5),),
        next_experiment=EVIL,
        already_there=(EVIL,),
        reasons=(EVIL,),
        judged_on=EVIL,
    )
    parsed = Page(mismatch_html(of, small, {"command": EVIL, EVIL: EVIL, "fitted_on": [{"path": EVIL}]}))
    assert not {"b", "script"} & set(parsed.tags)
    assert parsed.text.count("alert(1)") > 15


@pytest.mark.parametrize(
    ("of", "says", "drawings"),
    [
        (explanation(), "No mismatch: the reference explains", 2),
        (replace(explanation(), before_Nm=np.array([0.1, np.nan])), f"No mismatch at {JOINTS[0]}; nothing is known", 2),
        (explanation(unexplained=(Unexplained(("elbow",), "?", 0.4),)), "above the noise remains at elbow", 2),
        (unfit(JOINTS, ("nothing moves",)), "nothing moves", 0),
        (explanation(finding("unknown", parameters={})), "No effect of the catalogue", 3),
        (explanation(finding(), finding("position_friction", "elbow")), "Also found: friction depends", 4),
    ],
    ids=["healthy", "half healthy", "healthy with a rest", DATA_UNFIT, "unknown", "two"],
)
def test_every_verdict_has_its_page(of: Explanation, says: str, drawings: int) -> None:
    parsed = page(of)
    assert says in parsed.text
    assert len(parsed.drawings) == drawings


@pytest.mark.parametrize("effect", [*EFFECTS, "unknown"])
def test_every_effect_has_a_figure_before_and_after(effect: str) -> None:
    drawings = page(explanation(finding(effect))).drawings
    assert any(effect in drawing and "before and after" in drawing for drawing in drawings)


def test_page_of_figures_that_are_not_known() -> None:
    nothing = np.full(2, np.nan)
    empty = replace(trace(), before=np.full((900, 2), np.nan), after=np.full((900, 2), np.nan))
    lost = finding(
        parameters={"amplitude": Quantity(np.nan, "N m", np.nan, np.nan), "cycles": Quantity(np.nan, "1", 0.0, 0.0)},
        confidence=np.nan,
        visibility=np.nan,
        explained=np.nan,
        before_Nm={JOINTS[0]: np.nan},
        after_Nm={},
    )
    for traces in ((empty,), (trace(),), ()):
        of = explanation(
            lost, noise_floor_Nm=nothing, detectable_Nm=nothing, before_Nm=nothing, after_Nm=nothing, traces=traces
        )
        words = page(of).text
        assert "not testable" in words
        assert "nan" not in words.lower().replace("nano", "")


def test_a_finding_is_drawn_over_what_it_depends_on() -> None:
    drawn = signals((trace(), trace(300)))
    assert drawn is not None
    ripple = view_of(finding(), 0, drawn)
    assert (ripple.signal, ripple.driver, ripple.cycles) == ("position", 0, CYCLES)
    friction = view_of(finding("unknown", JOINTS[1], parameters={}), 1, drawn)
    assert (friction.signal, friction.driver, friction.along) == ("position", 1, True)
    passing = view_of(finding("unknown", JOINTS[1], parameters={}, event=True), 1, drawn)
    assert passing.signal == TIME
    noise = replace(trace(), before=trace().after)
    plain = signals((noise,))
    assert plain is not None
    assert view_of(finding("unknown", parameters={}), 0, plain).signal == TIME


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_is_drawn_over_dependences_that_a_figure_has(kind) -> None:
    assert set(EFFECTS[kind].shown_over or ()) <= set(OVER)


def test_an_effect_of_one_quantity_is_drawn_over_that_alone() -> None:
    drawn = signals((trace(),))
    assert drawn is not None
    of_position = view_of(finding("position_friction", JOINTS[1], parameters={}), 1, drawn)
    assert (of_position.signal, of_position.along) == ("position", True)
    assert view_of(finding("friction_drift", JOINTS[1], parameters={}), 1, drawn).signal != "position"
    assert view_of(finding("time_delay", JOINTS[1], parameters={}), 1, drawn).signal == TIME


def test_lines_break_between_recordings() -> None:
    drawn = signals((trace(), trace(300)))
    assert drawn is not None
    assert drawn.starts == (0, 900)
    assert np.isnan(drawn.before[900]).all() and np.isfinite(drawn.before[899]).all()
    assert np.all(np.diff(drawn.time) > 0)


def test_equations_in_the_letters_of_the_field() -> None:
    assert typeset("mu |tau_load| sgn(qd)") == "μ |τ_load| sgn(q̇)"
    assert typeset("-M_mb M_bb^-1 (M_bm qdd + c_b)") == "−M_mb M_bb⁻¹ (M_bm q̈ + c_b)"
