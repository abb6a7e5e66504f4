"""What is enclosed of a tool that stands still while its path turns and bends, against dense samples."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from small_scenes import parts, short_scene, tool_points

from cmbot.planning.certification.certificate import range_check
from cmbot.planning.certification.enclosed_motion import EnclosedMotion, speed_deviation
from cmbot.robot import Dynamics, Robot
from cmbot.trajectory import Peak, Pieces, QuinticTrajectory

SECONDS = 4.0
TURN = {"to": {"frame": "tool", "xyz": [0.0, 0.0, 0.0], "rpy_deg": [0, 0, 140]}, "seconds": SECONDS}
ARC = {
    "arc": {"frame": "tool", "centre": [0.3, 0, 0], "axis": [0, 0, 1], "angle_deg": 120},
    "seconds": SECONDS,
}


def still(q: Any, knots: int = 2) -> QuinticTrajectory:
    rest = np.zeros((knots, len(q)))
    return QuinticTrajectory(t=np.linspace(0.0, SECONDS, knots), q=np.tile(q, (knots, 1)), v=rest, a=rest)


def enclosed(leg: dict[str, Any], knots: int, *, coarse: bool) -> tuple[EnclosedMotion, Any, Any]:
    """The motion, and the timed poses at dense samples with the one where the tool stays."""
    robot, task, q, _ = parts(short_scene(tool_path={"legs": [leg], "via_points": 40}))
    motion = EnclosedMotion(robot, task, still(q, knots), None, coarse=coarse)
    return motion, task, task.path.poses(np.linspace(0, SECONDS, 4001))


def test_the_turning_goal_is_part_of_what_interpolation_misses() -> None:
    motion, _, goals = enclosed(TURN, 2, coarse=True)
    turned = np.arccos(np.clip((np.einsum("ij,nij->n", goals.rotation[0], goals.rotation) - 1) / 2, -1, 1))
    peak = motion.tool_rotation()
    assert turned.max() == pytest.approx(np.radians(140), abs=1e-6)
    # What interpolation may miss is never nothing.
    assert turned.max() - 1e-6 <= peak.value < peak.bound


def test_lag_and_deviation_beside_a_bend_are_enclosed_closely() -> None:
    motion, task, goals = enclosed(ARC, 400, coarse=False)
    times = np.linspace(0, SECONDS, 4001)
    along = task.path.leg_directions(times)
    lag = np.abs(np.einsum("nd,nd->n", goals.point[0] - goals.point, along)).max()
    peak = motion.tool_lag()
    assert lag - 1e-6 <= peak.bound <= 1.1 * lag
    # On a bend that is what is left of it, square to the tangent at the timed place.
    away = goals.point[0] - goals.point
    beside = np.linalg.norm(away - (away * along).sum(axis=1, keepdims=True) * along, axis=1).max()
    assert beside - 1e-6 <= motion.tool_deviation().bound <= 1.1 * beside


@pytest.mark.parametrize("place", [0.0, 1e4])
@pytest.mark.parametrize("moved", [1e-6, 6.0])
@pytest.mark.parametrize("seconds", [1e-5, 1e5])
def test_enclosures_hold_at_the_ends_of_their_range(place: float, moved: float, seconds: float) -> None:
    """Where joints are, how far they move in a segment, and how long that lasts, as docs/method.md says."""
    robot, task, *_ = parts(short_scene())
    rng, n = np.random.default_rng(int(place + moved + seconds)), 7
    knots = [moved * rng.uniform(-1, 1, (3, n)) / seconds**order for order in range(3)]
    q, v, a = place + knots[0], *knots[1:]
    motion = QuinticTrajectory(t=seconds * np.arange(3), q=q, v=v, a=a)
    found = EnclosedMotion(robot, task, motion, None)
    efforts = Dynamics(robot).efforts(*motion.states(np.linspace(0, 2 * seconds, 4001))[:3])
    use = np.abs(efforts.joint_torque) / robot.limits.torque
    check, (peak, *_) = found.joint_torque(), found.guardrail_torque()
    assert use.max() <= check.value / check.bound <= (1 + 1e-3) * use.max()
    held = np.abs(robot.holding_torque(efforts.guardrail_wrench)).max(axis=0)
    for most, brake in zip(held, found.holding_torque(), strict=True):
        assert most <= brake.value <= (1 + 1e-3) * most
    torque = np.linalg.norm(efforts.guardrail_torque, axis=1).max()
    assert torque <= peak.bound <= (1 + 1e-3) * torque


@pytest.mark.parametrize("bounded", ["max_speed", "speed_tolerance"])
def test_pieces_are_short_enough_for_what_is_asked_of_the_tool(bounded: str) -> None:
    """One joint turns, from rest to rest, and the tool is short: what is missed is not hidden by its point.

    The tool turns by the joint's angle; it is quickest in the middle, at 15/8 of the mean rate, on a circle
    whose diameter is the way that half a turn of the joint moves it.
    """
    robot, task, q, _ = parts(short_scene())
    model = robot.model.copy()
    tool = model.frames[robot.tool_frame_id].placement.copy()
    tool.translation *= 0.01
    model.frames[robot.tool_frame_id].placement = tool
    robot, rest = replace(robot, model=model), np.zeros((2, 7))

    def turned(joint: int, angle: float, seconds: float, **bounds: float) -> EnclosedMotion:
        ends = q + np.outer([0.0, angle], np.eye(7)[joint])
        motion = QuinticTrajectory(t=np.array([0.0, seconds]), q=ends, v=rest, a=rest)
        return EnclosedMotion(robot, replace(task, **bounds), motion, None)

    half_turn = q + np.outer([0.0, np.pi], np.eye(7)[0])
    radius = 0.5 * np.linalg.norm(np.subtract(*tool_points(robot, half_turn)))
    for angle in np.linspace(0.3, 2.0, 40):
        assert -1e-9 <= turned(6, angle, 8.0).tool_rotation().bound - angle <= 3e-8
        quickest = 15 / 8 * angle / 0.4 * radius
        assert -1e-9 <= turned(0, angle, 0.4, **{bounded: 1.0}).tool_speed().bound - quickest <= 3e-8


def test_the_unit_of_force_does_not_matter() -> None:
    """An arm of a millionth of the mass, and of the strength, uses the same share of that."""
    robot, task, q, _ = parts(short_scene())
    unit, model, rest = 2.0**-20, robot.model.copy(), np.zeros((2, 7))
    for k, body in enumerate(model.inertias):
        model.inertias[k] = pin.Inertia(unit * body.mass, body.lever, unit * body.inertia)
    limits = replace(robot.limits, torque=unit * robot.limits.torque)
    ends = q + np.outer([0.0, 1.0], [1.0, -0.5, 0.7, 1.2, -0.3, 0.8, 2.0])
    motion, shares = QuinticTrajectory(t=np.array([0.0, 0.8]), q=ends, v=rest, a=rest), []
    for each in (robot, replace(robot, model=model, limits=limits)):
        check = EnclosedMotion(each, task, motion, None).joint_torque()
        shares.append(check.value / check.bound)
    assert shares[0] == pytest.approx(shares[1], rel=1e-13)


def test_no_process_speed_is_missed_where_none_is_asked() -> None:
    robot, task, q, _ = parts(short_scene())
    assert EnclosedMotion(robot, task, still(q, 3), None).process_speed() == Peak(time=0, value=0, bound=0)


def test_what_interpolation_misses_of_a_velocity_is_a_share_of_the_speed_that_is_asked() -> None:
    """2 mm/s of 0.1 m/s, of a tool that is just as quick as it should be."""
    pieces = Pieces.between(still(np.zeros(1), 3), np.empty(0))
    path: Any = SimpleNamespace(process_speed=lambda times: np.full(len(times), 0.1))
    velocity = np.tile([0.0, 0.06, 0.08], (pieces.times.size, 1))
    peak = speed_deviation(path, pieces, velocity, np.full(len(pieces.start), 0.002))
    assert peak.value == pytest.approx(0.0, abs=1e-12)
    assert peak.bound == pytest.approx(0.02)


def test_the_middle_of_a_range_need_not_be_zero(cmbot_robot: Robot) -> None:
    """Of a joint that turns between 0.5 and 2.5 rad."""
    limits = cmbot_robot.limits
    lower, upper = limits.lower.copy(), limits.upper.copy()
    lower[1], upper[1] = 0.5, 2.5
    robot = replace(cmbot_robot, limits=replace(limits, lower=lower, upper=upper))
    for angle, used in ((2.4, 0.9), (1.5, 0.0), (0.4, 1.1)):
        q = robot.limits.range_middle.copy()
        q[1] = angle
        check = range_check(robot, still(q))
        assert check.value == pytest.approx(used, abs=1e-9)
        assert check.holds == (used <= 1.0)
