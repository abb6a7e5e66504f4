"""Draw a run's results: what every solver takes, and how the whole grows with the via-points."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from measure import required

from report.goals import arrived

__all__ = ["COLOURS", "draw"]

# Okabe and Ito's: told apart with any colour vision.
COLOURS = {
    "sqp": "#0072B2",
    "slsqp": "#56B4E9",
    "ipopt, l-bfgs": "#E69F00",
    "ipopt, exact": "#D55E00",
    "literal slsqp": "#000000",
}
_STAGES = {"global_stage": "#009E73", "optimisation": "#0072B2", "certificate": "#CC79A7"}


def draw(results: Mapping[str, Any], path: Path) -> None:
    """Write the figure to `path`.

    Raises
    ------
    MissingExtra
        When matplotlib is not installed.
    """
    required("matplotlib")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    grows = bool(results["growth"])
    figure = Figure(figsize=(6.7, 4.6 if not grows else 6.6), layout="constrained", dpi=150)
    FigureCanvasAgg(figure)
    axes = figure.subplots(2 if grows else 1, height_ratios=(2, 1) if grows else None, squeeze=False)[:, 0]
    _solvers(axes[0], results["solvers"])
    if grows:
        _growth(axes[1], results["growth"])
    # No date: the same results are the same file.
    figure.savefig(path, metadata={"Software": None})


def _solvers(axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    problems = list(dict.fromkeys((row["problem"], row["knots"]) for row in rows))
    place, ticks = 0.0, []
    for problem in problems:
        those = [row for row in rows if (row["problem"], row["knots"]) == problem]
        ticks.append(place + 0.5 * (len(those) - 1))
        for row in those:
            hatch = None if arrived(rows, row) else "///"
            axes.barh(place, row["seconds"], color=COLOURS[row["solver"]], hatch=hatch, edgecolor="white")
            place += 1
        place += 1
    axes.set_xscale("log")
    axes.set_xlim(left=0.01)
    axes.set_yticks(ticks, [", ".join(problem) for problem in problems])
    axes.invert_yaxis()
    axes.set_xlabel("processor time, s (hatched: not at the optimum)")
    shown = {row["solver"] for row in rows}
    patch = required("matplotlib.patches").Patch
    marks = [patch(color=colour, label=name) for name, colour in COLOURS.items() if name in shown]
    axes.legend(
        handles=marks, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=7.5
    )
    _bare(axes)


def _growth(axes: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    n = [row["via_points"] for row in rows]
    for stage, colour in _STAGES.items():
        axes.plot(
            n, [row[stage] for row in rows], "o-", color=colour, markersize=3, label=stage.replace("_", " ")
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("via-points")
    axes.set_ylabel("s")
    axes.legend(frameon=False, fontsize=7.5)
    _bare(axes)


def _bare(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=8)
