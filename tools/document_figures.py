"""Write every generated block of README.md and docs/ anew, between its markers, from real runs.

Run ``python tools/document_figures.py`` after a change that moves figures. It takes minutes; ``--quick``
leaves out the table of docs/assumptions.md. The tables of docs/performance.md come from ``make bench``, the
pictures from ``tools/plot_figures.py``. tests/house/test_documents.py compares what no machine changes.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cmbot

Row = tuple[str, ...]
ROOT = Path(__file__).resolve().parent.parent
SCENES = ("triangle", "line")
FIGURES = {
    *("peak_guardrail_torque", "mean_guardrail_torque", "rms_guardrail_torque", "min_clearance"),
    *("peak_static_guardrail_torque", "max_tool_deviation", "max_tool_rotation", "adhesion_needed.peak"),
    *("job.duration", "limit_use.velocity", "limit_use.acceleration", "limit_use.jerk", "limit_use.torque"),
}
JOBS = ("gusset_plate", "bracket_faces")


def write_between(path: Path, marker: str, text: str) -> None:
    """Put `text` between ``<!-- marker -->`` and ``<!-- end of marker -->``."""
    start, end = f"<!-- {marker} -->", f"<!-- end of {marker} -->"
    old = path.read_text(encoding="utf-8")
    pattern = re.compile(f"{re.escape(start)}\n.*?{re.escape(end)}", re.DOTALL)
    new, count = pattern.subn(lambda _: f"{start}\n{text.strip()}\n{end}", old)
    if count != 1:
        sys.exit(f"{path}: {count} places marked {marker}, expected one")
    path.write_text(new, encoding="utf-8")


def run(*words: str) -> str:
    """Return the standard output of Python with `words`, started in an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, *words]
        return subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True).stdout


def gains(name: str) -> Iterator[Row]:
    """Yield the figures of a shipped job: name and unit, without what cmbot does, planned.

    Without: straight motion without compensation, and its own plan's accuracy budget.
    What the base bears is not compared with a motion that breaks limits.
    """
    scene = cmbot.load_scene(name).with_options(baseline="straight")
    plan = cmbot.plan(scene)
    baseline, sag = plan.baseline, plan.bent_offsets
    motions = [motion for _, motion in cmbot.simulate(plan).motions]
    rests = [motion.metrics.residual for motion in motions]
    budgets = [each.accuracy for each in (cmbot.plan(scene.with_options(compensate=False)), plan)]
    if baseline is None or None in (*budgets, *sag, *rests):
        sys.exit(f"{name}: nothing bends there")
    yield "tool within, with 95 %, mm", *(f"{budget.within_mm:.1f}" for budget in budgets if budget)
    yield "bent tool off its path, at rest, mm", *(f"{1e3 * x:.1f}" for x in sag if x is not None)
    yield "sway beside the sag, mm", *(f"{1e3 * each.largest(each.dynamic):.1f}" for each in motions)
    yield "swing after the work, mm", *(f"{1e3 * rest.diameter:.2f}" for rest in rests if rest)
    both = baseline.job_figures, plan.job.figures
    needed = (f"{1e-3 * each.adhesion_needed.peak:.1f}" for each in both if each.adhesion_needed)
    peaks = (f"{each.peak_guardrail_torque:.0f}" for each in both)
    for what, (before, planned) in (("adhesion needed, kN", needed), ("peak torque on the base, Nm", peaks)):
        yield what, "-" if cmbot.planning.baseline_faults(plan) else before, planned
    yield "smallest clearance, mm", *(f"{1e3 * each.min_clearance:.0f}" for each in both)
    yield "time, s", *(f"{x:.1f}" for x in (baseline.duration, plan.job.duration))


def side_by_side(names: tuple[str, str], before: str, both: Iterable[Iterable[Row]]) -> str:
    """Return the rows of two scenes as one table."""
    cells = (f"{name}, {column}" for name in names for column in (before, "planned"))
    lines = [f"| | {' | '.join(cells)} |", "|---|---|---|---|---|"]
    for first, second in zip(*both, strict=True):
        lines.append(f"| {' | '.join((*first, *second[1:]))} |")
    return "\n".join(lines)


def tracking(plan: cmbot.Plan) -> Iterator[tuple[str, list[float]]]:
    """Yield tracking errors, mm: of the baseline, of a plan without compensation, of the plan."""
    options = replace(plan.scene.planner, compensate=False)
    plain = cmbot.simulate(cmbot.plan(plan.scene, options=options))
    motions = [*(motion for _, motion in plain.motions), cmbot.simulate(plan).planned]
    figures = [motion.metrics for motion in motions]
    for name, part in (
        ("error, RMS", "total"),
        ("its dynamic part, RMS", "dynamic"),
        ("off the path, RMS", "path"),
    ):
        yield name, [1e3 * getattr(each, part).rms[3] for each in figures]
    yield "after the stop, largest swing", [1e3 * each.residual.diameter for each in figures]


def tracking_table(plan: cmbot.Plan) -> str:
    """Return the tracking errors as a table."""
    lines = ["| mm | baseline | planned, not compensated | planned |", "|---|---|---|---|"]
    lines += [f"| {name} | {' | '.join(f'{x:.3f}' for x in row)} |" for name, row in tracking(plan)]
    return "\n".join(lines)


def figures(plan: cmbot.Plan) -> Iterator[Row]:
    """Yield the rows of a plan that both motions have, and that are determined."""
    for row in cmbot.planning.plan_rows(plan):
        if row.key in FIGURES and row.baseline is not None:
            yield row.cells


def main() -> None:
    """Write all blocks."""
    parser = argparse.ArgumentParser(description="Write the documents' figures from real runs.")
    parser.add_argument("--quick", action="store_true", help="leave out the table of docs/assumptions.md")
    arguments = parser.parse_args()
    docs = ROOT / "docs"
    printed = run("-m", "cmbot", "plan", "triangle").rstrip()
    # Its first line is the table's header, which begins with blanks.
    write_between(docs / "command_line.md", "output of cmbot plan triangle", f"```text\n{printed}\n```")
    plans = [cmbot.plan(cmbot.load_scene(name)) for name in SCENES]
    jobs = map(gains, JOBS)
    write_between(ROOT / "README.md", "jobs", side_by_side(JOBS, "without", jobs))
    experiments = map(figures, plans)
    write_between(docs / "results.md", "figures", side_by_side(SCENES, "baseline", experiments))
    write_between(docs / "results.md", "tracking of the triangle", tracking_table(plans[0]))
    if not arguments.quick:
        table = run(str(ROOT / "tools" / "sensitivity.py"), "triangle")
        write_between(docs / "assumptions.md", "sensitivity of triangle", table)


if __name__ == "__main__":
    main()
