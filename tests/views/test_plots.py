"""Plots from Python: what is drawn is what was planned and simulated."""

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

import cmbot
from cmbot.common.errors import InputError, MissingExtra
from cmbot.planning import Plan, robot_of
from cmbot.simulation import Tracking
from cmbot.views import figure_files, plot, plots
from cmbot.views.charts import torque_chart

PLAN = ("guardrail_torque", "joints", "clearance", "tool_deviation")
TRACKING = ("tracking_error", "tracking_path")


@pytest.fixture(scope="module")
def figures(triangle_plan: Plan) -> dict[str, Figure]:
    return labelled(plot(triangle_plan))


@pytest.fixture(scope="module")
def tracked(short_tracking: Tracking) -> dict[str, Figure]:
    return labelled(plot(short_tracking))


def labelled(figures: tuple[Figure, ...]) -> dict[str, Figure]:
    return {str(figure.get_label()): figure for figure in figures}


def lines(axes: Axes, colour: str) -> list[Line2D]:
    return [line for line in axes.get_lines() if line.get_color() == colour]


def forbidden(axes: Axes) -> list[tuple[float, float]]:
    """Heights between which nothing is allowed."""
    spans = (patch for patch in axes.patches if isinstance(patch, Rectangle))
    return [(span.get_y(), span.get_y() + span.get_height()) for span in spans]


def assert_drawn(line: Line2D, t: np.ndarray, y: np.ndarray) -> None:
    """Every point of a line is one of the curve, and its extremes and ends are among them."""
    drawn_t, drawn_y = (np.asarray(data, dtype=float) for data in line.get_data())
    at = np.searchsorted(t, drawn_t)
    np.testing.assert_allclose(drawn_t, t[at])
    np.testing.assert_allclose(drawn_y, y[at])
    assert (drawn_y.min(), drawn_y.max()) == pytest.approx((y.min(), y.max()))
    assert (drawn_t[0], drawn_t[-1]) == (t[0], t[-1])


def test_every_figure_has_a_name_and_a_rigid_base_no_torque(
    figures: dict[str, Figure], tracked: dict[str, Figure], short_tracking: Tracking
) -> None:
    assert tuple(figures) == PLAN
    assert tuple(tracked) == TRACKING
    rigid = replace(short_tracking, baseline=None, planned=replace(short_tracking.planned, base=None))
    assert len(labelled(plot(rigid))["tracking_path"].axes) == 1


def test_the_torque_with_its_floor_and_the_approach(
    figures: dict[str, Figure], triangle_plan: Plan, short_plan: Plan
) -> None:
    (axes,) = figures["guardrail_torque"].axes
    (baseline,), (planned,) = lines(axes, plots._BASELINE), lines(axes, plots._PLANNED)
    samples, begin = triangle_plan.baseline.samples, triangle_plan.approach.duration
    assert_drawn(baseline, begin + samples.t, np.linalg.norm(samples.guardrail_torque, axis=1))
    assert planned.get_xdata()[0] == 0
    after = np.asarray(planned.get_ydata())[np.asarray(planned.get_xdata()) >= begin]
    assert after.max() == pytest.approx(triangle_plan.figures.peak_guardrail_torque, rel=1e-4)
    (bound,) = (line for line in axes.get_lines() if str(line.get_label()).startswith("lower bound"))
    assert set(bound.get_ydata()) == {triangle_plan.torque_floor}
    assert not forbidden(axes)
    assert axes.get_xlabel() == f"time, s (the approach before {begin:.1f})"
    without_floor = plot(short_plan)[0]
    assert [text.get_text() for text in without_floor.legends[0].get_texts()] == ["baseline", "planned"]
    assert without_floor.axes[0].get_xlabel() == "time, s"
    # The motions differ in grey, too.
    shades = [np.dot((0.299, 0.587, 0.114), to_rgb(colour)) for colour in (plots._BASELINE, plots._PLANNED)]
    assert np.ptp(shades) > 0.25


def test_clearance_and_deviation_are_shaded_beyond_their_bounds(
    figures: dict[str, Figure], triangle_plan: Plan
) -> None:
    options = triangle_plan.options
    (clearance,), (deviation,) = figures["clearance"].axes, figures["tool_deviation"].axes
    assert forbidden(clearance) == [(0.0, pytest.approx(1e3 * options.safety_margin_m))]
    bound = 1e3 * options.max_tool_deviation_m
    assert forbidden(deviation) == [(pytest.approx(bound), pytest.approx(1.15 * bound))]
    (planned,) = lines(deviation, plots._PLANNED)
    times = triangle_plan.approach.duration + triangle_plan.samples.t
    assert_drawn(planned, times, 1e3 * triangle_plan.samples.tool_deviation)


def test_joints_are_shares_of_their_bounds(figures: dict[str, Figure], triangle_plan: Plan) -> None:
    limits, dof = triangle_plan.robot.limits, triangle_plan.robot.dof
    grid = np.reshape(figures["joints"].axes, (5, 2))
    for column, samples in enumerate((triangle_plan.baseline.samples, triangle_plan.samples)):
        middle = 0.5 * (limits.upper + limits.lower)
        shares = (
            (samples.q - middle) / (limits.upper - middle),
            samples.v / limits.velocity,
            samples.a / limits.acceleration,
            samples.j / limits.jerk,
            samples.joint_torque / limits.torque,
        )
        for axes, values in zip(grid[:, column], shares, strict=True):
            drawn = axes.get_lines()
            assert len(drawn) == dof
            for joint, line in enumerate(drawn):
                assert_drawn(line, triangle_plan.approach.duration + samples.t, values[:, joint])
            low, high = axes.get_ylim()
            assert forbidden(axes) == [(1.0, pytest.approx(high)), (pytest.approx(low), -1.0)]
            assert high > max(1.0, abs(values).max())
    (legend,) = figures["joints"].legends
    assert tuple(text.get_text() for text in legend.get_texts()) == triangle_plan.robot.joints


def test_a_joint_without_a_range_has_no_share_of_it(short_plan: Plan) -> None:
    limits = short_plan.robot.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[2], upper[2] = -np.inf, np.inf
    endless = replace(short_plan.robot, limits=replace(limits, lower=lower, upper=upper))
    figure = labelled(plot(replace(short_plan, robot=endless)))["joints"]
    angle = figure.axes[1].get_lines()
    assert [bool(np.isnan(line.get_ydata()).all()) for line in angle] == [k == 2 for k in range(len(angle))]
    for _, content in figure_files([figure]):
        assert 0 < len(content) < 500_000


def test_tracking_errors_and_their_parts(tracked: dict[str, Figure], short_tracking: Tracking) -> None:
    motions = ((plots._BASELINE, short_tracking.baseline), (plots._PLANNED, short_tracking.planned))
    off, torque = tracked["tracking_path"].axes
    assert torque.get_ylim()[0] > 0.9 * np.linalg.norm(motions[1][1].base[:, 6:], axis=1).min() > 0
    for colour, motion in motions:
        assert_drawn(lines(off, colour)[0], motion.t, 1e3 * motion.off_path)
        assert_drawn(lines(torque, colour)[0], motion.t, np.linalg.norm(motion.base[:, 6:], axis=1))
    for number, axes in enumerate(tracked["tracking_error"].axes):
        static = [line for line in axes.get_lines() if line.get_linestyle() == ":"]
        assert len(static) == 2
        for dotted, (colour, motion) in zip(static, motions, strict=True):
            assert_drawn(*lines(axes, colour), motion.t, 1e3 * motion.error[:, number])
            np.testing.assert_allclose(dotted.get_ydata(), 1e3 * motion.static[:, number])
        assert axes.get_ylabel().endswith(f"along {'xyz'[number]}, mm")
    (legend,) = tracked["tracking_error"].legends
    assert [text.get_text() for text in legend.get_texts()] == [
        *("the joints stop", "baseline"),
        *("planned", "static part"),
    ]


def test_files_are_pictures_the_same_every_time_and_settings_stay(short_plan: Plan) -> None:
    before = dict(mpl.rcParams)
    files, again = (dict(figure_files(plot(short_plan)[:1])) for _ in range(2))
    assert dict(mpl.rcParams) == before
    assert set(files) == {f"{name}.{suffix}" for name in PLAN[:1] for suffix in ("png", "svg", "pdf")}
    for name, content in files.items():
        assert again[name] == content, name
        if name.endswith(".png"):
            assert content.startswith(b"\x89PNG\r\n")
        elif name.endswith(".pdf"):
            assert content.startswith(b"%PDF-")
        else:
            assert ElementTree.fromstring(content).tag.endswith("svg")
            assert b"http://www.w3.org" in content
        assert len(content) < 500_000


def test_what_cannot_be_plotted_is_refused(short_plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"cmbot\.plot: result: got str, expected a Plan or a Tracking"):
        cmbot.plot("triangle")  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtra, match=r"matplotlib is not installed; run: pip install .*\[plots\]"):
        plot(short_plan)


def test_free_moves_between_strokes_are_shaded_and_every_line_has_a_name(strokes_plan: Plan) -> None:
    torque = labelled(plot(strokes_plan))["guardrail_torque"]
    (axes,) = torque.axes
    (move,) = (each for each in strokes_plan.job.segments if each.name == "free_1")
    spans = [(span.get_x(), span.get_x() + span.get_width()) for span in axes.patches]
    assert spans == [pytest.approx((move.begin, move.end))]
    drawn = {str(line.get_label()) for line in axes.get_lines()} | {"free moves, as planned"}
    assert {text.get_text() for text in torque.legends[0].get_texts()} == drawn
    assert not any(name.startswith("_") for name in drawn)


def test_the_torque_says_about_which_point_it_is(short_plan: Plan) -> None:
    """On a guardrail it is about the foot; else the point is in its title."""
    mast = cmbot.load_scene("mast_inspection")
    point = robot_of(mast).foot_point
    standing: Any = SimpleNamespace(scene=mast, robot=robot_of(mast))
    about = f" about ({', '.join(f'{x:.3g}' for x in point)}) m"
    assert torque_chart(standing, ()).title == f"Torque on the mast{about}"
    assert torque_chart(short_plan, ()).title == "Torque on the guardrail"
