"""The approach: certified motions to a better start, along the self-motion or around it."""

from dataclasses import replace
from itertools import chain, pairwise, repeat

import numpy as np
import pytest
from small_scenes import parts, request_of, short_scene

from cmbot.accuracy import stroke_sway
from cmbot.collision import Clearances
from cmbot.common.errors import PathNotFound
from cmbot.elastic.modes import arm_modes
from cmbot.planning import JobState, Plan, Segment, certify_move, plan
from cmbot.planning.budget import Deadline
from cmbot.planning.free_motion import free_move
from cmbot.planning.free_motion.approach import joined_starts, plan_approach
from cmbot.planning.free_motion.free_move import FreeMove, plan_move
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.rrt_connect import MOST_GROWTHS, rrt_connect
from cmbot.planning.path.gradient_projection import self_motion_postures
from cmbot.robot import Dynamics, Kinematics
from cmbot.trajectory import QuinticTrajectory


def test_the_triangles_approach_is_certified(triangle_plan: Plan) -> None:
    approach = triangle_plan.approach
    assert approach.certificate.holds
    np.testing.assert_allclose(approach.trajectory.q[0], triangle_plan.scene.posture, atol=1e-12)
    np.testing.assert_allclose(approach.trajectory.q[-1], triangle_plan.trajectory.q[0], atol=1e-12)
    ends = approach.trajectory.t[[0, -1]]
    for order in (1, 2, 3):
        assert np.abs(approach.trajectory.evaluate(ends, order)).max() < 1e-9
    use = approach.certificate.figures.limit_use
    assert max(use.velocity, use.acceleration, use.jerk) == pytest.approx(0.95, rel=1e-6)


def test_a_near_start_is_reached_along_the_self_motion() -> None:
    """The tool then stays where it is, within a few millimetres."""
    asked = request_of(short_scene())
    postures = self_motion_postures(asked)
    approach = plan_approach(asked, postures[2], np.array(postures))
    assert approach.certificate.holds
    coarse = asked.with_options(chart_spacing=0.2)
    approach = plan_approach(coarse, postures[2], np.array(postures))
    assert approach.along_self_motion
    assert approach.certificate.figures.max_tool_deviation < 0.02


def test_from_a_folded_posture_the_base_bears_no_more_than_at_work(triangle_plan: Plan) -> None:
    """Not even while the arm moves: it goes no faster than that allows."""
    folded = np.radians([26.0, -146, 43, 161, -84, -112, -55])
    asked = replace(request_of(triangle_plan.scene), state=JobState(posture=folded))
    end = triangle_plan.start.posture
    approach = plan_approach(asked, end, end[None])
    torque = np.linalg.norm(
        Dynamics(asked.cell.robot).static_efforts(np.stack([folded, end])).guardrail_torque, axis=1
    )
    assert torque[0] < 170
    assert approach.certificate.holds
    assert approach.certificate.figures.peak_guardrail_torque < 1.002 * torque[1]


def test_starts_that_are_joined_are_parts_of_the_self_motion() -> None:
    asked = request_of(short_scene())
    chart = np.array(self_motion_postures(asked))
    folded = chart.copy()
    folded[:, 0] = np.radians(90)  # link_1 across the guardrail
    both = np.vstack([chart, folded])
    parts_joined, ways = zip(*joined_starts(asked, both), strict=True)
    once = np.sum(parts_joined, axis=0)
    for part, way in zip(parts_joined, ways, strict=True):
        np.testing.assert_array_equal(way[0], asked.state.posture)
        assert np.abs(both[part] - way[-1]).max(axis=1).min() < 1e-12
    assert once.max() == 1
    assert once[: len(chart)].any()
    assert not once[len(chart) :].any()
    assert list(joined_starts(asked, folded)) == []


def test_a_known_way_is_taken_where_no_straight_line_is_free(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is sought again: the way to one posture of the self-motion, and on along that."""
    asked = request_of(short_scene())
    chart = np.array(self_motion_postures(asked))
    middle = asked.state.posture + np.array([0, 0, 0, 0.3, 0.3, 0, 0.5])
    way = np.stack([asked.state.posture, middle, chart[-1]])
    monkeypatch.setattr(FreeSpace, "straight", lambda *_: False)
    monkeypatch.setattr(free_move, "rrt_connect", None)
    approach = plan_approach(asked, chart[-3], chart[-4:], way=way)
    assert approach.certificate.holds
    q = approach.trajectory.q
    assert np.abs(q - middle).max(axis=1).min() < 0.2  # at a knot of the spline
    assert np.abs(q[-1] - chart[-3]).max() < 1e-12


def test_a_blocked_approach_is_refused() -> None:
    """The goal lies inside an obstacle: nothing leads there."""
    asked = request_of(short_scene())
    goal = asked.state.posture.copy()
    goal[0] = np.radians(90)  # link_1 across the guardrail
    expected = (
        r"no collision-free approach: in the start of the work \S+ and \S+ come within the safety margin"
    )
    with pytest.raises(PathNotFound, match=expected) as caught:
        plan_approach(asked, goal, asked.state.posture[None])
    assert all(name in str(caught.value) for name in caught.value.pair)
    goal = asked.state.posture.copy()
    goal[6] = np.radians(175)
    with pytest.raises(PathNotFound, match="in the start of the work joint_7 is out of its range"):
        plan_approach(asked, goal, asked.state.posture[None])
    _, J = Kinematics(asked.cell.robot).tool_jacobian(asked.state.posture)
    smallest = np.linalg.svd(J, compute_uv=False)[-1]
    assert caught.value.smallest_singular_value == pytest.approx(smallest)


def test_the_way_to_a_start_that_is_only_better_is_not_sought_for_long(
    triangle_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, most = request_of(triangle_plan.scene), list[int]()
    monkeypatch.setattr(FreeSpace, "straight", lambda *_: False)
    monkeypatch.setattr(free_move, "rrt_connect", lambda *arguments: most.append(arguments[-1]))
    for dispensable in (True, False):
        with pytest.raises(PathNotFound, match="was found"):
            plan_approach(
                asked, triangle_plan.start.posture, asked.state.posture[None], dispensable=dispensable
            )
    assert 0 < most[0] < most[1] == MOST_GROWTHS


def test_what_is_in_the_way_of_an_approach_is_named(triangle_plan: Plan) -> None:
    """The time is over, and so is the share that an approach may take beyond it."""
    over = Deadline(1.0, iter([0.0, *999 * [2.0]]).__next__)
    asked = replace(request_of(triangle_plan.scene), deadline=over)
    assert over.expired(0.9)
    assert not over.expired(1.5)
    expected = r"was found \(straight there \S+ and \S+ come too near\) before the time, 1 s .*, was over$"
    with pytest.raises(PathNotFound, match=expected) as caught:
        plan_approach(asked, triangle_plan.start.posture, asked.state.posture[None])
    assert caught.value.pair is not None


def test_before_the_limit_the_time_does_not_matter(triangle_plan: Plan) -> None:
    """Trees have to seek the way."""
    found = list[Segment]()
    for later in (0.0, 59.0):
        # Nothing is over when the deadline is set and the search begins.
        clock = chain([0.0] * 2, repeat(later)).__next__
        asked = replace(request_of(triangle_plan.scene), deadline=Deadline(60.0, clock))
        found.append(plan_approach(asked, triangle_plan.start.posture, asked.state.posture[None]))
    one, other = (each.trajectory for each in found)
    np.testing.assert_array_equal(one.q, other.q)


def test_connected_postures_are_joined_by_free_lines(triangle_plan: Plan, rng: np.random.Generator) -> None:
    scene = triangle_plan.scene
    robot, _, posture, clearances = parts(scene)
    space = FreeSpace(robot, clearances, 0.02, lambda q: np.zeros(len(q)))
    goal = triangle_plan.start.posture
    path = rrt_connect(space, posture, goal[None])
    short = space.shorten(path)
    for line in (path, short):
        np.testing.assert_array_equal(line[[0, -1]], [posture, goal])
        for start, end in pairwise(line):
            between = start + rng.uniform(0, 1, (50, 1)) * (end - start)
            assert clearances.query(between).distance.min() >= 0.02
    length = [np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in (path, short)]
    assert length[1] <= length[0] + 1e-12


def test_a_pinned_start_keeps_the_posture_and_needs_no_approach() -> None:
    """What it asks at rest is the most that is asked, which leaves the mean to be lowered."""
    scene = short_scene(planner={"knots": "sliding", "start": "pinned"})
    planned = plan(scene)
    assert planned.approach is None
    assert planned.start.moved == 0.0
    np.testing.assert_allclose(planned.trajectory.q[0], scene.posture, atol=1e-12)
    torque = Dynamics(planned.robot).static_efforts(scene.posture[None]).guardrail_torque
    assert {report.stage for report in planned.passes} == {"mean square"}
    assert planned.figures.peak_guardrail_torque == pytest.approx(np.linalg.norm(torque), rel=1e-5)
    assert planned.figures.mean_guardrail_torque < planned.baseline.figures.mean_guardrail_torque


def test_its_samples_are_measured_once(triangle_plan: Plan) -> None:
    samples, approach = triangle_plan.approach_samples, triangle_plan.approach
    assert triangle_plan.approach_samples is samples
    assert samples.t[-1] == approach.trajectory.duration
    np.testing.assert_allclose(np.diff(samples.t)[:-1], 0.01, rtol=1e-9)
    np.testing.assert_array_equal(samples.q, approach.trajectory.evaluate(samples.t))
    figures = approach.certificate.figures
    peak = np.linalg.norm(samples.guardrail_torque, axis=1).max()
    assert peak == pytest.approx(figures.peak_guardrail_torque, rel=1e-3)
    # Measured from where the work starts, not from the legs.
    away = np.linalg.norm(samples.tool_point - triangle_plan.task.path.corners[0], axis=1)
    np.testing.assert_allclose(samples.tool_deviation, away, rtol=0, atol=1e-12)


def test_its_peak_stands_beside_that_of_the_work(triangle_plan: Plan, short_plan: Plan) -> None:
    peak = triangle_plan.approach.certificate.figures.peak_guardrail_torque
    row = ("peak torque on the approach, Nm", "-", f"{peak:.2f}")
    for planned, shown in ((triangle_plan, True), (short_plan, False)):
        rows = list(planned.rows())
        assert (row in rows) == shown
        whole = {name: value for name, *_, value in rows}["peak torque on the guardrail, whole job, Nm"]
        assert whole == f"{planned.job.figures.peak_guardrail_torque:.2f}"
    assert short_plan.approach_samples is None


def test_a_certificate_made_again_is_the_same(triangle_plan: Plan) -> None:
    """The planner and the archive look at the same grid, with the tool held where the work starts."""
    task, approach = triangle_plan.task.held_at_start(), triangle_plan.approach
    clearances = Clearances(triangle_plan.robot, triangle_plan.scene.all_obstacles)
    robot, options = triangle_plan.robot, triangle_plan.options
    start, end = triangle_plan.scene.posture, triangle_plan.start.posture
    again = certify_move(robot, task, approach.trajectory, clearances, options, start, end)
    assert again == approach.certificate
    points = task.path.position(np.linspace(0.0, task.path.duration, 5))
    np.testing.assert_array_equal(points, np.tile(triangle_plan.task.path.corners[0], (5, 1)))
    np.testing.assert_array_equal(task.path.orientation, triangle_plan.task.path.orientation)
    assert task.keep == triangle_plan.task.keep


def test_a_short_way_takes_three_periods_of_what_bends() -> None:
    """Alone it would take a quarter of that, and shake the base when the work begins."""
    asked = request_of(short_scene())
    arm, start = asked.cell.arm, asked.state.posture
    end = self_motion_postures(asked)[0]
    end = start + 0.05 * (end - start)
    approach = plan_approach(asked, end, end[None])
    frequency = arm_modes(arm, start).frequencies[0]
    assert approach.duration == pytest.approx(3 / frequency, rel=1e-9)
    swing = stroke_sway(arm, approach.trajectory, 0.3).largest[1]
    t = approach.trajectory.t / 4
    quick = replace(approach.trajectory, t=t, v=4 * approach.trajectory.v, a=16 * approach.trajectory.a)
    assert swing < 0.2 * stroke_sway(arm, quick, 0.3).largest[1]


def test_a_move_is_no_slower_than_what_it_asks_at_rest_has_it() -> None:
    """Where that is more than it may ask, a slower arm asks hardly less, but a faster one more."""
    asked = request_of(short_scene()).tool_off
    start, end = np.radians([[-13, 135, -49, 79, 104, 93, -10], [-164, 139, -129, 121, -14, 74, 93]])
    move = FreeMove(name="move", start=start, end=end, start_name="here", end_name="there")
    trajectory = plan_move(asked, move).trajectory
    times, dynamics = np.linspace(*trajectory.t[[0, -1]], 4000), Dynamics(asked.cell.robot)
    q, v, a = (trajectory.evaluate(times, order) for order in range(3))

    def peak(speed: float) -> float:
        torque = dynamics.efforts(q, speed * v, speed**2 * a).guardrail_torque
        return float(np.linalg.norm(torque, axis=1).max())

    ends = np.linalg.norm(dynamics.static_efforts(np.stack([start, end])).guardrail_torque, axis=1)
    assert peak(0.0) > 1.001 * ends.max()
    assert peak(1.0) <= 1.001 * peak(0.0) < peak(1.25)


def test_where_joints_are_nearly_at_their_limits_at_rest_a_move_keeps_a_part_of_what_is_left() -> None:
    asked = request_of(short_scene()).tool_off
    ends = np.radians([[-13, 135, -49, 79, 104, 93, -10], [-26, 104, -48, 77, 144, 114, -4]])
    move = FreeMove(name="move", start=ends[0], end=ends[1], start_name="here", end_name="there", allowed=1e4)
    free, robot = plan_move(asked, move).trajectory, asked.cell.robot

    def use(trajectory: QuinticTrajectory, speed: float) -> float:
        q, v, a = (trajectory.evaluate(np.linspace(*trajectory.t[[0, -1]], 4000), k) for k in range(3))
        torque = Dynamics(robot).efforts(q, speed * v, speed**2 * a).joint_torque
        return float((np.abs(torque) / robot.limits.torque).max())

    # As much weaker an arm as uses 98 % at rest.
    weaker = use(free, 0.0) / 0.98
    limits = replace(robot.limits, torque=weaker * robot.limits.torque)
    cell = replace(asked.cell, robot=replace(robot, limits=limits))
    slow = plan_move(replace(asked, cell=cell), move).trajectory
    assert use(free, 1.0) > weaker
    assert 0.98 < use(slow, 1.0) / weaker <= 1 - 0.25 * 0.02 + 1e-4
    assert 1.0 < slow.t[-1] / free.t[-1] < 4.0
