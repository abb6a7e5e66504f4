"""The results of a search among stances: in words, and as a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from cmbot.common.validation import counted
from cmbot.planning import Plan
from cmbot.stances.search import Stood
from cmbot.stances.standing import Standing

_Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

_COLUMNS = (
    *(
        "group",
        "strokes",
        "rank",
        "status",
        "judged_by",
        "bound",
        "planned",
        "torque_at_rest",
        "adhesion_at_rest",
    ),
    *(
        "planned_torque",
        "planned_adhesion",
        "foot_1_member",
        "foot_1_along_m",
        "foot_1_face",
        "foot_1_turn_deg",
    ),
    *("foot_2_member", "foot_2_along_m", "foot_2_face", "foot_2_turn_deg", "x", "y", "z"),
    *("climb_1_deg", "climb_2_deg", "climb_3_deg", "climb_4_deg", "climb_5_deg", "reason"),
)
_ENDED = {
    "out of reach": "{} out of reach",
    "no posture": "{} in which no posture within the bounds of joints and feet was found",
    "blocked": "{} found blocked",
    "screened": "{} that were only screened",
    "planned": "{} planned",
    "failed": "{} of which planning failed",
    "too much torque": "{} that load the guardrail with more than is allowed",
}
_JUDGED = {
    "reach": "the reach of the links: {}",
    "postures": "sampled postures within the bounds of joints, feet and joint velocities: {}",
    "obstacles": "obstacles and charts at some via-points: {}",
    "charts": "charts at all via-points: {}",
    "plan": "plans: {}",
}
_LEFT_OUT_BY = {
    "postures": "by sampled postures, obstacles left out",
    "obstacles": "by charts at some via-points, obstacles included",
    "charts": "by charts at all via-points, obstacles included",
}


def in_words(standing: Standing) -> Iterator[str]:
    """Yield what was found, a sentence or two each, the best stance first."""
    ranked, best = standing.ranked, standing.best
    if best is None or best.plan is None:
        promising = ": the scene has the most promising one by its bound; it may be blocked"
        yield f"No stance was planned{'' if standing.plans else promising}."
    else:
        yield from _best_in_words(standing, best, best.plan)
    yield from _own_in_words(standing)
    if standing.ended_by:
        by = {"time": "its time was over (--time-limit)", "interrupt": "it was stopped"}[standing.ended_by]
        kept = "what was planned until then is kept, and others may be better" if best is not None else ""
        yield f"The search ended early, as {by}{f': {kept}' if kept else ''}."
    ended = {status: standing.count(status) for status in _ENDED}
    yield f"{len(ranked)} stances: {_counted(ended, _ENDED)}."
    judged = {name: sum(each.judged == name for each in ranked) for name in _JUDGED}
    yield f"Judged by {_counted(judged, _JUDGED)}."
    if reasons := standing.reasons:
        each = "; ".join(f"{cause}, {number}" for cause, number in reasons)
        yield f"Stances are left out most often for: {each}."


def _best_in_words(standing: Standing, best: Stood, plan: Plan) -> Iterator[str]:
    """What the best stance asks, and how much better another one may be."""
    ranked, unit = standing.ranked, standing.unit
    peak, figures = plan.objective.planned_peak, plan.figures
    needed = figures.adhesion_needed
    also = "" if needed is None else f", adhesion needed {needed.peak / 1e3:.2f} kN ({needed.mode})"
    yield (
        f"Best of those planned: {best.place}, {peak:.1f} {unit} at work, its bound {best.bound:.1f} {unit}; "
        f"torque {figures.peak_guardrail_torque:.1f} Nm{also}."
    )
    least = standing.best_unplanned
    if np.isfinite(least):
        more = 1 - least / peak if peak > 0 else 0.0
        by = f"by more than {100 * more:.1f} %" if more > 0 else "than the best one"
        yield (
            f"No stance that was not planned has a bound below {least:.1f} {unit} (estimate, "
            f"{_LEFT_OUT_BY[_judged_least(ranked)]}): none may be better {by}."
        )
    failed = [each for each in ranked if each.status == "failed" and each.bound < peak]
    if failed:
        bound = min(each.bound for each in failed)
        yield (
            f"{counted(len(failed), 'stance')} of which planning failed might be better by their bounds, "
            f"from {bound:.1f} {unit}; stances.csv says why."
        )


def _own_in_words(standing: Standing) -> Iterator[str]:
    """What the scenes' own stances ask, and how much better the best one is."""
    several = len(standing.own) > 1
    for each in standing.own if standing.plans else ():
        name = f"The scenes' own stance {each.place}" if several else "The scene's own stance"
        if each.plan is None:
            yield f"{name} was not planned: {each.reason or each.cause or 'the search ended before'}."
        elif each is standing.best:
            yield f"{name} is the best of those planned."
        elif standing.best is not None and standing.best.plan is not None:
            own, best = (one.objective.planned_peak for one in (each.plan, standing.best.plan))
            less = f": the best one asks {100 * (1 - best / own):.1f} % less" if own > 0 else ""
            yield f"{name} asks {own:.1f} {standing.unit} at work{less}."


def _counted(counts: Mapping[str, int], words: Mapping[str, str]) -> str:
    """Return the words for all numbers but zero."""
    return ", ".join(said.format(counts[name]) for name, said in words.items() if counts[name])


def _judged_least(ranked: Sequence[Stood]) -> str:
    """By what the stance of the smallest bound that was not planned was judged."""
    waiting = (each for each in ranked if each.status == "screened")
    return min(waiting, key=lambda each: each.bound).judged


def planned_table(standing: Standing) -> _Table:
    """Return headings and rows of the stances that were planned: what is certified of their work."""
    rows = list[tuple[str, ...]]()
    for rank, each in enumerate(standing.ranked, start=1):
        if each.plan is not None:
            figures = each.plan.figures
            needed = figures.adhesion_needed
            adhesion = "-" if needed is None else f"{needed.peak / 1e3:.2f}"
            rows.append((str(rank), each.place, f"{figures.peak_guardrail_torque:.1f}", adhesion))
    headings = ("", "stance", "torque, Nm", "adhesion needed, kN")
    if all(adhesion == "-" for *_, adhesion in rows):  # clamps need none
        return headings[:-1], [row[:-1] for row in rows]
    return headings, rows


def bounds_table(standing: Standing, most: int) -> _Table:
    """Return headings and rows of the others, the most promising first: their bounds, which are estimates."""
    rows = list[tuple[str, ...]]()
    for rank, each in enumerate(standing.ranked[:most], start=1):
        if each.plan is None:
            bound = f"{each.bound:.1f}" if np.isfinite(each.bound) else "-"
            rows.append((str(rank), each.place, each.status, each.judged, bound))
    return ("", "stance", "status", "judged by", f"bound, {standing.unit}"), rows


def shared_out(standings: Sequence[Standing]) -> Iterator[str]:
    """Yield which strokes are done from which stance, a sentence each; nothing where all are from one."""
    if len(standings) == 1:
        return
    strokes = sum(len(each.strokes) for each in standings)
    yield f"{strokes} strokes from {len(standings)} stances: no fewer were found to be enough."
    for number, each in enumerate(standings, start=1):
        yield f"Stance {number}: {', '.join(each.strokes)}; {each.ranked[0].place}."


def stances_csv(standings: Sequence[Standing]) -> str:
    """Return the ranked table: one row a stance, for each group of strokes; SI units, degrees by name."""
    rows = (
        (number, " ".join(each.strokes), rank, *_cells(one))
        for number, each in enumerate(standings, start=1)
        for rank, one in enumerate(each.ranked, start=1)
    )
    return "\n".join([",".join(_COLUMNS), *(",".join(map(str, row)) for row in rows), ""])


def _cells(each: Stood) -> Iterator[object]:
    stance = each.candidate.stance
    yield from (each.status, each.judged)
    planned, torque, adhesion = "", "", ""
    if each.plan is not None:
        planned = f"{each.plan.objective.planned_peak:.6g}"
        torque = f"{each.plan.figures.peak_guardrail_torque:.6g}"
        needed = each.plan.figures.adhesion_needed
        adhesion = "" if needed is None else f"{needed.peak:.6g}"
    bound = f"{each.bound:.6g}" if np.isfinite(each.bound) else ""
    rest = [f"{each.torque:.6g}", f"{each.adhesion:.6g}"] if bound else ["", ""]
    yield from (bound, planned, *rest, torque, adhesion)
    for place in (stance.foot_1, stance.foot_2):
        yield from ("free", "", "", "") if place is None else place.model_dump().values()
    yield from (f"{x:.4f}" for x in each.candidate.root[:3, 3])
    yield from (f"{x:.4f}" for x in stance.climber_deg or ())
    yield each.reason.replace(",", ";")
