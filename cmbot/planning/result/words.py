"""Sentences about a plan, made of its notes: the one place that has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import inf
from typing import Any

import numpy as np

from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted
from cmbot.hold import MAGNET_PRESSURE
from cmbot.planning.certification.check import Check
from cmbot.planning.result.judgement import SAME, bound_use
from cmbot.planning.result.notes import Note, notes
from cmbot.planning.result.plan import Plan

MOST_FIRST = 5
"""Sentences that are printed first, at most."""

# A peak lower by less than this share is hardly a gain.
_SMALL_GAIN_SHARE = 1e-2
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
    """Return at most five sentences: the tool, the feet, the base, what would help, what is missing.

    Parameters
    ----------
    plan : Plan
    """
    each = notes(plan)
    first = {note.key: sentence(note) for note in each if note.level == "first"}
    missing = [sentence(note) for note in each if note.level == "fault"][:1]
    if missing or len(first) > MOST_FIRST:
        del first["promise"]
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
    return words.format(**note.values) if isinstance(words, str) else words(**note.values)


def left_out(plan: Plan) -> str:
    """Return in words what of the rasters is not reached; empty where nothing is left out.

    Parameters
    ----------
    plan : Plan
    """
    area, unreached = (
        sum(getattr(one, name) for one in plan.coverage.values()) for name in ("area", "unreached")
    )
    return f"{unreached:.3g} of {area:.3g} m2 are not reached" if unreached else ""


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


def _tool(
    within_mm: float,
    probability: float,
    part: str | None,
    part_share: float,
    kept: bool | None,
    share: float,
    across_mm: float | None,
    along_axis_mm: float | None,
) -> str:
    text = f"The tool is within {within_mm:.3g} mm of its path with {100 * probability:g} %"
    if kept is not None:
        asked = [f"{across_mm:g} mm across"] if across_mm is not None else []
        asked += [f"{along_axis_mm:g} mm along the tool's axis"] if along_axis_mm is not None else []
        text += f", tolerance {' and '.join(asked)}: {'kept' if kept else 'not kept'} (within it in "
        text += f"{100 * share:.3g} % of cases, asked {100 * probability:.3g} %)"
    if part is None:
        return f"{text}."
    return f"{text}; largest part: {part}, {100 * part_share:.0f} % of the mean square."


def _needed(needed_kn: float, mode: str, pressure_mpa: float, **_: Any) -> str:
    beyond = ", beyond any magnet" if 1e6 * pressure_mpa > MAGNET_PRESSURE else ""
    return f"an adhesion of {needed_kn:.2f} kN ({mode}), {pressure_mpa:.2f} MPa{beyond}"


def _holds(
    quantity: str, use: float, when: str, time: float, stop_kn: float | None, less: str = "", **values: Any
) -> str:
    text = f"Hold: {quantity} included, uses {100 * use:.0f} % of what that allows, {when}, at {time:.1f} s"
    if values.get("has_kn") is not None:
        with_less = {
            "with safety": "it holds",
            "without safety": "it holds without the safety factor",
            "not": "it does not hold",
        }
        text += f"; the feet need {_needed(**values)} and have {values['has_kn']:.2f} kN"
        text += f", with {100 * values['lost']:.0f} % less {with_less[less]}"
    return f"{text}; an emergency stop needs {stop_kn:.2f} kN." if stop_kn is not None else f"{text}."


def _unknown_hold(stop_kn: float | None, welded: bool, **values: Any) -> str:
    text = "Hold: what the feet bear is not given, so nothing here says whether they hold"
    if welded:
        text = "Hold: welded is assumed, so nothing here says whether the feet hold"
    if "needed_kn" in values:
        text += f"; {'as magnets they would' if welded else 'they'} need {_needed(**values)}"
    return f"{text}, in an emergency stop {stop_kn:.2f} kN." if stop_kn is not None else f"{text}."


def _base(
    base: str,
    peak_nm: float,
    work_nm: float | None,
    baseline_nm: float | None,
    baseline_work_nm: float | None,
    faults: str,
    work_faults: str,
    further: float,
    rest: str | None,
    when: str = "",
    time: float = 0.0,
) -> str:
    where = f"at rest in the posture in which the arm {rest}" if rest else f"{when}, at {time:.1f} s"
    text = f"The {base} must bear {peak_nm:.1f} Nm over the whole job ({where})"
    if baseline_nm is not None and faults:
        text += f"; no gain is stated, as the baseline ({baseline_nm:.1f} Nm) {faults}"
    elif baseline_nm is not None:
        text, gain = f"{text}, {_against(peak_nm, baseline_nm)}", 1 - peak_nm / baseline_nm
        if SAME < gain < _SMALL_GAIN_SHARE:
            text += ": hardly anything is gained"
        elif _SMALL_GAIN_SHARE <= gain < _COSTED_GAIN_SHARE and further >= _TRAVEL_FACTOR:
            text += f", with joints that travel {further:.1f} times as far at work"
    if work_nm is not None:
        text += f"; the work alone {work_nm:.1f} Nm"
        if baseline_work_nm is not None:
            # It may be in its free moves alone that the baseline breaks a limit.
            compared = faults and not work_faults
            before = f"(baseline {baseline_work_nm:.1f} Nm)"
            text += f", {_against(work_nm, baseline_work_nm)}" if compared else f" {before}"
    return f"{text}."


def _against(peak: float, baseline: float) -> str:
    change = peak / baseline - 1.0 if baseline else inf
    if abs(change) <= SAME:
        return "as much as the baseline"
    more = "more" if change > 0 else "less"
    return f"{100 * abs(change):.1f} % {more} than the baseline's {baseline:.1f} Nm"


def _promise(when: str, limit: str, **values: Any) -> str:
    check = Check(limit=Limit(limit), **values)
    factor, unit, room = 1.0, check.unit, ""
    if unit.startswith("rad"):
        factor, unit = float(np.rad2deg(1.0)), f"deg{unit.removeprefix('rad')}"
    elif unit == "m":
        factor, unit = 1e3, "mm"
    if not unit.startswith("of "):
        distance = f"{factor * abs(check.bound - check.value):.3g} {unit}"
        room = f" ({distance} left)" if check.holds else f" ({distance} beyond it)"
    return f"Tightest promise: {promised(check, f'{when}, at {check.time:.1f} s')}{room}."


def _bent_by(pushed: bool) -> str:
    return f"ent by its own weight{' and the process force' if pushed else ''} the "


def _away(turned_deg: float, slid_m: float) -> str:
    """How far joints of each kind are moved at most before the work."""
    each = [f"{turned_deg:.1f} deg"] if turned_deg or not slid_m else []
    return f"up to {' and '.join([*each, *([f'{slid_m:.3f} m'] if slid_m else [])])} a joint"


def _other_start(reason: str, tried: int, posture: str, turned_deg: float, slid_m: float, **_: Any) -> str:
    other = "Another one" if tried == 1 else f"The last of {tried} others tried"
    return (
        f"Starts elsewhere: from the scene's posture, {reason}. {other} with the same tool pose leads to the "
        f"end, {posture}, {_away(turned_deg, slid_m)} away. Bring the arm there first."
    )


def _sagging_start(turned_deg: float, slid_m: float, **values: Any) -> str:
    return (
        f"Starts in the {values['from']}, with the sag compensated: {_away(turned_deg, slid_m)} from it, so "
        "that the bent arm's tool is where the path begins."
    )


def _start(begin: str) -> Callable[..., str]:
    def words(posture: str, turned_deg: float, slid_m: float, **_: Any) -> str:
        return f"Starts {begin} {posture}, {_away(turned_deg, slid_m)} away."

    return words


def _objective(
    name: str,
    own: bool,
    magnets: bool,
    about: str | None,
    weights: tuple[float, ...] | None,
    unit: str,
    before: float | None,
    after: float,
    faults: str,
) -> str:
    what = f"the tool's {name}"
    if name == "travel" and not own:
        return "Minimised: the travel of the joints and their jerk, nothing of the base."
    if own:
        what = name
    elif name == "sway":
        what = "the tool's sway by 1 m/s2 of the deck"
    elif name == "hold":
        what = "the adhesion that the feet need" if magnets else "the pull of magnets in place of the clamps"
    elif weights is not None:
        what = f"the torque about the {about}, axes weighted {', '.join(f'{w:g}' for w in weights)}"
    if before is None:
        return f"Minimised: {what}, to a peak of {after:.2f} {unit}".rstrip() + "."
    which = f", which {faults}," if faults else ""
    peaks = [f"{value:.2f} {unit}".rstrip() for value in (before, after)]
    return f"Minimised: {what}, from a peak of {peaks[0]} in the baseline{which} to {peaks[1]}."


def _no_gain(near: bool) -> str:
    why = " The baseline is near the lower bound already: there is nothing to gain." if near else ""
    return f"Hardly anything is gained at the peak; what the plan adds is that limits are kept.{why}"


def _return(to: str, lacks_stow: bool, moves: bool) -> str:
    named = {"stow": "where it started" if lacks_stow else "its stow posture", "start": "where it started"}
    why = " (its SRDF has no group state stow)" if lacks_stow else ""
    if not moves:
        return f"The work ends in the posture to which the arm is to return{why}."
    return f"Return: after the work the arm goes to {named.get(to, f'its state {to}')}{why}."


def _bound(
    proven: bool,
    closed: bool,
    value: float,
    error: float,
    unit: str,
    basis: str,
    gap: float | None,
    any_start: bool,
    before_sag: bool,
) -> str:
    name = "Lower bound for any start" if any_start else "Lower bound"
    if before_sag:
        # The postures that were sought hold the rigid tool on the path; those of the plan, the bent one.
        name += ", of the path before the sag is compensated"
    least, room = f"{value:.2f} {unit}".rstrip(), f"{error:.3f} {unit}".rstrip()
    above = "" if gap is None else f"; the peak is {100 * gap:+.3f} % from it"
    if not closed:
        return f"{name}, not closed: {least} was found, but the search ended with {room} open{above}."
    found = "has" if proven else "was found with"
    return (
        f"{name}: no plan within the limits {found} a static peak below {least} ({basis}; error {room})"
        f"{above}."
    )


def _certified(checks: int, text: str) -> str:
    holds = "check holds" if checks == 1 else "checks hold"
    return (
        f"Certified: {checks} {holds}, computed again from the finished motion by code that the optimiser "
        f"does not use; at all times of the job {text}."
    )


def _seconds(path: float, optimise: float, certify: float, total: float, passes: int) -> str:
    return (
        f"Time: path {path:.2f} s, optimisation {optimise:.2f} s ({counted(passes, 'pass', 'passes')}), "
        f"free moves and certificates {certify:.2f} s, in all {total:.2f} s."
    )


_SENTENCES: dict[str, str | Callable[..., str]] = {
    "tool": _tool,
    "rigid_tool": "The tool is within {within_mm:.3g} mm of its path, as the rigid arm has it.",
    "holds": _holds,
    "unknown_hold": _unknown_hold,
    "base": _base,
    "promise": _promise,
    "help": "With {remedy} the tool would be within {within_mm:.3g} mm.",
    "unreached": (
        "{unreached_m2:.3g} of {area_m2:.3g} m2 are not reached: where no posture goes on, rows are cut; "
        "raster.cover: all refuses such a plan."
    ),
    "off_path": lambda off_mm, allowed_mm, pushed, **_: (
        f"B{_bent_by(pushed)}tool is up to {off_mm:.2f} mm off its path, more than max_tool_deviation_m "
        f"({allowed_mm:g} mm), which the rigid arm keeps."
    ),
    "too_soft": lambda pushed, base, **_: (
        f"NOT STIFF ENOUGH: b{_bent_by(pushed)}arm on its {base} has no stable equilibrium."
    ),
    "unused_start": "A better start was found, but is not used: {reason}.",
    "other_start": _other_start,
    "sagging_start": _sagging_start,
    "path_start": _start("where the tool path begins, in the posture"),
    "better_start": _start("in a better posture with the same tool pose (start: free),"),
    "fallback": "{text}",
    "robot": "{text}",
    "stiffness": "{text}",
    "units": "Numbers of {of} look like {looks}; they were taken as {units}.",
    "no_gravity": (
        "Gravity has no part in what was minimised: at rest that is 0 everywhere, so no posture was chosen "
        "by it. axis_weights with x or y above 0 count gravity's torque, too."
    ),
    "objective": _objective,
    "baseline": "The baseline {faults}: it is shown for comparison and is no plan, and no gain is stated.",
    "approach": "The approach loads the {base} more than the work does.",
    "travel": (
        "At work the joints travel {factor:.1f} times as far as the baseline's, most of all {joint}, "
        "{far:.3g} {unit} in place of {other:.3g} {unit}: by self-motion, which lowers the torque."
    ),
    "jerk": lambda factor, share: (
        f"The joints jerk {factor:.1f} times as hard as the baseline's, {100 * share:.0f} % of a limit: tool "
        "and base may sway more."
    ),
    "higher": lambda share: (
        f"The peak is {100 * share:.2f} % higher than the baseline's, which does not have to keep limits, "
        "clearances or rest at both ends."
    ),
    "no_gain": _no_gain,
    "return": _return,
    "bound": _bound,
    "certified": _certified,
    "seconds": _seconds,
}
