"""What another stance saves, and what the search for it costs: torque, adhesion needed, screening, bounds.

    python benchmarks/stances.py                # prints, and writes benchmarks/results/stances.json
    python benchmarks/stances.py --document     # the tables of docs/hold.md, too

Each scene is planned where it stands, then the best stance is searched by the torque, by the adhesion needed,
and by the adhesion needed where the torque may not be larger than that of the scene's own stance. Torques and
adhesions are those at work.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from measure import machine
from report.document import RESULTS, ROOT, page
from report.tables import Sheet, markdown, print_sheets
from rich.console import Console
from threadpoolctl import threadpool_limits

from cmbot import load_scene, plan
from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, robot_of, strokes_of, task_of
from cmbot.scene import Scene
from cmbot.stances import Standing, StandOptions, candidates_of, in_world, scene_at, screen, stand
from cmbot.stances.candidates import climber_in_the_way
from cmbot.stances.charting import bounded_quickly

__all__ = ["DOCUMENT", "REFERENCE", "blocks", "found", "screened"]

SCENES = ("triangle", "line")
FORMAT = "cmbot-stances/1"
_BY: dict[Literal["torque", "hold"], str] = {"torque": "torque", "hold": "adhesion"}
REFERENCE, DOCUMENT = RESULTS / "stances.json", ROOT / "docs" / "hold.md"
# What is to be reached: share of the adhesion, seconds to screen so many stances, how much better one may be.
_SHARE, _SECONDS, _STANCES, _GAP = 0.5, 60.0, 2000, 0.02
# Grids of foot 1 and of both feet, m, that have that many stances.
_DENSE = (0.04, 0.14)
# Stances whose bounds are compared with charts, and the seed by which they are drawn.
_COMPARED, _SEED = 25, 11
# Plans are the same however busy the machine is.
_TIME_LIMIT = 600.0


@dataclass(frozen=True, kw_only=True)
class Found:
    """One search: figures of the best stance, beside those of the scene's own.

    Attributes
    ----------
    scene, by, place : str
        What was searched for, and where the best stance is.
    stances, planned, failed : int
    seconds, processor_seconds : float
        Of the whole search.
    torque, own_torque : float, Nm
    adhesion, own_adhesion : float, N
    peak, least_bound : float
        The planned peak of what was searched by, and the smallest bound of a stance that was not planned,
        also of those of which planning failed; infinite where there is none.
    """

    scene: str
    by: str
    place: str
    stances: int
    planned: int
    failed: int
    seconds: float
    processor_seconds: float
    torque: float
    own_torque: float
    adhesion: float
    own_adhesion: float
    peak: float
    least_bound: float

    @property
    def may_be_better(self) -> float:
        """By what share of its peak a stance that was not planned may be better."""
        return max(1 - self.least_bound / self.peak, 0.0)


def _adhesion(made: Plan) -> float:
    needed = made.figures.adhesion_needed
    if needed is None:
        raise ValueError(f"{made.scene.name}: a clamp needs no adhesion")
    return needed.peak


def found(scene: Scene, own: Plan, by: Literal["torque", "hold"], options: StandOptions) -> Found:
    """Search for the best stance of a scene, by the torque or by the adhesion needed."""
    begin, begin_processor = time.perf_counter(), time.process_time()
    (standing,) = stand(scene.with_options(objective=by), options)
    seconds, processor = time.perf_counter() - begin, time.process_time() - begin_processor
    if standing.best is None or standing.best.plan is None:
        raise ValueError(f"{scene.name}: no stance was planned")
    made = standing.best.plan
    limited = "" if np.isinf(options.max_torque) else f", {options.max_torque:.0f} Nm at most"
    return Found(
        scene=scene.name,
        by=_BY[by] + limited,
        place=standing.best.place,
        stances=len(standing.ranked),
        planned=standing.count("planned"),
        failed=standing.count("failed"),
        seconds=seconds,
        processor_seconds=processor,
        torque=made.figures.peak_guardrail_torque,
        own_torque=own.figures.peak_guardrail_torque,
        adhesion=_adhesion(made),
        own_adhesion=_adhesion(own),
        peak=made.objective.planned_peak,
        least_bound=_least_bound(standing),
    )


def _least_bound(standing: Standing) -> float:
    """The smallest bound of a stance that was not planned; those of too much torque do not count."""
    left = (each.bound for each in standing.ranked if each.status in ("screened", "failed"))
    return min(left, default=np.inf)


def screened(scene: Scene) -> dict[str, Any]:
    """Screen the stances of a fine grid, and return what it took."""
    here = in_world(scene)
    robot = robot_of(here)
    tasks = [task_of(stroke, here) for stroke in strokes_of(here, robot)]
    begin, begin_processor = time.perf_counter(), time.process_time()
    candidates = list(candidates_of(here, *_DENSE))
    result = screen(here, robot, tasks, candidates, here.planner)
    return {
        "scene": scene.name,
        "stances": len(candidates),
        "within_reach": int(result.within_reach.all(axis=0).sum()),
        "bounded": int(np.isfinite(result.bound).all(axis=0).sum()),
        "seconds": time.perf_counter() - begin,
        "processor_seconds": time.process_time() - begin_processor,
    }


def compared(scene: Scene, by: Literal["torque", "hold"]) -> dict[str, Any]:
    """Compare the bounds of sampled postures with those of charts, which have obstacles in addition."""
    here = in_world(scene.with_options(objective=by))
    robot = robot_of(here)
    tasks = [task_of(stroke, here) for stroke in strokes_of(here, robot)]
    candidates = list(candidates_of(here, StandOptions().spacing, StandOptions().pair_spacing))
    bound = screen(here, robot, tasks, candidates, here.planner).bound.max(axis=0)
    drawn = np.random.default_rng(_SEED).permutation(np.flatnonzero(np.isfinite(bound)))
    shares, blocked = list[float](), 0
    for k in drawn.tolist():
        if len(shares) == _COMPARED:
            break
        if climber_in_the_way(here, candidates[k]) is not None:
            continue
        try:
            shares.append(float(bound[k]) / bounded_quickly(scene_at(here, candidates[k], None)))
        except PathNotFound:
            blocked += 1
    return {
        "scene": scene.name,
        "by": _BY[by],
        "compared": len(shares),
        "blocked": blocked,
        "largest": max(shares),
        "mean": float(np.mean(shares)),
    }


def measured(names: Sequence[str], console: Console) -> dict[str, Any]:
    """Measure everything."""
    themes: dict[str, Any] = {"found": [], "screened": [], "compared": []}
    results: dict[str, Any] = {"format": FORMAT, "machine": machine(), **themes}
    for name in names:
        shipped = load_scene(name)
        scene = shipped.with_options(time_limit_s=_TIME_LIMIT)
        own = plan(scene)
        limited = StandOptions(max_torque=own.figures.peak_guardrail_torque)
        searches: tuple[tuple[Literal["torque", "hold"], StandOptions], ...] = (
            ("torque", StandOptions()),
            ("hold", StandOptions()),
            ("hold", limited),
        )
        for by, options in searches:
            console.print(f"{name}: {by}, {options.max_torque:g} Nm", style="dim")
            results["found"].append(asdict(found(scene, own, by, options)))
        results["screened"].append(screened(scene))
        results["compared"] += [compared(scene, by) for by in _BY]
    return results


def sheets(results: Mapping[str, Any]) -> Iterator[Sheet]:
    """Yield the tables."""
    each = [Found(**row) for row in results["found"]]
    yield Sheet(
        key="stances",
        title="The best stance beside the scene's own",
        headings=(
            *("scene", "searched by", "best stance", "torque, Nm", "of the own", "adhesion needed, kN"),
            *("of the own", "an unplanned one may be better by"),
        ),
        rows=tuple(
            (
                *(one.scene, one.by, one.place),
                *(f"{one.torque:.1f}", f"{one.torque / one.own_torque:.2f} of {one.own_torque:.1f}"),
                *(
                    f"{one.adhesion / 1e3:.2f}",
                    f"{one.adhesion / one.own_adhesion:.2f} of {one.own_adhesion / 1e3:.2f}",
                ),
                f"{100 * one.may_be_better:.1f} %",
            )
            for one in each
        ),
    )
    yield Sheet(
        key="cost of stances",
        title="What the search costs",
        headings=("scene", "searched by", "stances", "planned", "failed", "processor s", "wall s"),
        rows=tuple(
            (
                *(one.scene, one.by, str(one.stances), str(one.planned), str(one.failed)),
                *(f"{one.processor_seconds:.1f}", f"{one.seconds:.1f}"),
            )
            for one in each
        ),
    )
    yield Sheet(
        key="screening of stances",
        title="Screening alone, on a finer grid",
        headings=("scene", "stances", "within reach", "bounded", "processor s", "wall s"),
        rows=tuple(
            (
                *(row["scene"], str(row["stances"]), str(row["within_reach"]), str(row["bounded"])),
                *(f"{row['processor_seconds']:.1f}", f"{row['seconds']:.1f}"),
            )
            for row in results["screened"]
        ),
    )
    yield Sheet(
        key="bounds of stances",
        title="Bounds of sampled postures, beside those of charts",
        headings=("scene", "searched by", "compared", "blocked", "largest of that of charts", "mean"),
        rows=tuple(
            (
                *(row["scene"], row["by"], str(row["compared"]), str(row["blocked"])),
                *(f"{100 * row['largest']:.1f} %", f"{100 * row['mean']:.1f} %"),
            )
            for row in results["compared"]
        ),
    )
    yield Sheet(
        key="goals of stances",
        title="Goals",
        headings=("goal", "measured", ""),
        rows=tuple(_goals(each, results["screened"])),
    )


def _goals(each: Sequence[Found], rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str, str]]:
    def told(met: bool) -> str:
        return "met" if met else "missed"

    for scene in dict.fromkeys(one.scene for one in each):
        own = [one for one in each if one.scene == scene]
        some = [one for one in own if one.torque <= one.own_torque * (1 + 1e-9)]
        goal = f"{scene}: at most {_SHARE:g} of the adhesion, at no more torque"
        best = min(one.adhesion / one.own_adhesion for one in some)
        yield goal, f"{best:.2f}", told(best <= _SHARE)
    for row in rows:
        goal = f"{row['scene']}: {_STANCES} stances screened in {_SECONDS:g} s of processor time"
        took = row["processor_seconds"] * _STANCES / row["stances"]
        yield goal, f"{took:.1f} s", told(row["stances"] >= _STANCES and took <= _SECONDS)
    most = max(one.may_be_better for one in each)
    goal = f"no unplanned stance may be better by more than {100 * _GAP:g} %"
    yield goal, f"{100 * most:.1f} %", told(most <= _GAP)


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/hold.md, by marker."""
    return {sheet.key: markdown(sheet) for sheet in sheets(results)}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=SCENES, help="default: both of the paper's")
    parser.add_argument("--output", type=Path, default=REFERENCE, help="default: %(default)s")
    parser.add_argument("--document", action="store_true", help="put the tables into docs/hold.md")
    arguments = parser.parse_args()
    console = Console(width=max(170, Console().width))
    with threadpool_limits(limits=1):
        results = measured(arguments.scenes, console)
    arguments.output.parent.mkdir(exist_ok=True)
    arguments.output.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print_sheets(sheets(results), console)
    if arguments.document:
        DOCUMENT.write_text(page(DOCUMENT, blocks(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
