"""Via-points that rule out every trajectory are refused at once, and others are not."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from small_scenes import problem_of, request_of, short_scene, torque_problem

from cmbot.common.errors import OptimisationFailed
from cmbot.planning import ExchangeReport
from cmbot.planning.torque import decomposition
from cmbot.planning.torque.decomposition import check_feasible, optimise
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through
from cmbot.robot import Dynamics


def in_seconds(seconds: float) -> TorqueProblem:
    legs = [{"by": [0, -0.1, 0], "seconds": seconds}]
    return problem_of(short_scene(tool_path={"legs": legs}, planner={"path_step_s": 0.002}))


def refused(problem: TorqueProblem, message: str) -> OptimisationFailed:
    told: list[ExchangeReport] = []
    with pytest.raises(OptimisationFailed, match=message) as caught:
        optimise(problem, told.append)
    assert told == []
    return caught.value


@pytest.mark.parametrize("seconds", [0.3, 1.0])
def test_legs_that_are_too_fast_are_refused_at_once(seconds: float) -> None:
    problem = in_seconds(seconds)
    failure = refused(problem, "too far apart for the time between them")
    assert failure.constraint.removeprefix("velocity, acceleration or jerk of ") in problem.joints
    assert failure.violation > 0.1
    # Somewhere on the way a limit is exceeded there; the message says where.
    assert 0.0 <= failure.time <= seconds
    assert f" at t = {failure.time:.2f} s, " in str(failure)


def test_feasibility_is_exact_to_its_samples() -> None:
    """Scaling time by c scales jerk by 1/c^3: the share that is needed tells how long a leg has to be."""

    def needed(seconds: float) -> float:
        with pytest.raises(OptimisationFailed) as caught:
            check_feasible(in_seconds(seconds))
        return caught.value.violation + 1

    assert needed(0.6) == pytest.approx(needed(1.2) * 8, rel=0.02)
    check_feasible(torque_problem("fixed"))


def test_a_margin_that_the_via_points_break_is_refused_at_once() -> None:
    plate = {"name": "plate", "box": [0.5, 0.02, 0.5], "xyz": [2.3, 0.6, -2.06]}
    problem = problem_of(short_scene(obstacles=[plate]))
    asked, form = problem.request, problem.parametrization
    distances = asked.cell.clearances.query(form.via_points).distance
    distance = distances.min()
    stricter = TorqueProblem(asked.with_options(safety_margin_m=float(distance) + 0.01), form, 0.0)
    failure = refused(stricter, "a via-point of the path breaks a bound")
    assert failure.constraint == "clearance"
    assert failure.violation == pytest.approx(0.1, rel=0.05)
    assert failure.time == asked.times[distances.argmin()]


def test_a_load_that_is_too_heavy_at_rest_is_refused_at_once() -> None:
    problem = problem_of(short_scene(robot={"payload_kg": 20.0}))
    failure = refused(problem, "a via-point of the path breaks a bound")
    assert failure.constraint == "joint torque"
    robot = problem.request.cell.robot
    ends = problem.parametrization.via_points[[0, -1]]
    share = np.abs(Dynamics(robot).static_efforts(ends).joint_torque / robot.limits.torque).max()
    assert failure.violation == pytest.approx(share - 1, abs=0.02)
    assert failure.time in problem.request.times[[0, -1]]


@given(st.lists(st.booleans(), min_size=1, max_size=80))
def test_stretches_hold_what_is_broken_and_its_surroundings(broken: list[bool]) -> None:
    near = np.zeros(len(broken), dtype=np.bool_)
    for k in np.flatnonzero(broken):
        near[max(k - decomposition._NEIGHBOURS, 0) : k + decomposition._NEIGHBOURS + 1] = True
    found = np.zeros(len(broken), dtype=int)
    for first, last in decomposition._stretches(np.array(broken)):
        found[first : last + 1] += 1
    np.testing.assert_array_equal(found, near)


def test_a_jump_in_a_long_path_is_found_by_its_surroundings() -> None:
    legs = [{"by": [0, -0.3, 0], "seconds": 60}]
    asked = request_of(short_scene(tool_path={"legs": legs, "via_points": 120}))
    via_points = np.repeat(asked.state.posture[None], 120, axis=0)
    via_points[60:, 2] += 1.0
    problem = TorqueProblem(asked, parametrization_through(asked, via_points, sliding=False), 0.0)
    least_jerk = problem.parametrization.trajectory
    bounds = [bound for bound in problem.bounds if bound.order > 0]
    broken = decomposition._broken_segments(least_jerk, bounds)
    assert list(np.flatnonzero(broken.any(axis=0))) == [2]
    ((first, last),) = decomposition._stretches(broken[:, 2])
    assert last - first < 60
    near, wider = (
        decomposition._least_share(problem, least_jerk, bounds, 2, first - more, last + more)
        for more in (0, 12)
    )
    # What is far away does nothing for it.
    assert near == pytest.approx(wider, rel=1e-6)
    assert near > 1.0
