"""The results of a search among stances: in words, and as a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from cmbot.common.reading.validation import counted
from cmbot.scene import FootholdFile
from cmbot.stances.bounds import COLUMNS, NO_FIGURES
from cmbot.stances.candidates import Candidate
from cmbot.stances.ranking import StanceRanking
from cmbot.stances.search import PROVEN_SHARE, STATUSES, StanceResult

_Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

# What is told of a plan in a sentence: so many of the columns.
_TOLD_COLUMNS = 8


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
    wanted = ranking.ended_by or ranking.count("planned") <= ranking.plans
    if wanted and (closest := ranking.closest_in_time):
        yield f"{closest[0].upper()}{closest[1:]}."
    if limit := ranking.sag_limit:
        most = f"{limit.most_mm:.3g} mm, {limit.source}"
        yield f"Other stances that sag by more than {most}, are left out (--any-sag: none is)."
    if ranking.ended_by:
        by = {"time": "its time was over (--time-limit)", "interrupt": "it was stopped"}[ranking.ended_by]
        kept = ": what was planned until then is kept" if best is not None else ""
        others = (
            ", and others may be better" if best is not None and ranking.best_unplanned < best.value else ""
        )
        yield f"The search ended early, as {by}{kept}{others}."
    ended = (f"{number} {status}" for status in STATUSES if (number := ranking.count(status)))
    yield f"{len(ranked)} stances: {', '.join(ended)}."
    stances = (each.candidate.stance for each in ranked if isinstance(each.candidate, Candidate))
    if faces := sorted({place.face for stance in stances for place in stance.held}):
        yield f"Feet were tried on these faces alone: {', '.join(faces)}."
    if ranking.reasons:
        yield f"Stances are left out most often for: {ranking.reasons_in_words}."
    yield from (f"{remedy[0].upper()}{remedy[1:]}." for remedy in ranking.remedies)


def _best_in_words(ranking: StanceRanking, best: StanceResult) -> Iterator[str]:
    """What the best stance asks, and how much better another one may be."""
    ranked, unit, peak = ranking.ranked, ranking.unit, best.value
    which = "Best of those" if ranking.count("planned") > 1 else "The only one"
    told = ((column.words, column.told(best.figures), column.unit) for column in COLUMNS[:_TOLD_COLUMNS])
    figures = ", ".join(f"{words} {value} {unit}" for words, value, unit in told if value is not None)
    yield (
        f"{which} planned: {best.place}, {peak:.4g} {unit} {ranking.when}, its bound {best.bound:.4g} "
        f"{unit}; {figures}."
    )
    yield from _kinds_left(best)
    least = ranking.best_unplanned
    if np.isfinite(least):
        first = min(ranking.waiting, key=lambda each: each.bound)
        more = 1 - least / peak if peak > 0 else 0.0
        # Charts are by the sag then.
        stage = "postures" if ranking.objective == "sway" else first.stage
        may = f"another one may be up to {100 * more:.1f} % better" if more > 0 else "none is better"
        yield (
            f"The least bound of a stance that was not planned is {least:.4g} {unit} "
            f"(judged by its {stage}): by that estimate {may}."
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
    if failed := [each.bound for each in ranked if each.status == "failed" and each.bound < peak]:
        many, bound = counted(len(failed), "stance"), f"from {min(failed):.4g} {unit}"
        yield f"{many} of which planning failed might be better, {bound}; stances.csv says why."


def _kinds_left(best: StanceResult) -> Iterator[str]:
    """By which kinds of hold the feet bear the job."""
    needed = None if best.plan is None else best.plan.job.figures.adhesion_needed
    holding = None if best.plan is None else best.plan.robot.holding
    if needed is not None and holding is not None:
        said = holding.kinds_left(needed, "the whole job in this stance")
        yield f"{said[0].upper()}{said[1:]}."


def _own_in_words(ranking: StanceRanking) -> Iterator[str]:
    """What the scenes' own stances ask, and how much better the best one is."""
    several = len(ranking.own) > 1
    for each in ranking.own if ranking.plans else ():
        name = f"The scenes' own stance {each.place}" if several else "The scene's own stance"
        if each.status != "planned":
            why = "the search ended before" if each.rejection is None else each.rejection.reason
            yield f"{name} was not planned: {why}."
        elif each is ranking.best:
            others = ranking.count("planned") > 1
            yield f"{name} is the {'best of those' if others else 'only one'} planned."
            if len(ranking.ranked) == 1:
                yield "There was no other one to compare it with."
        elif ranking.best is not None:
            less = 100 * (1 - ranking.best.value / each.value) if each.value > 0 else 0.0
            said = f": the best one asks {less:.1f} % less" if each.value > 0 else ""
            yield f"{name} asks {each.value:.4g} {ranking.unit} {ranking.when}{said}."


def planned_table(ranking: StanceRanking) -> _Table:
    """Return headings and rows of the stances that were planned: what is certified of them.

    The scenes' own come first, without a rank where they exceed a bound; the others from the best on.
    """
    known = [
        (str(k) if one.status == "planned" else "-", one)
        for k, one in enumerate(ranking.ranked, start=1)
        if one.status == "planned" or (one.own and one.figures is not NO_FIGURES)
    ]
    planned = sorted(known, key=lambda ranked: not ranked[1].own)
    # What none of them has, such as the adhesion that clamps need, has no column.
    shown = [each for each in COLUMNS if any(each.told(one.figures) is not None for _, one in planned)]
    rows = [
        (
            rank,
            f"{one.place}{', its own' if one.own else ''}",
            *(each.told(one.figures) or "-" for each in shown),
        )
        for rank, one in planned
    ]
    return ("", "stance", *(f"{each.words}, {each.unit}" for each in shown)), rows


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
    rows = [
        {"group": number, "strokes": " ".join(each.strokes), "rank": rank, **_row(one)}
        for number, each in enumerate(rankings, start=1)
        for rank, one in enumerate(each.ranked, start=1)
    ]
    return "\n".join([",".join(rows[0]), *(",".join(map(str, row.values())) for row in rows), ""])


def _row(each: StanceResult) -> dict[str, object]:
    """What the table says of a stance, by its columns."""
    planned, rest, candidate = each.figures, each.at_rest, each.candidate
    row: dict[str, object] = {"status": each.status, "judged_by": each.stage}
    numbers = {
        "bound": each.bound,
        "proven_bound": each.proven or None,
        "planned": each.value,
        "torque_at_rest": rest.torque,
        "adhesion_at_rest": rest.adhesion,
        "planned_torque": planned.torque,
        "job_torque": planned.job_torque,
        "planned_adhesion": planned.adhesion,
        "job_adhesion": planned.job_adhesion,
        "stop_adhesion": planned.stop_adhesion,
    }
    for name in ("sag_mm", "first_hz", "sway_mm", "holding_nm", "holding_of_effort"):
        value = getattr(planned, name)
        heading = "sway_mm_per_m_s2" if name == "sway_mm" else name
        numbers[heading] = getattr(rest, name) if value is None else value
    numbers |= {name: getattr(planned, name) for name in ("travel_deg", "seconds", "within_mm")}
    for name, value in numbers.items():
        row[name] = f"{value:.6g}" if value is not None and np.isfinite(value) else ""
    stance = candidate.stance if isinstance(candidate, Candidate) else None
    for foot, place in enumerate((None, None) if stance is None else stance.places, start=1):
        for name in FootholdFile.model_fields:
            free = "free" if stance is not None and name == "member" else ""
            row[f"foot_{foot}_{name}"] = free if place is None else getattr(place, name)
    row |= {axis: f"{x:.4f}" for axis, x in zip("xyz", candidate.root[:3, 3], strict=True)}
    for k in range(5):
        row[f"climb_{k + 1}_deg"] = "" if stance is None else f"{(stance.climber_deg or ())[k]:.4f}"
    return row | {"reason": "" if each.rejection is None else each.rejection.reason.replace(",", ";")}
