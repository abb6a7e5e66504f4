"""Vibration suppression: the tool comes to rest without residual vibration; figures and bounds do not change.

Splines are changed in windows that are small however long the path, and at rest at their ends.
"""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.spatial.distance import pdist
from small_motions import track
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.common.arrays import FloatArray
from cmbot.elastic.sag import TooSoftError
from cmbot.planning import Plan, plan
from cmbot.planning.attempts import motion
from cmbot.planning.budget import Deadline
from cmbot.planning.flexibility import leg_vibration
from cmbot.planning.flexibility.vibration_suppression import Change, Window, legs_by_window
from cmbot.planning.workcell.workcell import Workcell
from cmbot.simulation import SimulationOptions
from cmbot.simulation.tracking import elastic_arm_of
from cmbot.trajectory.quintic import QuinticTrajectory
from cmbot.trajectory.spline_space import SplineSpace

THERE_AND_BACK = [{"by": [0, -0.3, 0], "seconds": 6}, {"by": [0, 0.3, 0], "seconds": 5}]
# By other laws the tool sways more at work where it swings less after it.
QUICK, TRAPEZOIDAL = {"kind": "jerk_limited", "ramp": 0.1}, {"kind": "trapezoidal"}
EXACT = {"quiet_stiffness_share": 0.0}
# Fine enough that the amplitudes of a few micrometres are the motion's.
FINE = SimulationOptions(step_s=0.001, settle_s=1.0)


def planned(modes: int, via_points: int = 28, law: object = QUICK, **planner: object) -> Plan:
    planner |= {"knots": "sliding", "start": "pinned", "quiet_modes": modes}
    path = {"legs": THERE_AND_BACK, "via_points": via_points, "speed_profile": law}
    return plan(short_scene(tool_path=path, planner=planner))


@pytest.fixture(scope="module")
def unsuppressed() -> Plan:
    return planned(0, law=TRAPEZOIDAL)


@pytest.fixture(scope="module")
def unsuppressed_quick() -> Plan:
    return planned(0)


@pytest.fixture(scope="module")
def suppressed() -> Plan:
    """For the modelled stiffness alone."""
    return planned(2, law=TRAPEZOIDAL, **EXACT)


@pytest.fixture(scope="module")
def robust() -> Plan:
    return planned(2)


def swing(of: Plan, options: SimulationOptions) -> FloatArray:
    """How far the tool moves along x, y and z after the stop (3,), less the sag, m."""
    motion = of.trajectory
    tracking = track(elastic_arm_of(of, options), of.task, motion, options)
    return np.ptp(tracking.dynamic[tracking.t > tracking.stop + 1e-9], axis=0)


def diameter(of: Plan, options: SimulationOptions) -> float:
    """Largest distance between two positions of the tool after the stop, m."""
    motion = of.trajectory
    tracking = track(elastic_arm_of(of, options), of.task, motion, options)
    return float(pdist(tracking.dynamic[tracking.t > tracking.stop + 1e-9][::5]).max())


def test_the_tool_comes_to_rest(unsuppressed: Plan, suppressed: Plan) -> None:
    """In the simulation, which knows nothing of how it was done."""
    before, after = (float(np.linalg.norm(swing(each, FINE))) for each in (unsuppressed, suppressed))
    # What is left are the faster modes.
    assert after < 0.15 * before


def test_nothing_else_changes(unsuppressed: Plan, suppressed: Plan, tmp_path: Path) -> None:
    assert load_plan(save(suppressed, tmp_path / "plan"), verify=True).certificate.holds
    np.testing.assert_allclose(suppressed.trajectory.q, unsuppressed.trajectory.q, rtol=0, atol=1e-12)
    assert np.abs(suppressed.trajectory.jumps(3)).max() < 1e-9
    ends = suppressed.trajectory.t[[0, -1]]
    for order in (1, 2, 3):
        assert np.abs(suppressed.trajectory.evaluate(ends, order)).max() < 1e-9
    assert suppressed.figures.peak_guardrail_torque <= unsuppressed.figures.peak_guardrail_torque * (1 + 1e-5)
    moved = suppressed.trajectory.evaluate(unsuppressed.samples.t) - unsuppressed.samples.q
    assert 1e-9 < np.abs(moved).max() < 1e-3


def test_bounds_that_are_met_already_stay_met() -> None:
    """With hardly any room for the tool, the change is worked out around what is at its bound."""
    tight = {"max_tool_deviation_m": 2e-4}
    with_it, without = planned(2, **tight), planned(0, **tight)
    assert with_it.certificate.holds
    assert with_it.sway.swing_mm <= without.sway.swing_mm


def test_fixed_knots_are_left_to_the_letter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(motion, "suppress_vibration")
    assert plan(short_scene()).options.quiet_modes == 2


def test_vibration_of_links_alone_is_suppressed_too() -> None:
    """On a rigid hold the links still bend."""
    rigid = short_scene(guardrail={"bays": 0}, planner={"knots": "sliding", "start": "pinned"})
    with_it, without = plan(rigid), plan(rigid.with_options(quiet_modes=0))
    assert with_it.sway.swing_mm < 0.9 * without.sway.swing_mm


def test_a_window_without_suppression_leaves_the_others_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    change = Window.change

    def first_in_vain(window: Window, *rows: Any) -> Change | None:
        return None if window.start == 0 else change(window, *rows)

    monkeypatch.setattr(Window, "change", first_in_vain)
    made, without = planned(2, via_points=81), planned(0, via_points=81)
    assert made.sway.swing_mm < 0.9 * without.sway.swing_mm
    first = without.trajectory.t[without.trajectory.t < 3.0]
    np.testing.assert_array_equal(made.trajectory.evaluate(first), without.trajectory.evaluate(first))
    assert made.certificate.holds


def test_where_the_time_is_over_the_plan_is_left_as_it_is(
    monkeypatch: pytest.MonkeyPatch, unsuppressed_quick: Plan
) -> None:
    real = motion.optimise

    def takes_long(problem: Any, *rest: Any, **more: Any) -> Any:
        done = real(problem, *rest, **more)
        monkeypatch.setattr(Deadline, "expired", lambda *_: True)
        return done

    monkeypatch.setattr(motion, "optimise", takes_long)
    late = planned(2)
    assert late.certificate.holds
    np.testing.assert_array_equal(late.trajectory.a, unsuppressed_quick.trajectory.a)


def test_what_stiffness_may_be_is_suppressed(unsuppressed_quick: Plan, robust: Plan) -> None:
    """The largest swing over the interval falls, with no more jerk than before."""
    swings = []
    for factor in (0.7, 0.85, 1.0, 1.15, 1.3):
        options = SimulationOptions(settle_s=1.0, guardrail_factor=factor, link_factor=factor)
        swings.append([diameter(each, options) for each in (unsuppressed_quick, robust)])
    before, after = np.max(swings, axis=0)
    assert after < 0.6 * before
    times = np.linspace(0.0, 11.0, 1101)
    jerks = [np.abs(each.trajectory.evaluate(times, 3)).max() for each in (unsuppressed_quick, robust)]
    assert jerks[1] < 1.02 * jerks[0]


@pytest.mark.parametrize("after", [(1.0, 0.95), (1.05, 0.1)])
def test_a_change_that_does_not_help_is_not_made(
    monkeypatch: pytest.MonkeyPatch, unsuppressed_quick: Plan, after: tuple[float, float]
) -> None:
    """Where the tool swings hardly less, or sways more at work."""
    real, seen = Workcell.sway_of, list[Any]()

    def in_vain(*given: Any) -> Any:
        seen.append(real(*given))
        factors = after if len(seen) == 2 else (1.0, 1.0)
        return tuple(np.multiply(seen[0], factors))

    monkeypatch.setattr(Workcell, "sway_of", in_vain)
    left = planned(2)
    assert len(seen) == 2
    np.testing.assert_array_equal(left.trajectory.a, unsuppressed_quick.trajectory.a)


def test_a_base_that_hardly_bears_the_arm_is_left_as_it_is(
    monkeypatch: pytest.MonkeyPatch, unsuppressed_quick: Plan
) -> None:
    def topples(*_: Any) -> Any:
        raise TooSoftError("sway", "factors", "a posture from which the arm topples", "a stiffer base")

    monkeypatch.setattr(leg_vibration, "require_bearing", topples)
    np.testing.assert_array_equal(planned(2).trajectory.a, unsuppressed_quick.trajectory.a)


def spaced(segments: int) -> SplineSpace:
    return SplineSpace(np.linspace(0.0, 0.4 * segments, segments + 1))


def torque_problem(segments: int) -> Any:
    robot = SimpleNamespace(limits=SimpleNamespace(jerk=np.array([1.0, 2.0])))
    return SimpleNamespace(space=spaced(segments), request=SimpleNamespace(cell=SimpleNamespace(robot=robot)))


@pytest.mark.parametrize("legs", [10, 40, 160])
def test_windows_do_not_grow_with_the_path(legs: int) -> None:
    lengths = np.tile([25, 5], legs // 2)
    knots = np.append(0, np.cumsum(lengths))
    problem = torque_problem(int(knots[-1]))
    windows = legs_by_window(problem.space, problem.space.t[knots])
    assert [leg for window in windows for leg in window] == list(pairwise(knots))
    numbers = [Window(problem, window).coefficients for window in windows]
    assert max(map(len, numbers)) <= 64 + 12
    for window, own in zip(windows, numbers, strict=True):
        assert own.min() >= window[0][0]
        assert own.max() + 4 <= window[-1][1]


def test_a_long_leg_is_changed_near_its_end() -> None:
    problem = torque_problem(1000)
    (window,) = legs_by_window(problem.space, np.array([0.0, 400.0]))
    np.testing.assert_array_equal(Window(problem, window).coefficients, np.arange(936, 997))


def test_short_legs_find_company() -> None:
    space = spaced(140)
    assert legs_by_window(space, space.t[[0, 3, 70, 135, 140]]) == [
        [(0, 3), (3, 70)],
        [(70, 135), (135, 140)],
    ]


def test_a_window_takes_its_vibration_away(rng: np.random.Generator) -> None:
    """Within bounds, and with no more jerk than there was."""
    problem = torque_problem(20)
    space, d, limits = problem.space, 2, problem.request.cell.robot.limits.jerk
    given = space.trajectory(1e-4 * rng.normal(size=(3 * len(space.t), d)))
    times = np.linspace(0.01, space.t[-1] - 0.01, 200)
    weights = rng.normal(size=(len(times), 2, d))

    def vibration(of: QuinticTrajectory) -> np.ndarray:
        return np.asarray(np.einsum("kcj,kj->c", weights, of.evaluate(times, 4)))

    leg: Any = SimpleNamespace(times=times, weights=weights, vibration=vibration, cases=1)
    window = Window(problem, [(0, 20)])
    window.bring_to_rest(leg, given)
    middle = sparse.csr_array(
        sparse.kron(space.design(space.t[[10]] + 0.1, 0) @ space.basis, np.array([[1.0, 0.0]]))
    )
    free = window.change(middle, np.array([np.inf]))
    moved = float((middle @ free.x.ravel())[0])
    held = window.change(middle * np.sign(moved), np.array([0.5 * abs(moved)]))
    assert (middle @ held.x.ravel())[0] * np.sign(moved) < 0.5 * abs(moved) + 1e-9
    before, fine = np.hypot(*vibration(given)), np.linspace(0, space.t[-1], 801)
    for found in (free, held):
        z = np.stack([given.q, given.v, given.a], axis=1).reshape(-1, d)
        changed = space.trajectory(z + space.basis @ found.x)
        assert np.hypot(*vibration(changed)) == pytest.approx((1 - found.share) * before, rel=1e-6)
        assert found.share > 0.5
        most = [np.abs(each.evaluate(fine, 3) / limits).max() for each in (given, changed)]
        assert most[1] < 1.01 * most[0]
    assert window.change(middle * np.sign(moved), np.array([-1e9])) is None
