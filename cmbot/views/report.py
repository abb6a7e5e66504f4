"""What a plan gains, what it keeps and how it moves, as one HTML page: replay, plots and tables."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from html import escape
from math import floor, inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.accuracy import assumed_in_words
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import given_path
from cmbot.elastic import elastic_base
from cmbot.planning import (
    LOAD_HEADINGS,
    Certificate,
    Plan,
    baseline_faults,
    bound_use,
    during,
    hold_use,
    left_out,
    load_point,
    load_rows,
    notes,
    promised,
    promises,
    remarks,
    require_plan,
    tightest_check,
    verdict,
)
from cmbot.robot import postures_in_words
from cmbot.simulation import (
    Tracking,
    base_movement,
    beyond_margin,
    interval_headings,
    interval_rows,
    tracking_remarks,
    tracking_rows,
    tracking_verdict,
)
from cmbot.version import __version__, versions
from cmbot.views.charts import MOST_SMALL_POINTS, charts, floor_name, joint_charts, undercut
from cmbot.views.page import STAGE_SCRIPTS, assemble, table, write_page
from cmbot.views.replay import replay_html
from cmbot.views.replay_data import replay_data

if TYPE_CHECKING:
    from cmbot.excitation import Excitation

REPLAY, REPORT = "replay.html", "report.html"
# Peaks that differ by less, as a share, are the same.
_SAME_PEAK_SHARE = 1e-3
# A peak farther above its lower bound, as a share of it, is compared with sequences of postures, too.
_LOOSE_GAP = 0.05
# Distances from the path that differ by less, as a share of their bound, are the same.
_DISTANCE_TOLERANCE_SHARE = 0.02
# Feet that use more of what their safety allows have hardly anything left.
_NEAR_BOUND_SHARE = 0.95
# Standard deviations on both sides that have 95 %.
_SIGMAS_95 = 1.96
_JOINT_HEADINGS = ("joint", "range, deg", "deg/s", "deg/s²", "deg/s³", "Nm")
# Where joints slide each row has its own units.
_MIXED_HEADINGS = ("joint", "range", "velocity", "acceleration", "jerk", "torque or force")

SHARES = (
    " The percentages are the largest shares of the bounds that each motion uses, a plan with its free moves."
)

Row = Sequence[str]
State = Literal["plain", "good", "worse", "bad"]


def report(
    plan: Plan,
    html: str | Path,
    *,
    tracking: Tracking | None = None,
    excitation: Excitation | None = None,
) -> None:
    """Write a report of a plan: one self-contained page with its replay, plots and tables.

    Parameters
    ----------
    plan : Plan
    html : str or Path
        It appears whole or not at all; an earlier file of that name is replaced.
    tracking : Tracking, optional
        Of that plan, from `cmbot.simulate`: its plots and metrics are then in the report, too.
    excitation : Excitation, optional
        Of that plan, from `cmbot.excite`: its figures are then in the report, too.

    Raises
    ------
    InputError
        When `plan` is none, the file cannot be written, or `tracking` is that of another plan.
    ModelError, SceneError
        When a shape cannot be drawn.

    Examples
    --------
    >>> cmbot.report(plan, "report.html", tracking=tracking)
    """
    require_plan(plan, "cmbot.report")
    path = given_path(html, "cmbot.report", "html", "the path of a file to write")
    write_page(path, report_page(plan, tracking, excitation))


def report_page(plan: Plan, tracking: Tracking | None = None, excitation: Excitation | None = None) -> str:
    """Return an HTML page with the gains and constraints of a plan, and with its motions in 3-D.

    Like `replay_page`, with the same arguments and errors, it opens no connection and runs only its own two
    scripts. With `tracking` its plots and metrics are on the page, too, with `excitation` its figures. It
    stays below 6 MB, and can be printed.
    """
    return _report_html(plan, tracking, excitation, replay_data(plan, tracking))


def pages(
    plan: Plan, tracking: Tracking | None = None, excitation: Excitation | None = None
) -> dict[str, bytes]:
    """Return `replay_page` and `report_page` by their names in a plan directory, from one set of data."""
    # Matrices are small: the threads of BLAS would mostly wait for each other.
    with threadpool_limits(limits=1, user_api="blas"):
        data = replay_data(plan, tracking)
        texts = {REPLAY: replay_html(plan, data), REPORT: _report_html(plan, tracking, excitation, data)}
    return {name: text.encode("utf-8", "replace") for name, text in texts.items()}


def _report_html(
    plan: Plan, tracking: Tracking | None, excitation: Excitation | None, data: dict[str, Any]
) -> str:
    plots = {
        "charts": [chart.data() for chart in charts(plan, tracking)],
        "jointCharts": [chart.data(MOST_SMALL_POINTS) for chart in joint_charts(plan)],
    }
    state, first = promised_state(plan, tracking)
    return assemble_report(
        data | plots,
        title=escape(plan.scene.name),
        # What comes first: whether promises are kept, what they leave out, what the base must bear.
        verdict=banner(state, first, verdict(plan, area=False)),
        shares=SHARES,
        cards="".join(map(_card, headlines(plan, tracking))),
        key=_key(plan),
        bending="" if tracking is not None else " hidden",
        sections="".join(_sections(plan, tracking, excitation)),
    )


def assemble_report(data: dict[str, Any], **texts: str) -> str:
    """Return a report's page, of one plan or of several: its data, and the texts of its template."""
    return assemble(
        "report.html",
        styles=("common.css", "report.css"),
        scripts=(*STAGE_SCRIPTS, "downloads.js", "chart.js", "report.js", "sideways.js"),
        data=data,
        texts={"made": escape(f"Written by cmbot {__version__}."), **texts},
    )


@dataclass(frozen=True, kw_only=True)
class Headline:
    """One card: a quantity of the planned motion, the baseline's value before it, a sentence, a verdict.

    ``good`` is a gain on the baseline, ``worse`` a loss within the bounds, or a bound that is nearly reached,
    ``bad`` a broken bound, ``plain`` neither.
    """

    title: str
    value: str
    detail: str
    before: str = ""
    state: State = "plain"


def headlines(plan: Plan, tracking: Tracking | None) -> Iterator[Headline]:
    """Yield the cards, the most important first."""
    accuracy = _accuracy_card(plan)
    if accuracy is not None:
        yield accuracy
    if plan.robot.holding is not None:
        yield _holds_card(plan)
    yield _peak_card(plan)
    yield _lower_bound_card(plan)
    yield _certificate_card(plan)
    yield _clearance_card(plan)
    if accuracy is None:
        yield _deviation_card(plan)
    if tracking is not None:
        yield _tracking_card(plan, tracking)


def certificates(plan: Plan) -> dict[str, Certificate]:
    """Return the certificates of a plan by the names of its segments, those of the strokes first."""
    first = {stroke.name: stroke.certificate for stroke in plan.job.strokes}
    return first | {segment.name: segment.certificate for segment in plan.job.segments}


def _peak_card(plan: Plan) -> Headline:
    work = plan.figures.peak_guardrail_torque
    if plan.baseline is None:
        detail = f"at work {work:.1f} Nm"
    elif faults := baseline_faults(plan, work=True):
        detail = f"at work {work:.1f} Nm; no gain is stated, as the baseline {faults}"
    else:
        other = plan.baseline.figures.peak_guardrail_torque
        change = f", {100 * (work / other - 1):+.1f} %" if other else ""
        detail = f"at work {other:.1f} → {work:.1f} Nm{change}"
    for segment in plan.job.segments:
        if segment.kind == "free":
            detail += f"; {segment.figures.peak_guardrail_torque:.1f} Nm on {segment.in_words}"
    before, state = _against(plan, "peak_guardrail_torque")
    return Headline(
        title=f"Peak {plan.scene.base_name} torque, whole job",
        value=f"{plan.job.figures.peak_guardrail_torque:.1f} Nm",
        detail=detail,
        before=_shown(before, 1),
        state=state,
    )


def _holds_card(plan: Plan) -> Headline:
    """Whether the feet hold: the share of what their safety allows that they use."""
    needed, use = plan.job.figures.adhesion_needed, hold_use(plan.job)
    stance = plan.scene.guardrail.stance
    feet = "" if stance is None else f", on {' and '.join(place.in_words for place in stance.held)}"
    if use is None:
        asked = "" if needed is None else f"; as magnets the feet would need {needed.peak / 1e3:.1f} kN"
        return Headline(title="Holds", value="–", detail=f"what the feet bear is not given{asked}")
    _, worst = tightest_check(plan.job, limit=Limit.HOLD)
    shown = f", {worst.value / 1e3:.2f} of {worst.bound / 1e3:.2f} kN" if worst.unit == "N" else ""
    if needed is not None and plan.robot.feet[needed.foot - 1].gap == "allowed":
        shown += f" (a gap may open; {needed.closed / 1e3:.2f} kN without safety where none may)"
    return Headline(
        title="Holds",
        value=f"{100 * use:.0f} %",
        detail=f"of what its safety allows, at most: {worst.quantity}{shown}, at all times of the job{feet}",
        state="good" if use <= _NEAR_BOUND_SHARE else "worse" if use <= 1 else "bad",
    )


def _against(
    plan: Plan, name: str, sign: int = 1, *, kept: bool = True, nothing: float = 0.0, work: bool = False
) -> tuple[float | None, State]:
    """The baseline's figure of a name, and what that of the plan is beside it, as `_compared` says.

    None without a baseline, or where that breaks a limit. With the `sign` -1 the more is the better.
    """
    baseline, before = plan.baseline, None
    after = getattr(plan.figures if work else plan.job.figures, name)
    if baseline is not None and not baseline_faults(plan, work=work):
        before = getattr(baseline.figures if work else baseline.job_figures, name)
    return before, _compared(before and sign * before, sign * after, kept=kept, nothing=nothing)


def _compared(before: float | None, after: float, *, kept: bool, nothing: float = 0.0) -> State:
    """Whether a value is a gain on the baseline's or a loss, the less the better, or not allowed.

    A change up to `nothing` is none.
    """
    if not kept:
        return "bad"
    if before is None or abs(after - before) <= max(_SAME_PEAK_SHARE * abs(before), nothing):
        return "plain"
    return "good" if after < before else "worse"


def _shown(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def _lower_bound_card(plan: Plan) -> Headline:
    bound, gap = plan.torque_floor, plan.gap_to_floor
    if bound is None or gap is None:
        fixed = plan.options.knots == "fixed"
        why = "not computed for fixed knots" if fixed else "not computed near an earlier plan"
        why = why if plan.lower_bound is None else "another objective was minimised"
        return Headline(title="Above the lower bound", value="–", detail=why)
    title, value, name = "Above the lower bound", f"{100 * gap:+.3g} %", f"{floor_name(plan)} {bound:.1f} Nm"
    if gap < 0:
        title, value, name = "Lower bound", "reached", f"{name}; {undercut(plan)} {-100 * gap:.2g} % less"
    elif gap > _LOOSE_GAP and (over := plan.gap_to_sequences) is not None:
        name += f"; {100 * over:+.1f} % above the least of sequences of postures (estimate)"
    return Headline(title=title, value=value, detail=f"{name}, explained at the torque's plot")


def _certificate_card(plan: Plan) -> Headline:
    parts = {name: [check.holds for check in found.checks] for name, found in certificates(plan).items()}
    segment, tightest = tightest_check(plan.job)
    of_each = ", ".join(f"{name} {sum(held)} of {len(held)}" for name, held in parts.items())
    holds = [held for part in parts.values() for held in part]
    return Headline(
        title="Certified checks, whole job",
        value=f"{sum(holds)} of {len(holds)} hold",
        detail=f"tightest: {promised(tightest, during(segment, plan.job))}"
        + (f"; {of_each}" if len(parts) > 1 else ""),
        state="good" if all(holds) else "bad",
    )


def _clearance_card(plan: Plan) -> Headline:
    value, margin = plan.job.figures.min_clearance, plan.options.safety_margin_m
    if value == inf:
        return Headline(title="Smallest clearance", value="–", detail="no pair of shapes can collide")
    always = floor(1e4 * plan.job.certificate.clearance_bound) / 10
    before, state = _against(plan, "min_clearance", -1, kept=value >= margin)
    segment, nearest = tightest_check(plan.job, limit=Limit.CLEARANCE)
    where = f"{nearest.quantity.partition(' of ')[2]} {during(segment, plan.job)}, at {nearest.time:.1f} s"
    return Headline(
        title="Smallest clearance",
        value=f"{1e3 * value:.1f} mm",
        detail=f"{where}; rigid arm; margin {1e3 * margin:g} mm; above {always:.1f} mm at all times",
        before=_shown(before and abs(1e3 * before), 1),
        state=state,
    )


def _accuracy_card(plan: Plan) -> Headline | None:
    """Within how much of its path the tool is, all counted; None where nothing bends."""
    accuracy = plan.accuracy
    if accuracy is None:
        return None
    detail = f"with {100 * accuracy.probability:g} %, all along the work"
    if accuracy.parts:
        part, share = accuracy.parts[0].name, 100 * accuracy.shares[0]
        assumed = assumed_in_words(part, plan.scene)
        by = f", as assumed ({assumed})" if assumed else ""
        detail += f"; largest part: {part}, {share:.0f} % of the mean square{by}"
    planned, bound = plan.figures.max_tool_deviation, plan.options.max_tool_deviation_m
    arm = "with the predicted sag" if plan.compensation is not None else "rigid arm"
    detail += f"; {arm}, as planned, {1e3 * planned:.2f} of {1e3 * bound:g} mm"
    kept = accuracy.tolerance_kept
    return Headline(
        title="Tool from its path, at most",
        value=f"{accuracy.within_mm:.3g} mm",
        detail=detail if kept is None else f"{detail}; tolerance {'kept' if kept else 'not kept'}",
        state="bad" if planned > bound or kept is False else "plain" if kept is None else "good",
    )


def _accuracy_section(plan: Plan) -> str:
    """The parts of the accuracy budget, and what would help."""
    accuracy = plan.accuracy
    if accuracy is None:
        return ""
    parts = [
        (part.name, f"{part.bias_mm:.2f}", f"{part.sigma_mm:.2f}", f"{100 * share:.1f}")
        for part, share in zip(accuracy.parts, accuracy.shares, strict=True)
    ]
    remedies = [
        (f"with {remedy.name}", f"{remedy.within_mm:.3g}", remedy.largest) for remedy in accuracy.remedies
    ]
    told = table(parts, ("mm", "known", "standard deviation", "% of the mean square"))
    return section("Where the tool will be", told + table(remedies, ("", "within, mm", "largest part then")))


def _measured_section(plan: Plan) -> str:
    """What was identified, and from which readings; empty where nothing was."""
    if (identified := plan.scene.identified) is None:
        return ""
    # Most plans are as modelled: their pages are made without it.
    from cmbot.identification import is_unseen, stiffness_rows

    base = elastic_base(replace(plan.scene.modelled_guardrail, leg_compliance=plan.robot.leg_compliance))
    before = None if base is None else np.asarray(np.linalg.inv(base.stiffness))
    rows = [
        (
            name,
            "rigid" if was == inf else f"{was:.4g}",
            f"{now:.4g}",
            f"{now / by:.4g} to {now * by:.4g}{seen}",
        )
        for name, was, now, deviation, prior in stiffness_rows(identified, before)
        for by, seen in [(np.exp(_SIGMAS_95 * deviation), ", not seen" * is_unseen(deviation, prior))]
    ]
    told = table(rows, ("stiffness", "scene's", "measured", "with 95 % within"))
    if (measured := identified.measured) is None:
        return section("Measured", told)
    modes = [
        (
            f"{mode.hz:.4g} ± {mode.hz_sd:.2g}",
            "{:.2f} ± {:.2g}".format(*(100 * x for x in mode.damping)) if mode.damping else "-",
        )
        for mode in measured.modes
    ]
    left = [
        f"{each.count} {each.kind}"
        + ("" if each.residual is None else f" (residual {each.residual:.2g} times what stated errors leave)")
        for each in measured.readings
    ]
    sentences = [f"From {', '.join(measured.sheets)}: {', '.join(left)}."]
    if measured.sag_mm is not None:
        was, now = (f"{sag:.2f}" for sag in measured.sag_mm)
        sentences.append(
            f"The sag along the job measured for is {now} mm RMS, with the scene's stiffness {was}."
        )
    sentences += ["± is one standard deviation."] * bool(modes)
    headings = ("frequency, Hz", "damping, % of critical")
    return section("Measured", told + table(modes, headings) + _list(sentences))


def _loads_section(plan: Plan) -> str:
    """The loads for whoever sizes the base and chooses the arm."""
    point, base, robot = _numbers(load_point(plan), 3), plan.scene.base_name, plan.robot
    still = -robot.carrier_mass * robot.model.gravity.linear[2]
    told = (
        f"Of the samples of job.csv. Forces and torques on the {base} are what the arm exerts on it, about "
        f"({point}) m, where it is fixed, along the axes of the world; values with their signs. "
        f"What moves is counted, {robot.arm_mass:.1f} kg; the {robot.carrier_mass:.1f} kg that do not add "
        f"{still:.0f} N downwards and ({_numbers(robot.carrier_torque, 1)}) Nm at all times."
    )
    return section(
        "Loads on the base and the joints", f"{table(load_rows(plan), LOAD_HEADINGS)}<p>{escape(told)}</p>"
    )


def _deviation_card(plan: Plan) -> Headline:
    value, bound = plan.figures.max_tool_deviation, plan.options.max_tool_deviation_m
    arm = "with the predicted sag" if plan.compensation is not None else "rigid arm"
    nothing = _DISTANCE_TOLERANCE_SHARE * bound
    before, state = _against(plan, "max_tool_deviation", kept=value <= bound, nothing=nothing, work=True)
    return Headline(
        title="Tool off its path",
        value=f"{1e3 * value:.2f} mm",
        detail=f"{arm}; bound {1e3 * bound:g} mm",
        before=_shown(before and 1e3 * before, 2),
        state=state,
    )


def _tracking_card(plan: Plan, tracking: Tracking) -> Headline:
    compensated, bound = plan.compensation is not None, plan.options.max_tool_deviation_m
    # Compensation lowers the distance from the path: the arm bends as much as before.
    off = tracking.planned.largest_off_path
    kept, faults = off <= bound, baseline_faults(plan, work=True)
    motions = [motion.metrics for _, motion in tracking.motions][1 if faults else 0 :]
    *others, after = (1e3 * (each.path if compensated else each.total).rms[3] for each in motions)
    residuals = [each.residual for each in motions if each.residual is not None]
    detail = f"elastic arm, at most {_millimetres(1e3 * off)} mm off its path; bound {1e3 * bound:g} mm"
    if len(residuals) == len(motions):
        swings = " → ".join(f"{1e3 * residual.diameter:.2f}" for residual in residuals)
        detail += f"; residual vibration {swings} mm"
    return Headline(
        title="Elastic tool off its path, RMS" if compensated else "Tracking error, RMS",
        value=f"{_millimetres(after)} mm",
        detail=detail,
        before="".join(map(_millimetres, others)),
        state=_compared(others[0] if others else None, after, kept=kept),
    )


def _millimetres(value: float) -> str:
    """A deflection; those of stiff bases are small."""
    return f"{value:.1f}" if value >= 1 else f"{value:.2f}"


def _shaken(excitation: Excitation) -> str:
    # Most plans are not shaken: their pages are made without it.
    from cmbot.excitation import PASSAGE_HEADINGS, excitation_rows, excitation_sentences, passage_rows

    content = table(excitation_rows(excitation)) + _list(excitation_sentences(excitation))
    return content + table(passage_rows(excitation), PASSAGE_HEADINGS)


def _sections(plan: Plan, tracking: Tracking | None, excitation: Excitation | None) -> Iterator[str]:
    """Yield the sections below the plots."""
    # The verdict, which comes first of them, stands above.
    yield section("Remarks", _list(list(remarks(plan))[1:]), kind="wide")
    yield section("Metrics", table(plan.rows(), plan.headings))
    yield _loads_section(plan)
    yield _accuracy_section(plan)
    yield _measured_section(plan)
    if elastic := list(_elastic(plan)):
        yield section("Predicted sag", table(elastic))
    several = {stroke.name for stroke in plan.several}
    begins = {segment.name: segment.begin for segment in plan.job.segments}
    for name, certificate in certificates(plan).items():
        the = "" if name in several else "the "
        checks = _check_table(certificate, plan.scene.base_name, begins[name])
        yield section(f"Certificate of {the}{name}", checks)
    if tracking is not None:
        errors = table(tracking_rows(tracking), ("mm", "", "x", "y", "z", "norm"), text_columns=2)
        said = tracking_remarks(tracking, compensated=plan.compensation is not None)
        told = (tracking_verdict(plan, tracking), base_movement(plan, tracking), *said)
        others = table(interval_rows(tracking), interval_headings(tracking), text_columns=2)
        yield section("Simulation", errors + others + _list(filter(None, told)), kind="long")
    if excitation is not None:
        yield section("What shakes it", _shaken(excitation), kind="long")
    yield section("Scene", table(_scene(plan), text_columns=2))
    headings = _MIXED_HEADINGS if plan.robot.limits.prismatic.any() else _JOINT_HEADINGS
    yield section("Joints", table(_joints(plan), headings))
    yield section("Options", table(_options(plan.options), text_columns=2))
    files = {"scene": plan.scene.content_hash[:16], "robot": plan.robot.content_hash[:16]}
    yield section("Versions", table((versions() | files).items(), text_columns=2))
    if tracking is not None:
        yield section("Options of the simulation", table(_options(tracking.options), text_columns=2))


def _key(plan: Plan) -> str:
    key = '<i class="swatch planned"></i>planned'
    if plan.baseline is None:
        return key
    motion = "straight steps, timed as the plan is along strokes alone"
    if plan.options.baseline == "paper":
        motion = "the paper's motion, in the same time by its own trapezoid where the plan's law is quiet"
    return f'{key} <i class="swatch baseline"></i>{escape(f"baseline: {motion}, not optimised")}'


def promised_state(plan: Plan, tracking: Tracking | None) -> tuple[State, str]:
    """Return ``good``, ``worse`` or ``bad``, and whether promises are kept and what they leave out."""
    kept = all(check.holds for _, check in plan.job.checks())
    left = [] if tracking is None else [beyond_margin(plan, tracking)]
    if (off := plan.bent_offsets[1]) and plan.options.max_tool_deviation_m < off < np.inf:
        left.append(f"Uncompensated sag: {1e3 * off:.3g} mm.")
    if plan.accuracy is not None and plan.accuracy.tolerance_kept is False:
        left.append("The tolerance of the tool is not kept.")
    if missing := left_out(plan):
        left.append(f"Of the surface {missing}.")
    # The verdict says that no magnet bears what the feet need, of which nothing is promised.
    is_open = any(note.key == "unknown_hold" and note.values.get("beyond_magnets") for note in notes(plan))
    first = " ".join(filter(None, [promises(plan), *left]))
    return "bad" if not kept else "worse" if is_open or any(left) else "good", first


def _card(headline: Headline) -> str:
    before = f'<small><s>{escape(headline.before)}</s> <span aria-hidden="true">→</span></small> '
    return (
        f'<article class="card {headline.state}"><h2>{escape(headline.title)}</h2>'
        f"<p>{before if headline.before else ''}<b>{escape(headline.value)}</b></p>"
        f"<p>{escape(headline.detail)}</p></article>"
    )


def banner(state: State, first: str, said: str, *, name: str = "", unfolded: bool = True) -> str:
    """Return what a page begins with: a first sentence after a plan's name, which unfolds to all others."""
    words = f"<b>{escape(name)}.</b> {escape(first)}" if name else f"<b>{escape(first)}</b>"
    opened = " open" if unfolded else ""
    return f'<details class="verdict {state}"{opened}><summary>{words}</summary>{escape(said)}</details>'


def section(title: str, content: str, *, kind: Literal["", "wide", "long"] = "") -> str:
    """Return a section; a wide one spans both columns, a long one may be split between printed pages."""
    return f'<section class="{f"part {kind}".rstrip()}"><h2>{escape(title)}</h2>{content}</section>'


def _list(sentences: Iterable[str]) -> str:
    return f"<ul>{''.join(f'<li>{escape(sentence)}</li>' for sentence in sentences)}</ul>"


def _elastic(plan: Plan) -> Iterator[Row]:
    """Yield sag compensation, where it was asked for."""
    if (compensation := plan.compensation) is not None:
        yield "largest shift of the tool from its path, mm", f"{1e3 * compensation.largest_shift:.3f}"
        yield "sag beside what it was planned for, mm", f"{1e3 * compensation.last_change:.3f}"
        if compensation.deviation:
            spread = f"{1e3 * compensation.deviation:.3f}"
            yield "standard deviation of the tool across its path, at most, mm", spread


def _check_table(certificate: Certificate, base: str, begin: float) -> str:
    """Return a table of checks, their times on the job's clock, on which the segment starts at `begin`, s."""
    rows = []
    for check in certificate.checks:
        bound = f"{'≥' if check.at_least else '≤'} {check.bound:.4g}"
        use, holds = f"{100 * bound_use(check):.1f} %", "yes" if check.holds else "NO"
        at, value = f"{begin + check.time:.2f}", f"{check.value:.4g}"
        rows.append((check.quantity, at, value, bound, check.unit, use, holds))
    headings = ("check", "at, s", "value", "bound", "unit", "use", "holds")
    return table(rows, headings) + f"<p>{escape(f'At all times {certificate.at_all_times(base)}.')}</p>"


def _scene(plan: Plan) -> Iterator[Row]:
    scene, robot = plan.scene, plan.robot
    yield "name", scene.name
    yield "robot", f"{robot.name}, {robot.dof} joints, {robot.mass:.1f} kg, payload {robot.payload:g} kg"
    yield "posture", postures_in_words(robot.limits.prismatic, scene.posture)
    if scene.return_to != "none":
        yield "return to", str(scene.return_to)
    if robot.pushed:
        yield "process force on the tool, along its axes", f"({_numbers(robot.tool_force, 1)}) N"
        yield "in which it sets in, and ends", f"{robot.tool_ramp:g} s" if robot.tool_ramp else "at once"
    if scene.tool.max_speed_m_s is not None:
        yield "largest tool speed", f"{scene.tool.max_speed_m_s:g} m/s"
    for stroke in plan.strokes:
        of = f"{stroke.name}: " if plan.several else ""
        yield f"{of}tool constraint", stroke.task.kept
        path = stroke.task.path
        for k, (by, seconds) in enumerate(zip(np.diff(path.corners, axis=0), path.seconds, strict=True)):
            along = f", {path.lengths[k]:.3f} m along a curve" if not path.segments[k].is_straight else ""
            yield f"{of}leg {k + 1}", f"by ({_numbers(by, 3)}) m in {seconds:g} s{along}"
    workpieces = [obstacle.name for obstacle in scene.all_obstacles if obstacle.workpiece]
    yield "obstacles", ", ".join(obstacle.name for obstacle in scene.all_obstacles) or "none"
    yield "workpieces among them", ", ".join(workpieces) or "none"


def _joints(plan: Plan) -> Iterator[Row]:
    limits, mixed = plan.robot.limits, plan.robot.limits.prismatic.any()
    for i, name in enumerate(plan.robot.joints):
        units = limits.units(i, shown=True)
        low, high = units.factor * limits.lower[i], units.factor * limits.upper[i]
        reach = f"{low:g} to {high:g}" if np.isfinite([low, high]).all() else "unbounded"
        rates = (units.factor * bound[i] for bound in (limits.velocity, limits.acceleration, limits.jerk))
        row = (reach, *(f"{value:.4g}" for value in (*rates, limits.torque[i])))
        names = (units.position, units.velocity, units.acceleration, units.jerk, units.torque)
        yield name, *(f"{text} {unit}" if mixed else text for text, unit in zip(row, names, strict=True))


def _options(options: Any) -> Iterator[Row]:
    for name, value in asdict(options).items():
        yield name, ", ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else str(value)


def _numbers(values: Iterable[float], digits: int) -> str:
    return ", ".join(f"{float(value):z.{digits}f}" for value in values)
