"""The results of a search among stances: in words, and as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from cmbot.common.reading.validation import counted
from cmbot.stances.bounds import NO_FIGURES, StanceFigures
from cmbot.stances.candidates import Candidate
from cmbot.stances.ranking import StanceRanking
from cmbot.stances.search import StanceResult
from cmbot.stances.stages import PROVEN_SHARE

_Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

_PLACE_COLUMNS = (
    *("foot_1_member", "foot_1_along_m", "foot_1_face", "foot_1_turn_deg"),
    *("foot_2_member", "foot_2_along_m", "foot_2_face", "foot_2_turn_deg"),
    *("x", "y", "z", "climb_1_deg", "climb_2_deg", "climb_3_deg", "climb_4_deg", "climb_5_deg", "reason"),
)
_TABLE_COLUMNS = (
    *("group", "strokes", "rank", "status", "judged_by", "bound", "proven_bound", "planned"),
    *("torque_at_rest", "adhesion_at_rest", "planned_torque", "job_torque", "planned_adhesion"),
    *("sag_mm", "first_hz", "sway_mm_per_m_s2", "holding_nm", "holding_of_effort", "travel_deg"),
    *("seconds", "within_mm"),
    *_PLACE_COLUMNS,
)
_ENDED = {
    "out of reach": "{} out of reach",
    "no posture": "{} in which no posture within the bounds of joints and feet was found",
    "blocked": "{} found blocked",
    "screened": "{} that were only screened",
    "planned": "{} planned",
    "failed": "{} of which planning failed",
    "beyond a bound": "{} that exceed a bound",
}
_LEFT_OUT_BY = {
    "postures": "by sampled postures, obstacles left out",
    "clearance": "by sampled postures, obstacles left out",
    "obstacles": "by charts at some via-points, obstacles included",
    "charts": "by charts at all via-points, obstacles included",
}


def in_words(ranking: StanceRanking) -> Iterator[str]:
    """Yield what was found, a sentence or two each, the best stance first."""
    ranked, best = ranking.ranked, ranking.best
    if best is None:
        promising = ": the scene has the most promising one by its bound; it may be blocked"
        yield f"No stance was planned{'' if ranking.plans else promising}."
        if (near := ranking.nearest) is not None and near.rejection is not None:
            yield f"Nearest to what is allowed: {near.place}, {near.rejection.reason}."
    else:
        yield from _best_in_words(ranking, best)
    yield from _own_in_words(ranking)
    if limit := ranking.sag_limit:
        most = f"{limit.most_mm:.3g} mm, {limit.source}"
        yield f"Other stances that sag by more than {most}, are left out (--any-sag: none is)."
    if ranking.ended_by:
        by = {"time": "its time was over (--time-limit)", "interrupt": "it was stopped"}[ranking.ended_by]
        kept = "what was planned until then is kept, and others may be better" if best is not None else ""
        yield f"The search ended early, as {by}{f': {kept}' if kept else ''}."
    counts = {status: ranking.count(status) for status in _ENDED}
    ended = (words.format(counts[status]) for status, words in _ENDED.items() if counts[status])
    yield f"{len(ranked)} stances: {', '.join(ended)}."
    if reasons := ranking.reasons:
        each = "; ".join(f"{cause}, {number}" for cause, number in reasons)
        yield f"Stances are left out most often for: {each}."


def _best_in_words(ranking: StanceRanking, best: StanceResult) -> Iterator[str]:
    """What the best stance asks, and how much better another one may be."""
    ranked, unit, peak = ranking.ranked, ranking.unit, best.value
    figures = ", ".join(f"{words} {value}" for words, value in _figures(best.figures))
    yield (
        f"Best of those planned: {best.place}, {peak:.4g} {unit} at work, its bound {best.bound:.4g} {unit}; "
        f"{figures}."
    )
    least = ranking.best_unplanned
    if np.isfinite(least):
        first = min((each for each in ranked if each.status == "screened"), key=lambda each: each.bound)
        more = 1 - least / peak if peak > 0 else 0.0
        # Charts are by the sag then.
        stage = "postures" if ranking.objective == "sway" else first.stage
        by = f"by more than {100 * more:.1f} %" if more > 0 else "than the best one"
        yield (
            f"No stance that was not planned has a bound below {least:.4g} {unit} (estimate, "
            f"{_LEFT_OUT_BY[stage]}): none may be better {by}."
        )
    if ranking.proven > ranking.count("out of reach"):
        others = len(ranked) - ranking.count("planned")
        rest = (
            f"; of {left} that is an estimate, which is no proof" if (left := others - ranking.proven) else ""
        )
        yield (
            f"Of the {others} others {ranking.proven} are proven to ask {PROVEN_SHARE * peak:.4g} {unit} at "
            f"rest or more, {100 * PROVEN_SHARE:g} % of the best one{rest}."
        )
    failed = [each for each in ranked if each.status == "failed" and each.bound < peak]
    if failed:
        bound = min(each.bound for each in failed)
        yield (
            f"{counted(len(failed), 'stance')} of which planning failed might be better by their bounds, "
            f"from {bound:.4g} {unit}; stances.csv says why."
        )


def _figures(figures: StanceFigures) -> Iterator[tuple[str, str]]:
    """What is said of a plan."""
    if figures.torque is not None:
        yield "torque", f"{figures.torque:.1f} Nm"
    if figures.job_torque is not None:
        yield "over the job", f"{figures.job_torque:.1f} Nm"
    if figures.adhesion is not None:
        yield "adhesion needed", f"{figures.adhesion / 1e3:.2f} kN"
    if figures.sag_mm is not None:
        yield "sag", f"{figures.sag_mm:.2f} mm"
    if figures.first_hz is not None:
        yield "slowest mode", f"{figures.first_hz:.2f} Hz"
    if figures.sway_mm is not None:
        yield "sway", f"{figures.sway_mm:.2f} mm by 1 m/s2 of the deck"


def _own_in_words(ranking: StanceRanking) -> Iterator[str]:
    """What the scenes' own stances ask, and how much better the best one is."""
    several = len(ranking.own) > 1
    for each in ranking.own if ranking.plans else ():
        name = f"The scenes' own stance {each.place}" if several else "The scene's own stance"
        if each.status != "planned":
            why = "the search ended before" if each.rejection is None else each.rejection.reason
            yield f"{name} was not planned: {why}."
        elif each is ranking.best:
            yield f"{name} is the best of those planned."
        elif ranking.best is not None:
            less = 100 * (1 - ranking.best.value / each.value) if each.value > 0 else 0.0
            said = f": the best one asks {less:.1f} % less" if each.value > 0 else ""
            yield f"{name} asks {each.value:.4g} {ranking.unit} at work{said}."


def planned_table(ranking: StanceRanking) -> _Table:
    """Return headings and rows of the stances that were planned: what is certified of them.

    The scenes' own come first, without a rank where they exceed a bound; the others from the best on.
    """
    columns: tuple[tuple[str, Callable[[StanceFigures], float | None], str], ...] = (
        ("torque, Nm", lambda f: f.torque, ".1f"),
        ("over the job", lambda f: f.job_torque, ".1f"),
        ("adhesion needed, kN", lambda f: None if f.adhesion is None else f.adhesion / 1e3, ".2f"),
        ("sag, mm", lambda f: f.sag_mm, ".2f"),
        ("first mode, Hz", lambda f: f.first_hz, ".2f"),
        ("sway, mm per m/s2", lambda f: f.sway_mm, ".2f"),
        ("locked joints hold, Nm", lambda f: f.holding_nm, ".0f"),
        ("of what they drive, %", lambda f: f.holding_of_effort and 100 * f.holding_of_effort, ".0f"),
        ("tool within, mm", lambda f: f.within_mm, ".1f"),
    )
    known = [
        (str(k) if one.status == "planned" else "-", one)
        for k, one in enumerate(ranking.ranked, start=1)
        if one.status == "planned" or (one.own and one.figures is not NO_FIGURES)
    ]
    planned = sorted(known, key=lambda ranked: not ranked[1].own)
    # What none of them has, such as the adhesion that clamps need, has no column.
    shown = [column for column in columns if any(column[1](one.figures) is not None for _, one in planned)]
    rows = [
        (
            rank,
            f"{one.place}{', its own' if one.own else ''}",
            *(_cell(value(one.figures), form) for _, value, form in shown),
        )
        for rank, one in planned
    ]
    return ("", "stance", *(heading for heading, *_ in shown)), rows


def _cell(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def bounds_table(ranking: StanceRanking, most: int) -> _Table:
    """Return headings and rows of the others, the most promising first: their bounds."""
    rows = list[tuple[str, ...]]()
    for rank, each in enumerate(ranking.ranked[:most], start=1):
        if each.status != "planned":
            bound = f"{each.bound:.4g}" if np.isfinite(each.bound) else "-"
            rows.append((str(rank), each.place, each.status, each.stage, bound))
    return ("", "stance", "status", "judged by", f"bound, {ranking.unit}"), rows


def shared_out(rankings: Sequence[StanceRanking]) -> Iterator[str]:
    """Yield which strokes are done from which stance, a sentence each; nothing where all are from one."""
    if len(rankings) == 1:
        return
    strokes = sum(len(each.strokes) for each in rankings)
    yield f"{strokes} strokes from {len(rankings)} stances: no fewer were found to be enough."
    for number, each in enumerate(rankings, start=1):
        yield f"Stance {number}: {', '.join(each.strokes)}; {each.ranked[0].place}."


def stances_csv(rankings: Sequence[StanceRanking]) -> str:
    """Return the ranked table: one row a stance, for each group of strokes; SI units, degrees by name."""
    rows = (
        (number, " ".join(each.strokes), rank, *_cells(one))
        for number, each in enumerate(rankings, start=1)
        for rank, one in enumerate(each.ranked, start=1)
    )
    return "\n".join([",".join(_TABLE_COLUMNS), *(",".join(map(str, row)) for row in rows), ""])


def _cells(each: StanceResult) -> Iterator[object]:
    known = np.isfinite(each.bound)
    planned, rest = each.figures, each.at_rest
    yield from (each.status, each.stage, _number(each.bound if known else None))
    yield _number(each.proven if 0 < each.proven < np.inf else None)
    yield _number(each.value if np.isfinite(each.value) else None)
    yield from (_number(x) for x in (rest.torque, rest.adhesion))
    yield from (_number(x) for x in (planned.torque, planned.job_torque, planned.adhesion))
    for name in ("sag_mm", "first_hz", "sway_mm", "holding_nm", "holding_of_effort"):
        value = getattr(planned, name)
        yield _number(getattr(rest, name) if value is None else value)
    yield from (_number(x) for x in (planned.travel_deg, planned.seconds, planned.within_mm))
    stance = each.candidate.stance if isinstance(each.candidate, Candidate) else None
    for place in (None, None) if stance is None else (stance.foot_1, stance.foot_2):
        yield from (
            ("" if stance is None else "free", "", "", "") if place is None else place.model_dump().values()
        )
    yield from (f"{x:.4f}" for x in each.candidate.root[:3, 3])
    yield from [""] * 5 if stance is None else (f"{x:.4f}" for x in stance.climber_deg or ())
    yield "" if each.rejection is None else each.rejection.reason.replace(",", ";")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
