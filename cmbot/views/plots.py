"""Plots of a plan and of its tracking errors for papers and notebooks, drawn with matplotlib."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, optional_module
from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views.charts import (
    Chart,
    Curve,
    base_torque_curves,
    charts,
    downsampled,
    joint_quantities,
    off_path_curves,
    work_begins,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Blue and orange as on the pages: distinct with any colour vision, and in grey by their lightness.
_BASELINE, _PLANNED = "#6AABEC", "#B23F05"
_MOTION_COLOURS = {"baseline": _BASELINE, "planned": _PLANNED}
# Okabe and Ito's.
_JOINT_COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2", "#CC79A7")
_LINE_STYLES = ("-", "--", "-.", ":")
# Inches: as wide as a page's text.
_PLOT_WIDTH_IN, _PLOT_HEIGHT_IN, _MOST_LEGEND_COLUMNS = 6.7, 2.6, 3
# Keys are literals of matplotlib's own to its type hints.
_MATPLOTLIB_STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "lines.linewidth": 1.1,
    "figure.dpi": 150.0,
}
_QUANTITY_OF_PLOT = {"torque": "guardrail_torque", "clearance": "clearance", "deviation": "tool_deviation"}


def plot(result: Plan | Tracking) -> tuple[Figure, ...]:
    """Draw a plan or a simulation.

    Of a plan: the torque on the guardrail with its lower bound; every joint's angle, velocity, acceleration,
    jerk and torque as shares of their bounds (compare Chang 2021, Figures 9-14 and 19-24); the clearance with
    its margin; the tool's deviation with its bound. Of a simulation: the tracking error along each axis with
    its static part (compare Figures 16 and 26); the bent tool's distance from its path above the torque on
    the base. Their data are columns of ``tracking.csv``.

    Parameters
    ----------
    result : Plan or Tracking

    Returns
    -------
    tuple of matplotlib.figure.Figure
        Its label is its name: ``figure.savefig(f"{figure.get_label()}.pdf")``.

    Raises
    ------
    MissingExtra
        When matplotlib is not installed.
    InputError
        When `result` is neither.

    Examples
    --------
    >>> figures = cmbot.plot(plan)
    >>> figures[0].savefig(f"{figures[0].get_label()}.pdf")
    """
    if not isinstance(result, Plan | Tracking):
        raise InputError("cmbot.plot", "result", type(result).__name__, "a Plan or a Tracking")
    require_matplotlib()
    import matplotlib as mpl

    with mpl.rc_context(_MATPLOTLIB_STYLE):
        if isinstance(result, Tracking):
            return _tracking_error(result), _path_and_torque(result)
        # An infinite clearance has no curve.
        torque, *others = (_chart(result, chart) for chart in charts(result, None) if chart.curves)
        return torque, _joints(result), *others


def require_matplotlib() -> None:
    """Raise an error without matplotlib, before a long computation.

    Raises
    ------
    MissingExtra
        When it is not installed.
    """
    optional_module("matplotlib", "matplotlib", "plots")


def figure_files(figures: Iterable[Figure]) -> Iterator[tuple[str, bytes]]:
    """Yield each figure as a PNG, an SVG and a PDF file, its name and its content.

    The same figures give the same bytes, as long as matplotlib stays the same.

    Parameters
    ----------
    figures : iterable of matplotlib.figure.Figure
        From `plot`.
    """
    import matplotlib as mpl

    with mpl.rc_context({"svg.hashsalt": "cmbot"}):
        for figure in figures:
            for suffix, undated in (("png", "Software"), ("svg", "Date"), ("pdf", "CreationDate")):
                content = BytesIO()
                figure.savefig(content, format=suffix, metadata={undated: None})
                yield f"{figure.get_label()}.{suffix}", content.getvalue()


def _chart(plan: Plan, chart: Chart) -> Figure:
    """Draw a chart of the report's page."""
    figure = _figure(_QUANTITY_OF_PLOT[chart.key], _PLOT_HEIGHT_IN)
    axes = figure.subplots()
    _draw_curves(axes, chart.curves)
    # At least the chart's own range, and every curve.
    shown = np.concatenate([chart.axis, *(curve.y for curve in chart.curves)])
    low, high = float(shown.min()), float(shown.max())
    axes.set_ylim(low, high)
    lower, upper = chart.bounds
    if lower is not None:
        _forbidden(axes, low, lower)
    if upper is not None:
        _forbidden(axes, upper, high)
    for level, name in chart.marks:
        axes.axhline(level, color="black", linewidth=0.8, linestyle="--", label=name)
    outside, (begin, end) = [], chart.work
    for move in plan.job.moves_between:
        axes.axvspan(move.begin, move.end, color="0.93", zorder=-1, label="free moves, as planned")
    edge: dict[str, Any] = {"color": "0.6", "linewidth": 0.6, "label": "begin and end of the work"}
    if any(curve.t[0] < begin for curve in chart.curves):
        axes.axvline(begin, **edge)
        outside.append(f"the approach before {begin:.1f}")
    if end is not None:
        axes.axvline(end, **edge)
        outside.append(f"the return after {end:.1f}")
    if any(curve.starts and curve.motion == "baseline" for curve in chart.curves) and not chart.free:
        outside.append("the baseline waits where it has no line")
    axes.set_xlabel(f"time, s ({', '.join(outside)})" if outside else "time, s")
    axes.set_ylabel(chart.unit)
    axes.set_title(chart.title, loc="left")
    _legend(figure, axes)
    return figure


def _draw_curves(axes: Axes, curves: Iterable[Curve]) -> None:
    for curve in curves:
        few = curve.downsampled()
        # A line is broken at NaN.
        t, y = (np.insert(each, list(few.starts), np.nan) for each in (few.t, few.y))
        axes.plot(t, y, color=_MOTION_COLOURS[curve.motion], label=curve.motion)


def _joints(plan: Plan) -> Figure:
    """Draw the motions' joints, a row a quantity, as shares of the bounds; beyond them it is shaded."""
    figure = _figure("joints", 8.0)
    quantities = joint_quantities(plan)
    begin, motions = work_begins(plan), [("planned", plan.samples)]
    if plan.baseline is not None:
        motions.insert(0, ("baseline", plan.baseline.samples))
    grid = figure.subplots(len(quantities), len(motions), sharex=True, squeeze=False)
    for column, (motion, samples) in enumerate(motions):
        grid[0, column].set_title(motion, loc="left")
        grid[-1, column].set_xlabel("time, s")
        for axes, (quantity, name, lower, upper) in zip(grid[:, column], quantities, strict=True):
            shares = _shares(getattr(samples, name), lower, upper)
            if column == 0:
                axes.set_ylabel(f"{quantity},\nshare of bound")
            # A continuous joint has no range, and NaN as its share.
            reach = 1.15 * max(1.0, float(np.abs(shares[np.isfinite(shares)]).max(initial=0.0)))
            axes.set_ylim(-reach, reach)
            _forbidden(axes, 1.0, reach)
            _forbidden(axes, -reach, -1.0)
            for joint in range(plan.robot.dof):
                t, y = downsampled(samples.t, shares[:, joint])
                colour = _JOINT_COLOURS[joint % len(_JOINT_COLOURS)]
                dashes = _LINE_STYLES[joint // len(_JOINT_COLOURS) % len(_LINE_STYLES)]
                axes.plot(begin + t, y, color=colour, linestyle=dashes, linewidth=0.9)
    names = plan.robot.joints
    lines = grid[0, -1].get_lines()
    figure.align_ylabels(list(grid[:, 0]))
    figure.legend(lines, names, loc="outside lower center", ncols=min(len(names), 7))
    return figure


def _shares(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return values (N, n) as shares, -1 to 1, of their bounds (n,); NaN without bounds."""
    ranged = np.isfinite(lower) & np.isfinite(upper)
    lower, upper = np.where(ranged, lower, np.nan), np.where(ranged, upper, np.nan)
    middle = 0.5 * (lower + upper)
    return (values - middle) / (upper - middle)


def _tracking_error(tracking: Tracking) -> Figure:
    """Draw the tracking error in a row for each axis, with its static part."""
    figure, rows = _rows("tracking_error", tracking, 3)
    for number, axes in enumerate(rows):
        axes.set_ylabel(f"tracking error\nalong {'xyz'[number]}, mm")
        _draw_curves(axes, [Curve(motion=n, t=m.t, y=1e3 * m.error[:, number]) for n, m in tracking.motions])
        for _, motion in tracking.motions:
            static = 1e3 * motion.static[:, number]
            axes.plot(motion.t, static, color="black", linewidth=0.7, linestyle=":", label="static part")
    _legend(figure, rows[0])
    return figure


def _path_and_torque(tracking: Tracking) -> Figure:
    """Draw the bent tool's distance from its path above the torque on the base, where that bends."""
    torque = base_torque_curves(tracking)
    figure, rows = _rows("tracking_path", tracking, 2 if torque else 1)
    names = "distance\nfrom the path, mm", "torque on the base\nwith vibration, Nm"
    for axes, name, curves in zip(rows, names, (off_path_curves(tracking), torque), strict=False):
        _draw_curves(axes, curves)
        axes.set_ylabel(name)
    rows[0].set_ylim(bottom=0.0)
    _legend(figure, rows[0])
    return figure


def _rows(label: str, tracking: Tracking, count: int) -> tuple[Figure, list[Axes]]:
    """Plots above each other on the simulation's clock, with the times at which the joints stop."""
    figure = _figure(label, 0.5 + 1.5 * count)
    rows = list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])
    for axes in rows:
        for _, motion in tracking.motions:
            axes.axvline(motion.stop, color="0.6", linewidth=0.6, label="the joints stop")
    rows[-1].set_xlabel("time after the work began, s")
    figure.align_ylabels(rows)
    return figure, rows


def _figure(label: str, height: float) -> Figure:
    # Without pyplot: no window, no state shared with the caller's own plots.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_PLOT_WIDTH_IN, height), layout="constrained")
    figure.set_label(label)
    return figure


def _forbidden(axes: Axes, low: float, high: float) -> None:
    axes.axhspan(low, high, color="0.85", linewidth=0, zorder=0)


def _legend(figure: Figure, axes: Axes) -> None:
    # A label of both motions appears once.
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    columns = min(len(handles), _MOST_LEGEND_COLUMNS)
    figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=columns)
