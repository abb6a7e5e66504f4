"""Sentences about a plan, made of its notes: the one place that has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np

from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted
from cmbot.planning.certification.check import Check
from cmbot.planning.result.judgement import SAME, bound_use
from cmbot.planning.result.notes import Note, notes
from cmbot.planning.result.plan import Plan

MOST_FIRST = 5
"""Sentences that are printed first, at most."""

# A peak lower by less than this share is hardly a gain.
_SMALL_GAIN_SHARE = 1e-2
# What never moves is told of where it adds this share of the peak.
_TOLD_STILL_SHARE = 1e-2
# Of a swing, mm, that is seen, what is fewer times as large is not much calmer.
_CALMER_FACTOR, _SEEN_MM = 2.0, 0.01
# A gain below this share is told with what it costs: joints that travel so many times as far, or more.
_COSTED_GAIN_SHARE, _TRAVEL_FACTOR = 5e-2, 3.0


def verdict(plan: Plan, *, area: bool = True) -> str:
    """Return in a few sentences where the tool is, whether it holds, what the base bears, what would help.

    Parameters
    ----------
    plan : Plan
    area : bool
        Whether it tells what of the rasters is not reached, too; `left_out` does that alone.
    """
    each = notes(plan)
    said = [sentence(note) for note in each if note.level == "first"]
    if area:
        said += [sentence(note) for note in each if note.key == "unreached"]
    return " ".join(said)


def first_remarks(plan: Plan) -> list[str]:
    """Return at most five sentences: tool, feet, base, long free moves, what would help, what is missing.

    Parameters
    ----------
    plan : Plan
    """
    each = notes(plan)
    first = {note.key: sentence(note) for note in each if note.level == "first"}
    missing = [sentence(note) for note in each if note.level == "fault"][:1]
    if len(first) + len(missing) > MOST_FIRST:
        first.pop("free_moves", None)
    return [*first.values(), *missing][:MOST_FIRST]


def remarks(plan: Plan) -> Iterator[str]:
    """Yield the verdict, then what should be known of a plan besides its table, a sentence or two each.

    Parameters
    ----------
    plan : Plan
    """
    yield verdict(plan, area=False)
    for note in notes(plan):
        if note.level != "first":
            yield sentence(note)


def sentence(note: Note) -> str:
    """Return a note in words.

    Parameters
    ----------
    note : Note
    """
    words = _SENTENCES[note.key]
    return words.format(**note.values) if isinstance(words, str) else words(SimpleNamespace(**note.values))


def left_out(plan: Plan) -> str:
    """Return in words what of the rasters is not reached; empty where nothing is left out.

    Parameters
    ----------
    plan : Plan
    """
    whole = plan.whole_coverage
    return f"{whole.unreached:.3g} of {whole.area:.3g} m2 are not reached" if whole.unreached else ""


def promises(plan: Plan) -> str:
    """Return in a sentence whether every promise is kept.

    Parameters
    ----------
    plan : Plan
    """
    each = [check for _, check in plan.job.checks()]
    broken = sum(not check.holds for check in each)
    if broken:
        return f"NOT SAFE: {broken} of {len(each)} promises {'is' if broken == 1 else 'are'} broken."
    return f"Every promise is kept: {counted(len(each), 'check')} hold at all times."


def promised(check: Check, when: str) -> str:
    """Return what a check promises, and how near it is to its bound, in words; `when` as `during` says it."""
    if check.limit is Limit.POSITION and check.holds:
        # A share of how far a joint is from an end of its range says nothing.
        return f"{check.joint} stays within its range {when}"
    return f"{check.quantity} {when}, {100 * bound_use(check):.0f} % of its bound"


def _tool(note: Any) -> str:
    text = f"The tool is within {note.within_mm:.3g} mm of its path with {100 * note.probability:g} %"
    if note.kept is not None:
        asked = [f"{note.across_mm:g} mm across"] if note.across_mm is not None else []
        asked += (
            [f"{note.along_axis_mm:g} mm along the tool's axis"] if note.along_axis_mm is not None else []
        )
        text += f", tolerance {' and '.join(asked)}: {'kept' if note.kept else 'not kept'} (within it in "
        text += f"{100 * note.share:.3g} % of cases, asked {100 * note.probability:.3g} %)"
    else:
        text += " (no tool.tolerance is asked for)"
    if note.part is None:
        return f"{text}."
    by = f", as assumed ({note.assumed})" if note.assumed else ""
    return f"{text}; largest part: {note.part}, {100 * note.part_share:.0f} % of the mean square{by}."


def _needed(note: Any) -> str:
    # What no magnet has is not told by its size.
    after = ", beyond any magnet" if note.beyond_magnets else f": {note.asked}"
    same = note.closed_kn is None or round(note.closed_kn, 2) == round(note.needed_kn, 2)
    closed = "" if same else f" ({note.closed_kn:.2f} kN with gap: none)"
    return f"an adhesion of {note.needed_kn:.2f} kN ({note.mode}), {note.pressure_mpa:.2f} MPa{closed}{after}"


def _holds(note: Any) -> str:
    text = f"Hold: {note.quantity} included, uses {100 * note.use:.0f} % of what that allows, {note.when}"
    text += f", at {note.time:.1f} s"
    if note.locked is not None:
        quantity, use, most, when = note.locked
        text += f"; tighter is the {quantity}, {100 * use:.0f} % of {most:g} Nm, {when}"
    if getattr(note, "has_kn", None) is not None:
        with_less = {
            "with safety": "it holds",
            "without safety": "it holds without the safety factor",
            "not": "it does not hold",
        }
        text += f"; the feet need {_needed(note)}, and have {note.has_kn:.2f} kN"
        text += f", with {100 * note.lost:.0f} % less {with_less[note.less]}"
    return text + ("." if note.stop_kn is None else f"; an emergency stop needs {note.stop_kn:.2f} kN.")


def _unknown_hold(note: Any) -> str:
    text = "Hold: what the feet bear is not given, so nothing here says whether they hold"
    if note.welded:
        text = "Hold: welded is assumed, so nothing here says whether the feet hold"
    if hasattr(note, "needed_kn"):
        text += f"; {'as magnets they would' if note.welded else 'they'} need {_needed(note)}"
    return text + ("." if note.stop_kn is None else f", in an emergency stop {note.stop_kn:.2f} kN.")


def _base(note: Any) -> str:
    where = f"at rest in the posture in which the arm {note.rest}"
    where = where if note.rest else f"{note.when}, at {note.time:.1f} s"
    text = f"The {note.base} must bear {note.peak_nm:.1f} Nm over the whole job ({where})"
    # Free moves of the baseline, as quick as joints can, are no measure of what planning gains.
    is_hasty = note.work_nm is not None and note.baseline_nm is not None
    is_hasty = is_hasty and note.baseline_nm > (1 + SAME) * max(note.baseline_work_nm, note.peak_nm)
    if note.baseline_nm is not None and note.faults:
        text += f"; no gain is stated, as the baseline ({note.baseline_nm:.1f} Nm) {note.faults}"
    elif is_hasty:
        text += f"; the baseline has {note.baseline_nm:.1f} Nm in its free moves, as quick as joints can"
    elif note.baseline_nm is not None:
        text += f", {_against(note.peak_nm, note.baseline_nm)}"
        gain = 1 - note.peak_nm / note.baseline_nm
        if SAME < gain < _SMALL_GAIN_SHARE:
            after, before = note.swings or (0.0, 0.0)
            if before > max(_CALMER_FACTOR * after, _SEEN_MM):
                text += f", but after the stop the tool swings by {after:.3f} in place of {before:.3f} mm"
            else:
                text += ": hardly anything is gained"
        elif _SMALL_GAIN_SHARE <= gain < _COSTED_GAIN_SHARE and note.further >= _TRAVEL_FACTOR:
            text += f", with joints that travel {note.further:.1f} times as far at work"
    if note.work_nm is not None:
        text += f"; the work alone {note.work_nm:.1f} Nm"
        if note.baseline_work_nm is not None:
            # It may be in its free moves alone that the baseline breaks a limit.
            compared = is_hasty if not note.faults else not note.work_faults
            before = f" (baseline {note.baseline_work_nm:.1f} Nm)"
            text += f", {_against(note.work_nm, note.baseline_work_nm)}" if compared else before
    if note.still_nm > _TOLD_STILL_SHARE * note.peak_nm:
        text += f"; the still part adds {note.still_nm:.1f} Nm"
    return f"{text}."


def _against(peak: float, baseline: float) -> str:
    change = peak / baseline - 1.0 if baseline else inf
    if abs(change) <= SAME:
        return "as much as the baseline"
    more = "more" if change > 0 else "less"
    return f"{100 * abs(change):.1f} % {more} than the baseline's {baseline:.1f} Nm"


def _promise(note: Any) -> str:
    values = vars(note) | {"limit": Limit(note.limit)}
    when = values.pop("when")
    check = Check(**values)
    factor, unit, room = 1.0, check.unit, ""
    if unit.startswith("rad"):
        factor, unit = float(np.rad2deg(1.0)), f"deg{unit.removeprefix('rad')}"
    elif unit == "m":
        factor, unit = 1e3, "mm"
    if not unit.startswith("of "):
        distance = f"{factor * abs(check.bound - check.value):.3g} {unit}"
        key = f"robot.range_margin_{'m' if check.unit == 'm' else 'deg'}"
        more = f"; {key} keeps more" if check.limit is Limit.POSITION else ""
        room = f" ({distance} left{more})" if check.holds else f" ({distance} beyond it)"
    return f"Tightest promise: {promised(check, f'{when}, at {check.time:.1f} s')}{room}."


def _bent_by(pushed: bool) -> str:
    return f"ent by its own weight{' and the process force' if pushed else ''} the "


def _away(note: Any) -> str:
    """How far joints of each kind are moved at most before the work."""
    each = [f"{note.turned_deg:.1f} deg"] if note.turned_deg or not note.slid_m else []
    each += [f"{note.slid_m:.3f} m"] if note.slid_m else []
    return f"up to {' and '.join(each)} a joint"


def _other_start(note: Any) -> str:
    other = "Another one" if note.tried == 1 else f"The last of {note.tried} others tried"
    return (
        f"Starts elsewhere: from the scene's posture, {note.reason}. {other} with the same tool pose leads "
        f"to the end, {note.posture}, {_away(note)} away. Bring the arm there first."
    )


def _sagging_start(note: Any) -> str:
    return (
        f"Starts in the {vars(note)['from']}, with the sag compensated: {_away(note)} from it, so that the "
        "bent arm's tool is where the path begins."
    )


def _objective(note: Any) -> str:
    name, what = note.name, f"the tool's {note.name}"
    if name == "travel" and not note.own:
        return "Minimised: the travel of the joints and their jerk, nothing of the base."
    if note.own:
        what = name
    elif name == "sway":
        what = "the tool's sway by 1 m/s2 of the deck"
    elif name == "hold":
        what = "the pull of magnets in place of the clamps"
        what = "the adhesion that the feet need" if note.magnets else what
    elif note.weights is not None:
        weights = ", ".join(f"{weight:g}" for weight in note.weights)
        what = f"the torque about the {note.about}, axes weighted {weights}"
    after = f"{note.after:.2f} {note.unit}".rstrip()
    if note.before is None:
        return f"Minimised: {what}, to a peak of {after}."
    which = f", which {note.faults}," if note.faults else ""
    before = f"{note.before:.2f} {note.unit}".rstrip()
    return f"Minimised: {what}, from a peak of {before} in the baseline{which} to {after}."


def _no_gain(note: Any) -> str:
    why = " The baseline is near the lower bound already: there is nothing to gain." if note.near else ""
    return f"Hardly anything is gained at the peak; what the plan adds is that limits are kept.{why}"


def _return(note: Any) -> str:
    why = " (its SRDF has no group state stow)" if note.lacks_stow else ""
    if not note.moves:
        return f"The work ends in the posture to which the arm is to return{why}."
    start = "where it started"
    named = {"stow": start if note.lacks_stow else "its stow posture", "start": start}
    return f"Return: after the work the arm goes to {named.get(note.to, f'its state {note.to}')}{why}."


def _bound(note: Any) -> str:
    name = "Lower bound for any start" if note.any_start else "Lower bound"
    if note.before_sag:
        # The postures that were sought hold the rigid tool on the path; those of the plan, the bent one.
        name += ", of the path before the sag is compensated"
    least, room = f"{note.value:.2f} {note.unit}".rstrip(), f"{note.error:.3f} {note.unit}".rstrip()
    above = "" if note.gap is None else f"; the peak is {100 * note.gap:+.3f} % from it"
    if above and note.over_sequences is not None:
        above += f", {100 * note.over_sequences:+.3f} % from the least of sequences of postures (estimate)"
    if not note.closed:
        return f"{name}, not closed: {least} was found, but the search ended with {room} open{above}."
    found = "has" if note.proven else "was found with"
    peak = f"a static peak below {least} ({note.basis}; error {room})"
    return f"{name}: no plan within the limits {found} {peak}{above}."


def _certified(note: Any) -> str:
    holds = "check holds" if note.checks == 1 else "checks hold"
    return (
        f"Certified: {note.checks} {holds}, computed again from the finished motion by code that the "
        f"optimiser does not use; at all times of the job {note.text}."
    )


_SENTENCES: dict[str, str | Callable[..., str]] = {
    "tool": _tool,
    "rigid_tool": "The tool is within {within_mm:.3g} mm of its path, as the rigid arm has it.",
    "holds": _holds,
    "unknown_hold": _unknown_hold,
    "base": _base,
    "free_moves": lambda note: (
        f"Free moves take {note.seconds:.0f} of {note.total:.0f} s: the longest, {note.which}, is bounded by "
        f"the {note.by or 'slowest mode or by what base, feet and joints bear'}"
        f"{f'; start: {{{note.start}}} needs hardly any approach' if note.start else ''}"
        f"{f'; --set start=pinned begins in the {note.pinned}' if note.pinned else ''}"
        f"{', and may load the base more' if note.pinned else ''}."
    ),
    "promise": _promise,
    "help": lambda note: (
        f"With {note.remedy} the tool would be within {note.within_mm:.3g} mm"
        f"{f'; largest part then: {note.then}' if note.then else ''}."
    ),
    "unreached": (
        "{unreached_m2:.3g} of {area_m2:.3g} m2 are not reached: where no posture goes on, rows are cut; "
        "raster.cover: all refuses such a plan.{likely}"
    ),
    "off_path": lambda note: (
        f"B{_bent_by(note.pushed)}tool is up to {note.off_mm:.2f} mm off its path, more than "
        f"max_tool_deviation_m ({note.allowed_mm:g} mm), which the rigid arm keeps."
    ),
    "deviates": (
        "The bent tool is up to {off_mm:.2f} mm off its path, the baseline's {without_mm:.2f} mm: between "
        "via-points it may leave the path by max_tool_deviation_m ({allowed_mm:g} mm), which the motion uses."
    ),
    "too_soft": lambda note: (
        f"NOT STIFF ENOUGH: b{_bent_by(note.pushed)}arm on its {note.base} has no stable equilibrium."
    ),
    "unused_start": "A better start was found, but is not used: {reason}.",
    "other_start": _other_start,
    "sagging_start": _sagging_start,
    "path_start": lambda note: (
        f"Starts where the tool path begins, in the posture {note.posture}, {_away(note)} away."
    ),
    "better_start": lambda note: (
        f"Starts in {'a better' if note.better else 'another'} posture with the same tool pose (start: "
        f"free), {note.posture}, {_away(note)} away, which takes {note.seconds:.1f} s; start: pinned stays "
        "where the arm is."
    ),
    "fallback": "{text}",
    "robot": "{text}",
    "stiffness": "{text}",
    "units": "Numbers of {of} look like {looks}; they were taken as {units}.",
    "slid": (
        "{joint} slides from {low:.3g} to {high:.3g} m, but the {base} bends the same everywhere: state how "
        "it bends where it is softest."
    ),
    "no_gravity": (
        "Gravity has no part in what was minimised: at rest that is 0 everywhere, so no posture was chosen "
        "by it. axis_weights with x or y above 0 count gravity's torque, too."
    ),
    "faces": lambda note: f"{'; '.join(f'Faces of {k}, {v}' for k, v in note.found.items())}.",
    "objective": _objective,
    "baseline": "The baseline {faults}: it is shown for comparison and is no plan, and no gain is stated.",
    "approach": "The approach loads the {base} more than the work does.",
    "travel": (
        "At work the joints travel {factor:.1f} times as far as the baseline's, most of all {joint}, "
        "{far:.3g} {unit} in place of {other:.3g} {unit}: by self-motion, which lowers the torque."
    ),
    "jerk": lambda note: (
        f"The joints jerk {note.factor:.1f} times as hard as the baseline's, {100 * note.share:.0f} % of a "
        "limit: tool and base may sway more."
    ),
    "higher": lambda note: (
        f"The peak is {100 * note.share:.2f} % higher than the baseline's, which does not have to keep "
        "limits, clearances or rest at both ends."
    ),
    "no_gain": _no_gain,
    "return": _return,
    "bound": _bound,
    "certified": _certified,
    "seconds": lambda note: (
        f"Time: path {note.path:.2f} s, optimisation {note.optimise:.2f} s "
        f"({counted(note.passes, 'pass', 'passes')}), free moves and certificates {note.certify:.2f} s, in "
        f"all {note.total:.2f} s."
    ),
}
