"""Where to stand: the best stances by what is asked, what bounds say of the others, and what it costs.

    python benchmarks/stances.py                # prints, and writes benchmarks/results/stances.json
    python benchmarks/stances.py --document     # the table of docs/hold.md, too

The triangle by torque, hold, sag and sway, and by sag within bounds; a Panda among 200 mounts on a floor;
the screening of a fine grid by itself. Searches have the processes that `cmbot stand` has. No plan ends by
the clock: a busy machine finds the same.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from measure import machine
from report.document import RESULTS, ROOT, page
from report.tables import Sheet, markdown, print_sheets
from rich.console import Console
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.common.workers import processors
from cmbot.planning import robot_of, strokes_of, task_of
from cmbot.scene import Scene
from cmbot.stances import (
    NO_FIGURES,
    Bounds,
    Screener,
    StanceFigures,
    StanceObjective,
    StanceRanking,
    StandOptions,
    candidates_of,
    in_world,
    stand,
)

__all__ = ["DOCUMENT", "REFERENCE", "Found", "blocks", "found", "sheets"]

FORMAT = "cmbot-stances/3"
SEARCHES = ("torque", "hold", "sag", "sway", "kept", "mounts", "screening")
REFERENCE, DOCUMENT = RESULTS / "stances.json", ROOT / "docs" / "hold.md"
# Sag, slowest mode and torque over the job that one stance is to keep, mm, Hz and Nm.
KEPT = {"sag_mm": 3.0, "first_hz": 5.0, "job_torque": 355.0}
# What is to be reached: by how much an unplanned stance may be better, seconds to screen so many stances, and
# of a command.
_GAP, _SCREENING_S, _STANCES, _COMMAND_S = 0.05, 20.0, 2000, 60.0
_LIMIT_S = 3600.0
_CALM = ("sway_mm", "sag_mm")
# Grids of foot 1 and of both feet, m, that have that many stances.
_DENSE = (0.04, 0.14)
_FLOOR = {
    "format": "cmbot-scene/2",
    "name": "panda_floor",
    "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
    "start": {"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
    "return": "start",
    "tool_path": {
        "keep": "pose",
        "from": {"xyz": [0.5, -0.2, 0.4], "rpy_deg": [180, 0, 0]},
        "legs": [{"by": [0, 0.4, 0], "speed_m_s": 0.1}],
    },
    "guardrail": {"bays": 0},
    "mounts": [
        {
            "name": "floor",
            "grid": {"origin": [-0.5, -0.6, 0], "u": [1.9, 0, 0], "v": [0, 1.2, 0], "count": [20, 10]},
        }
    ],
}


@dataclass(frozen=True, kw_only=True)
class Found:
    """One search: the best stance, and what is known of the others.

    Attributes
    ----------
    scene, by, unit, place : str
        What was searched for, and where the best stance is.
    stances, planned, proven, failed : int
        Of `proven` it is proven that they are no better.
    seconds, processor_seconds : float
        Of the whole search.
    value, own_value, least_bound : float
        Of what was searched by: of the best stance, of the scene's own, and the smallest bound of a stance
        that was not planned, also of those of which planning failed; infinite where there is none.
    figures, own_figures : mapping
        As `StanceFigures` has them.
    nearest : str
        Where no stance keeps the bounds, that which does so most nearly, and by how much it does not.
    """

    scene: str
    by: str
    unit: str
    place: str
    stances: int
    planned: int
    proven: int
    failed: int
    seconds: float
    processor_seconds: float
    value: float
    own_value: float
    least_bound: float
    figures: Mapping[str, float | None]
    own_figures: Mapping[str, float | None]
    nearest: str = ""

    @property
    def may_be_better(self) -> float:
        """By what share of its value a stance that was not planned may be better."""
        return max(1 - self.least_bound / self.value, 0.0) if self.place else 0.0

    @staticmethod
    def of(ranking: StanceRanking, by: str, seconds: float, processor_seconds: float) -> Found:
        """Return what a search found."""
        best, (own, *_), near = ranking.best, ranking.own, ranking.nearest
        if best is None and (near is None or near.rejection is None):
            raise ValueError(f"{ranking.scene.name}: no stance was planned")
        reason = "" if near is None or near.rejection is None else f"{near.place}: {near.rejection.reason}"
        left = (each.bound for each in ranking.ranked if each.status in ("screened", "failed"))
        return Found(
            scene=ranking.scene.name,
            by=by,
            unit=ranking.unit,
            place="" if best is None else best.place,
            stances=len(ranking.ranked),
            planned=ranking.count("planned"),
            proven=ranking.proven,
            failed=ranking.count("failed"),
            seconds=seconds,
            processor_seconds=processor_seconds,
            value=0.0 if best is None else best.value,
            own_value=own.value,
            least_bound=min(left, default=np.inf),
            figures=asdict(NO_FIGURES if best is None else best.figures),
            own_figures=asdict(own.figures),
            nearest=reason if best is None else "",
        )


def found(scene: Scene, objective: StanceObjective, bounds: Bounds, by: str) -> Found:
    """Search for the best stance of a scene."""
    begin, begin_processor = time.perf_counter(), _processor_seconds()
    (ranking,) = stand(scene, StandOptions(objective=objective, bounds=bounds, jobs=min(processors(), 4)))
    return Found.of(ranking, by, time.perf_counter() - begin, _processor_seconds() - begin_processor)


def _processor_seconds() -> float:
    """Of this process, and of those that it started and that ended."""
    return sum(os.times()[:4])


def screened(scene: Scene) -> dict[str, Any]:
    """Screen the stances of a fine grid, and return what it took."""
    here = in_world(scene)
    robot = robot_of(here)
    tasks = [task_of(stroke, here) for stroke in strokes_of(here, robot)]
    begin_processor = time.process_time()
    candidates = list(candidates_of(here, *_DENSE))
    result = Screener(here, robot, candidates).screened(tasks)
    return {
        "scene": scene.name,
        "stances": len(candidates),
        "bounded": int(np.isfinite(result.bound).all(axis=0).sum()),
        "processor_seconds": time.process_time() - begin_processor,
    }


def measured(searches: Sequence[str], known: Mapping[str, Any], console: Console) -> dict[str, Any]:
    """Measure some of the searches; of the others what is known is kept."""
    triangle, floor = (
        load_scene(scene).with_options(time_limit_s=_LIMIT_S) for scene in ("triangle", _FLOOR)
    )
    kept = Bounds(sag_mm=KEPT["sag_mm"], base_torque_nm=KEPT["job_torque"])
    asked: dict[str, tuple[Scene, StanceObjective, Bounds, str]] = {
        "torque": (triangle, "torque", Bounds(), "torque"),
        "hold": (triangle, "hold", Bounds(), "adhesion"),
        "sag": (triangle, "sag", Bounds(), "sag"),
        "sway": (triangle, "sway", Bounds(), "sway"),
        "kept": (triangle, "sag", kept, _kept_in_words()),
        "mounts": (floor, "torque", Bounds(), "torque"),
    }
    rows = dict(known.get("found", {}))
    for name in searches:
        if name in asked:
            console.print(name, style="dim")
            rows[name] = asdict(found(*asked[name]))
    screenings = [screened(triangle)] if "screening" in searches else known.get("screened", [])
    in_order = {name: rows[name] for name in asked if name in rows}
    return {"format": FORMAT, "machine": machine(), "found": in_order, "screened": screenings}


def _kept_in_words() -> str:
    return f"sag, at most {KEPT['sag_mm']:g} mm and {KEPT['job_torque']:g} Nm over the job"


def sheets(results: Mapping[str, Any]) -> Iterator[Sheet]:
    """Yield the tables."""
    each = [Found(**row) for row in results["found"].values()]
    yield Sheet(
        key="stances",
        title="The best stances; another one may be better by (estimate)",
        headings=(
            *("", "best stance", "torque, Nm", "over the job", "adhesion, kN", "sag, mm", "first mode, Hz"),
            *("sway, mm per m/s2", "another better by", "s"),
        ),
        rows=tuple(row for name, some in _by_scene(each).items() for row in _rows(name, some)),
    )
    yield Sheet(
        key="goals of stances",
        title="Goals",
        headings=("goal", "measured", ""),
        rows=tuple(_goals(each, results["screened"])),
    )


def _by_scene(each: Sequence[Found]) -> dict[str, list[Found]]:
    return {
        name: [one for one in each if one.scene == name] for name in dict.fromkeys(one.scene for one in each)
    }


def _rows(name: str, searches: Sequence[Found]) -> Iterator[tuple[str, ...]]:
    """The scene's own stance as one search planned it, and the best by each."""
    own = next((one.own_figures for one in searches if one.by == "torque"), searches[0].own_figures)
    yield name, "its own", *_cells(StanceFigures(**own)), "", ""
    for one in searches:
        place = _shortly(one.place) or f"none; {_shortly(one.nearest)}"
        better = f"{100 * one.may_be_better:.1f} %" if one.place else ""
        yield one.by, place, *_cells(StanceFigures(**one.figures)), better, f"{one.seconds:.0f}"


def _shortly(place: str) -> str:
    return place.replace(" (outer)", "").replace(" at ", " ").replace(" and ", ", ")


def _cells(figures: StanceFigures) -> Iterator[str]:
    kilonewtons = None if figures.adhesion is None else figures.adhesion / 1e3
    values = (figures.torque, figures.job_torque, kilonewtons, figures.sag_mm, figures.first_hz)
    for value in (*values, figures.sway_mm):
        yield "" if value is None else f"{value:.4g}"


def _goals(each: Sequence[Found], screenings: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str, str]]:
    def told(met: bool) -> str:
        return "met" if met else "missed"

    for one in (one for one in each if one.place):
        goal = f"{one.scene}, {one.by}: no unplanned stance better by more than {100 * _GAP:g} % (estimate)"
        yield goal, f"{100 * one.may_be_better:.1f} %", told(one.may_be_better <= _GAP)
    for one in each:
        if one.by == _kept_in_words():
            values = {name: float(one.figures[name] or 0.0) for name in KEPT}
            met = values["first_hz"] >= KEPT["first_hz"]
            met &= all(values[name] <= KEPT[name] for name in ("sag_mm", "job_torque"))
            goal = f"{one.by}, and {KEPT['first_hz']:g} Hz"
            shown = f"{values['sag_mm']:.2f} mm, {values['first_hz']:.2f} Hz, {values['job_torque']:.0f} Nm"
            yield goal, shown if one.place else f"none; {one.nearest}", told(met and bool(one.place))
        if one.by == "sway":
            shares = [float(one.figures[name] or 0) / float(one.own_figures[name] or 1) for name in _CALM]
            goal = f"{one.scene}: half of the own stance's sway, no more sag"
            shown = f"{shares[0]:.2f} of the sway, {shares[1]:.2f} of the sag"
            yield goal, shown, told(shares[0] <= 0.5 and shares[1] <= 1)
    for one in each:
        if one.proven:
            goal = f"{one.scene}: all that were not planned proven to be no better"
            left = one.stances - one.planned - one.proven
            if one.scene == _FLOOR["name"]:
                yield goal, f"{left} left", told(left == 0)
    for row in screenings:
        goal = f"{row['scene']}: {_STANCES} stances screened in {_SCREENING_S:g} s of processor time"
        took = row["processor_seconds"] * _STANCES / row["stances"]
        yield goal, f"{took:.1f} s", told(row["stances"] >= _STANCES and took <= _SCREENING_S)
    most = max((one.seconds for one in each), default=0.0)
    yield f"each search in {_COMMAND_S:g} s", f"{most:.0f} s at most", told(most <= _COMMAND_S)


def blocks(results: Mapping[str, Any]) -> dict[str, str]:
    """Return what goes between the markers of docs/hold.md, by marker."""
    return {sheet.key: markdown(sheet) for sheet in sheets(results) if sheet.key == "stances"}


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--searches", nargs="+", default=SEARCHES, choices=SEARCHES, help="default: all")
    parser.add_argument("--output", type=Path, default=REFERENCE, help="default: %(default)s")
    parser.add_argument("--document", action="store_true", help="put the table into docs/hold.md")
    arguments = parser.parse_args()
    console = Console(width=max(170, Console().width))
    with threadpool_limits(limits=1):
        known = json.loads(arguments.output.read_text()) if arguments.output.is_file() else {}
        known = known if known.get("format") == FORMAT else {}
        results = measured(arguments.searches, known, console)
    arguments.output.parent.mkdir(exist_ok=True)
    arguments.output.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    print_sheets(sheets(results), console)
    if arguments.document:
        DOCUMENT.write_text(page(DOCUMENT, blocks(results)), encoding="utf-8")


if __name__ == "__main__":
    main()
