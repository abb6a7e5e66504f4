"""The goals of a reproduction: what holds and what does not, and why, follow from the figures."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from chang2021 import FACTORS, cells, goals
from chang2021.experiment import Experiment, Run, Variant
from chang2021.goals import compensation_goal, least_sag, posture_goal, rest_goal
from chang2021.paper import PAPER
from chang2021.tables import GoalTable
from cmbot.planning import Plan
from cmbot.simulation import (
    ErrorMetrics,
    MotionTracking,
    Residual,
    SimulationOptions,
    Statistics,
    Tracking,
    simulate,
)

MM = 1e-3
NONE = Variant(plan=None, trackings=(), why_not="no way")
size = st.floats(2.0, 20.0)


def statistics(mean: Any, deviation: Any) -> Statistics:
    """Of x, y and z, mm; the norm's are not used."""
    both = [MM * np.append(np.asarray(values, dtype=float), 0.0) for values in (mean, deviation)]
    return Statistics(mean=both[0], standard_deviation=both[1], rms=np.ones(4), peak_to_peak=np.ones(4))


def motion(mean, deviation=(0, 0, 0), *, static=None, vibration=(0, 0, 0), rest=None) -> MotionTracking:
    """A tracking error with given means and standard deviations, and what is left after the stop, mm."""
    nothing = np.zeros((2, 3))
    left = None
    if rest is not None:
        extent, diameter = MM * np.asarray(rest[:3], dtype=float), MM * float(rest[3])
        left = Residual(seconds=2.0, peak_to_peak=extent, diameter=diameter, decay=0.5)
    figures = ErrorMetrics(
        total=statistics(mean, deviation),
        static=statistics(mean if static is None else static, deviation),
        dynamic=statistics(vibration, vibration),
        path=statistics(mean, deviation),
        residual=left,
        mode_frequencies=np.empty(0),
        mode_power=np.empty(0),
    )
    arrays = dict.fromkeys(("error", "static", "command", "path_error"), nothing)
    return MotionTracking(t=np.array([0.0, 1.0]), stop=1.0, metrics=figures, **arrays)


def tracking(baseline: MotionTracking, planned: MotionTracking, factor: float = 1.0) -> Tracking:
    options = SimulationOptions(guardrail_factor=factor, link_factor=factor)
    return Tracking(options=options, baseline=baseline, planned=planned, seconds=0.0)


def run_of(found: Tracking, plan_: Any = None) -> Run:
    return Run(plan=plan_, equilibrium=found, undeformed=found)


def sagging(sag: Any) -> Any:
    """A compensated plan whose predicted sag goes from zero to twice these means, mm, at an even rate."""
    t = np.linspace(0.0, 1.0, 201)
    expected = 2 * MM * np.outer(t, sag)
    samples = SimpleNamespace(t=t, tool_point=np.zeros((201, 3)), expected_tool_point=expected)
    return SimpleNamespace(samples=samples)


def deviation_of(sag: Any) -> np.ndarray:
    """Of an even rate from 0 to 2 s: s / sqrt(3)."""
    return np.abs(np.asarray(sag, dtype=float)) / np.sqrt(3)


def only_rows(table: GoalTable, what: str) -> list[Any]:
    return [row for row in table.rows if row.what == what]


def verdicts(table: GoalTable) -> list[tuple[str, str, bool]]:
    return [(verdict.asked, verdict.found, verdict.holds) for verdict in table.verdicts]


def test_postures_are_judged_by_the_norm_and_the_rising_axis_is_named() -> None:
    table = posture_goal(run_of(tracking(motion([-3, 0.5, 4]), motion([0, -1, 3]))))
    *_, row = table.rows
    assert row.values == pytest.approx((100, -100, 25, 100 * (1 - np.sqrt(10 / 25.25))))
    assert row.holds is True
    assert "5.02 to 3.16 mm, 37.1 % less: the goal holds" in table.remarks[0]
    assert verdicts(table) == [("better postures: a smaller mean error", "5.02 -> 3.16 mm", True)]
    assert len(table.remarks) == 2
    assert table.remarks[1].startswith("Along y the absolute mean grows from 0.50 to 1.00 mm.")
    missed = posture_goal(run_of(tracking(motion([1, 2, 2]), motion([2, 2, 3]))))
    assert missed.rows[-1].holds is False
    assert [verdict.holds for verdict in missed.verdicts] == [False]
    assert "the goal does not hold" in missed.remarks[0]
    assert [remark[:7] for remark in missed.remarks[1:]] == ["Along x", "Along z"]


@given(
    factor=st.floats(0.7, 1.3).filter(lambda f: abs(f - 1) > 1e-6),
    sag=st.tuples(size, size, size),
    baseline=st.tuples(size, size, size),
)
def test_what_is_all_sag_falls_by_its_bound(
    factor: float, sag: tuple[float, ...], baseline: tuple[float, ...]
) -> None:
    """Of a sag s/f the predicted s is taken away; the baseline has b/f."""
    s, b = np.array(sag), np.array(baseline)
    left = (1 / factor - 1) * s
    found = tracking(
        motion(b / factor, deviation_of(b / factor)), motion(left, deviation_of(left)), factor=factor
    )
    table = compensation_goal(Variant(plan=sagging(s), trackings=(found,), why_not=""))
    for name, worth in (("mean", b / factor), ("standard deviation", deviation_of(b) / factor)):
        (cut,) = only_rows(table, f"reduction of {name}, %")
        (bound,) = only_rows(table, f"approximate bound of {name}, %")
        expected = 100 * (1 - abs(1 - factor) * s / b)
        asked = worth > 1.0
        for row, tolerance in ((cut, 1e-9), (bound, 1e-2)):
            assert [value is not None for value in row.values] == asked.tolist()
            numbers = [value for value in row.values if value is not None]
            np.testing.assert_allclose(numbers, expected[asked], atol=tolerance * 100)
        judged = expected[asked]
        assert cut.holds == (bool((judged >= 65).all()) if asked.any() else None)
        assert bound.goal == ""


def compensated_table(
    planned: MotionTracking, factor: float, sag=(2, 2, 2), baseline=(10, 10, 10)
) -> GoalTable:
    before = motion(np.asarray(baseline) / factor, (0.1, 0.1, 0.1))
    return compensation_goal(
        Variant(plan=sagging(sag), trackings=(tracking(before, planned, factor),), why_not="")
    )


@pytest.mark.parametrize(
    ("factor", "left", "holds"),
    [(1.0, 1.1, False), (1.0, 0.9, True), (0.8, 4.3, True), (0.8, 4.5, False), (1.3, 2.6, True)],
)
def test_the_goal_depends_on_the_stiffness(factor: float, left: float, holds: bool) -> None:
    table = compensated_table(motion([left, 0, 0]), factor)
    (row,) = only_rows(table, "reduction of mean, %")
    assert row.holds is holds
    assert row.goal == ("at least 90" if factor == 1.0 else "at least 65")
    asked = "90 % less" if factor == 1.0 else "65 % less, stiffness up to 30 % off"
    verdict = "the goal holds" if holds else "the goal does not hold"
    assert f"{3 if holds else 2} of 3 figures are at least {asked[:9]}; {verdict}" in table.remarks[0]
    count = f"{3 if holds else 2} of 3 figures"
    assert verdicts(table) == [(f"sag compensated: errors {asked}", count, holds)]


def test_small_figures_are_not_asked_for_and_nothing_beyond_what_the_goal_speaks_of() -> None:
    table = compensated_table(motion([5, 5, 0]), 1.0, baseline=(0.9, 1.1, 10))
    (row,) = only_rows(table, "reduction of mean, %")
    assert row.values[0] is None
    assert row.values[1:] == pytest.approx((100 * (1 - 5 / 1.1), 100))
    (row,) = only_rows(table, "reduction of standard deviation, %")
    assert (row.values, row.goal, row.holds) == ((None, None, None), "", None)
    headings, first, *_ = cells(table)
    assert headings == ("", "", "x", "y", "z", "goal", "holds")
    assert first == ("stiffness times 1", "reduction of mean, %", "-", "-354.5", "100.0", "at least 90", "no")
    table = compensated_table(motion([9, 9, 9]), 0.5)
    assert {(row.goal, row.holds) for row in table.rows} == {("", None)}
    # But for how far the tool is off its path.
    assert len(table.remarks) == 1
    assert "goal" not in table.remarks[0]
    assert table.verdicts == ()
    assert FACTORS[0] == 1.0
    assert sorted(FACTORS) == pytest.approx(np.linspace(0.7, 1.3, 7))


def test_a_sag_larger_than_the_baselines_is_the_reason() -> None:
    table = compensated_table(motion(0.3 / 0.7 * np.array([10, 12.5, 10])), 0.7, sag=(10, 12.5, 10))
    (why,) = (remark for remark in table.remarks if "falls by" in remark)
    assert why.startswith("At stiffness times 0.7 the mean along y falls by 62.5 %: 30 % of the sag was not")
    assert "1.25 times the baseline's mean. That bounds the reduction at about 62.5 %" in why
    # Otherwise vibration is.
    table = compensated_table(motion([0, 6, 0], vibration=[0, 5.5, 0]), 0.7)
    (why,) = (remark for remark in table.remarks if "falls by" in remark)
    assert "the sag alone would allow 94.0 %: vibration has a mean of 5.500 mm there" in why


def test_without_a_plan_the_reason_is_given() -> None:
    table = compensation_goal(NONE)
    assert (table.remarks, table.rows) == (("There is no plan: no way.",), ())
    assert verdicts(table) == [("sag compensated: errors 90 % less", "no plan", False)]


def experiment_of(planned: Run, compensated: Variant = NONE, quiet: Variant = NONE) -> Experiment:
    return Experiment(
        paper=PAPER[0],
        planned=planned,
        fixed=None,
        why_not="",
        compensated=compensated,
        quiet=quiet,
        least_sag=None,
    )


def swinging(size: float, factor: float, baseline: float) -> Any:
    rests = ([1, 1, 1, each] for each in (baseline, size))
    return tracking(*(motion([1, 1, 1], rest=rest) for rest in rests), factor)


def resting(planned: dict[float, float], quiet: dict[float, float]) -> Any:
    """The goal of rest, from the largest distances after the stop, mm, by the stiffness."""
    first, *others = (swinging(size, factor, 120) for factor, size in planned.items())
    trackings = tuple(swinging(size, factor, 120) for factor, size in quiet.items())
    run = replace(run_of(first), others=tuple(others))
    return rest_goal(experiment_of(run, quiet=Variant(plan=None, trackings=trackings, why_not="")))


def test_the_largest_swing_over_all_stiffnesses_counts() -> None:
    table = resting({1.0: 10.0, 0.7: 20.0, 1.3: 4.0}, {1.0: 4.0, 0.7: 6.0, 1.3: 2.0})
    assert [row.setting.split()[-1] for row in table.rows] == ["0.7", "1", "1.3", "them"]
    assert table.rows[1].values == pytest.approx((120, 10, 4, 40))
    assert table.rows[-1].values == pytest.approx((120, 20, 6, 30))
    assert (table.rows[-1].goal, table.rows[-1].holds) == ("share: at most 40", True)
    assert "At stiffness times 0.7 to 1.3 the tool swings through at most 6.0000 mm" in table.remarks[0]
    assert table.remarks[0].endswith("30.0 % of what it does with the paper's. The goal holds.")
    (verdict,) = verdicts(table)
    assert verdict == (
        "quiet laws: swing after the stop, over all stiffnesses, at most 40 %",
        "30.0 %",
        True,
    )


def test_quiet_laws_that_swing_miss_the_goal() -> None:
    table = resting({1.0: 1.0, 0.7: 20.0}, {1.0: 4.0, 0.7: 9.0})
    assert (table.rows[-1].holds, table.verdicts[0].holds) == (False, False)
    assert len(table.remarks) == 1


def test_without_a_simulated_rest_there_is_no_goal_of_it() -> None:
    found = tracking(motion([1, 1, 1]), motion([1, 1, 1]))
    without_rest = experiment_of(run_of(found))
    assert rest_goal(without_rest) is None
    assert [table.title.split(":")[0] for table in goals(without_rest)] == ["Postures", "Compensation"]


def test_least_sag_is_set_beside_least_torque() -> None:
    def sag_of(peak: float, mean: float) -> MotionTracking:
        made = motion([0, 0, 0])
        static = replace(made.metrics.static, mean=MM * np.array([0, 0, 0, mean]))
        figures = replace(made.metrics, static=static)
        return replace(made, static=MM * np.array([[0, 0, 1], [0, 0.6 * peak, 0.8 * peak]]), metrics=figures)

    def figures(peak: float, mean: float) -> Any:
        return SimpleNamespace(peak_guardrail_torque=peak, mean_guardrail_torque=mean)

    before: Any = SimpleNamespace(
        baseline=SimpleNamespace(figures=figures(500, 400)), figures=figures(300, 250)
    )
    after: Any = SimpleNamespace(figures=figures(330, 240))
    first = tracking(sag_of(20, 10), sag_of(10, 8))
    variant = Variant(plan=after, trackings=(tracking(sag_of(20, 10), sag_of(9, 6)),), why_not="")
    table = least_sag(run_of(first, before), variant)
    rows = [row.values for row in table.rows]
    expected = [(20, 10, 9, -10), (10, 8, 6, -25), (500, 300, 330, 10), (400, 250, 240, -4)]
    np.testing.assert_allclose(rows, expected)
    assert "10.00 % lower, the torque's 10.00 % higher" in table.remarks[0]
    assert next(cells(table)) == ("", "", *table.columns)
    assert least_sag(run_of(first, before), NONE).remarks == ("There is no plan: no way.",)


def test_a_simulated_arm_keeps_to_the_bound(compensated_short: tuple[Plan, Tracking]) -> None:
    """Vibration, and weights that turn with the deflection, shift it a little."""
    compensated, nominal_tracking = compensated_short
    other = simulate(compensated, SimulationOptions(guardrail_factor=0.7, link_factor=0.7))
    table = compensation_goal(Variant(plan=compensated, trackings=(nominal_tracking, other), why_not=""))
    nominal, softer = only_rows(table, "reduction of mean, %")
    assert nominal.holds is True
    (bound,) = only_rows(table, "approximate bound of mean, %")
    asked = [axis for axis, value in enumerate(softer.values) if value is not None]
    assert len(asked) >= 2
    for axis in asked:
        assert softer.values[axis] == pytest.approx(bound.values[axis], abs=2.0)
    assert softer.holds == all(softer.values[axis] >= 65 for axis in asked)
