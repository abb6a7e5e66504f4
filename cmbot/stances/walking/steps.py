"""A step: the foot is lifted off, swung and set down while the other one holds, every move certified."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from cmbot.collision import Obstacle
from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.planning import (
    Certificate,
    FreeMove,
    FreeSpace,
    JobState,
    Segment,
    StrokeRequest,
    ToolTask,
    Workcell,
    build_request,
    certify_move,
    free_space,
    plan_move,
)
from cmbot.robot import Climber, Kinematics, Robot, Side, load_climbing_robot, other_foot
from cmbot.scene import LIFT_M, PlannerOptions, Scene
from cmbot.stances import Candidate, scene_at, without_links
from cmbot.stances.walking.balance import foot_at
from cmbot.toolpath import SpeedProfile, ToolPath
from cmbot.trajectory import QuinticTrajectory

# Postures of the straight way on which a foot is lifted.
_LIFT_POSTURES = 9
# Samples of a move at which the speed of the foot is found, and by how much it is then slowed further.
_FOOT_SPEED_SAMPLES, _SLOWING_FACTOR = 400, 1 + 1e-6
_NO_LIMIT = 1e12
Kind = Literal["arm", "lift", "swing", "set"]
"""Of a move."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Move(ShortRepr):
    """A part of a step.

    Attributes
    ----------
    kind : str
        ``arm`` (both feet hold, as far as they did, and the arm moves), ``lift``, ``swing`` or ``set``.
    robot : Robot
        As it moves then: with the joints of the arm, or on one foot with the climbing joints.
    holds : tuple of int
        The feet that hold.
    node : Candidate
        Where it stands when the move begins.
    arm : (7,), rad
        Posture of the arm: when the move begins, where the arm moves.
    segment : Segment
        The certified motion.
    """

    kind: Kind
    robot: Robot
    holds: tuple[Side, ...]
    node: Candidate
    arm: FloatArray
    segment: Segment


@dataclass(frozen=True, kw_only=True, eq=False)
class Step(ShortRepr):
    """A foot goes from one place to another.

    Attributes
    ----------
    foot : int
        That goes; the other one holds.
    before, after : Candidate
        The stances.
    moves : tuple of Move
    """

    foot: Side
    before: Candidate
    after: Candidate
    moves: tuple[Move, ...]

    @property
    def seconds(self) -> float:
        """How long it takes, s."""
        return sum(move.segment.duration for move in self.moves)

    @property
    def places(self) -> tuple[str, str]:
        """From where and to where the foot goes, in words."""
        places = (node.stance.places[self.foot - 1] for node in (self.before, self.after))
        before, after = ("free" if place is None else place.in_words for place in places)
        return before, after


def space_of_arm(scene: Scene, node: Candidate, arm: FloatArray) -> FreeSpace | None:
    """Return where the arm may be in a stance, beside a posture (7,); None where that is not free."""
    return free_space(build_request(scene_at(scene, node, arm), scene.planner).tool_off.cell).around(
        arm[None]
    )


def arm_move(
    scene: Scene, node: Candidate, start: FloatArray, end: FloatArray, way: FloatArray | None = None
) -> Move | None:
    """Plan the free move of the arm in a stance between postures (7,); None where it stays.

    Parameters
    ----------
    scene : Scene
    node : Candidate
    start, end : (7,), rad
    way : (k, 7), rad, optional
        Between them, taken where the straight one is not free.

    Raises
    ------
    PathNotFound
        When nothing leads there.
    """
    if np.abs(end - start).max() < 1e-9:
        return None
    request = build_request(scene_at(scene, node, start), scene.planner)
    move = _named("arm", start, end, "the counterweight's posture")
    segment = plan_move(request, replace(move, known=partial(_given, way)))
    robot = request.cell.robot.tool_off
    return Move(kind="arm", robot=robot, holds=node.feet, node=node, arm=start, segment=segment)


def plan_step(
    scene: Scene,
    before: Candidate,
    after: Candidate,
    foot: Side,
    arm: FloatArray,
    speed: float,
    *,
    straight: bool = False,
) -> tuple[Move, ...]:
    """Plan the moves of a foot from where it is in one stance to where it is in another.

    Parameters
    ----------
    scene : Scene
    before, after : Candidate
        Stances in which the other foot is at the same place.
    foot : int
        That goes.
    arm : (7,), rad
        Where the arm is locked.
    speed : float, m/s
        Largest of the foot.
    straight : bool
        The swing has to be straight in joint space: where that is not free there are no moves.

    Raises
    ------
    PathNotFound
        When nothing leads there, or the joints or the foot that holds cannot bear it.
    """
    robot = swinging_robot(scene, before, foot, arm)
    far = _swing_request(scene, robot, foot, near=False)
    ways = [_lifted(node, foot) for node in (before, after)]
    up, down = ways[0], ways[1][::-1]
    # On foot 2 the joints are in the other order.
    turn = 1 if foot == 2 else -1
    if straight:
        # Neighbouring links spare less than a free space asks by default.
        space = free_space(far.cell).around(np.stack([up[-1], down[0]])[:, ::turn])
        if space is None or not space.straight(up[-1][::turn], down[0][::turn]):
            return ()
    near = _swing_request(scene, robot, foot, near=True)
    parts: list[tuple[Kind, StrokeRequest, FloatArray]] = []
    if len(up) > 1:
        parts.append(("lift", near, up[:, ::turn]))
    parts.append(("swing", far, np.stack([up[-1], down[0]])[:, ::turn]))
    if len(down) > 1:
        parts.append(("set", near, down[:, ::turn]))
    moves = list[Move]()
    for kind, request, path in parts:
        move = _named(kind, path[0], path[-1], _ENDS[kind])
        first = partial(_given, None if kind == "swing" else path)
        segment = plan_move(request, replace(move, first=first))
        slow = _slowed(request, segment, speed)
        holds = (other_foot(foot),)
        moves.append(
            Move(kind=kind, robot=request.cell.robot, holds=holds, node=before, arm=arm, segment=slow)
        )
    return tuple(moves)


def blocked_end(
    scene: Scene, before: Candidate, after: Candidate, foot: Side
) -> tuple[Literal["before", "after"], str] | None:
    """Return at which end of a step something is in the way of its foot, and what; None: nothing is.

    Near its places the shapes of a foot do not count in certificates: there `Scene.in_the_way` decides.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    before, after : Candidate
        The stances.
    foot : int
        That goes.
    """
    ends: tuple[tuple[Literal["before", "after"], Candidate], ...] = (("before", before), ("after", after))
    for end, node in ends:
        place = node.stance.places[foot - 1]
        if place is not None and (other := scene.in_the_way(place)) is not None:
            return end, other
    return None


def certified_move(
    scene: Scene,
    node: Candidate,
    kind: Kind,
    holds: tuple[Side, ...],
    arm: FloatArray,
    trajectory: QuinticTrajectory,
    speed: float,
) -> Move:
    """Return a known motion as a move, certified anew.

    Parameters
    ----------
    scene : Scene
        As `in_world` returns it.
    node, kind, holds, arm
        As of `Move`.
    trajectory : QuinticTrajectory
    speed : float, m/s
        Largest of a foot that goes.

    Raises
    ------
    LimitViolation
        When the certificate does not hold.
    """
    if kind == "arm":
        request = build_request(scene_at(scene, node, arm), scene.planner).tool_off
        task = request.task.held_at_start()
    else:
        goes = other_foot(holds[0])
        request = _swing_request(scene, swinging_robot(scene, node, goes, arm), goes, near=kind != "swing")
        task = replace(request.task.held_at_start(), max_speed=speed)
    robot = request.cell.robot
    certificate = _certified(request.cell, robot, task, trajectory)
    segment = Segment(
        name=kind, kind="free", begin=0.0, trajectory=trajectory, certificate=certificate, task=task
    )
    return Move(kind=kind, robot=robot, holds=holds, node=node, arm=arm, segment=segment)


def _certified(cell: Workcell, robot: Robot, task: ToolTask, trajectory: QuinticTrajectory) -> Certificate:
    ends = trajectory.q[0], trajectory.q[-1]
    certificate = certify_move(robot, task, trajectory, cell.clearances, cell.options, *ends)
    certificate.require()
    return certificate


def _swing_request(scene: Scene, robot: Robot, foot: Side, *, near: bool) -> StrokeRequest:
    """What a move of a foot needs, near the member that it held or is to hold, or away from it."""
    options = replace(scene.planner, objective="torque", moment_about="foot", axis_weights=(1.0, 1.0, 1.0))
    # Near the member that it holds the foot's shapes count no more; the foothold is known to be free.
    shapes = without_links(robot, lambda link: link == f"foot_{foot}") if near else robot
    return _request(shapes, scene.all_obstacles, options)


_ENDS = {"lift": "the lifted foot", "swing": "above the next place", "set": "the next place"}


def swinging_robot(scene: Scene, node: Candidate, foot: Side, arm: FloatArray) -> Robot:
    """Return the robot on the foot that holds in a stance, while `foot` goes; the arm is locked."""
    holds = other_foot(foot)
    place = node.stance.places[holds - 1]
    if place is None:
        raise ValueError("a foot that is free cannot hold")
    X, file = _rigid(node.foot_pose(holds)), scene.robot
    robot = load_climbing_robot(holds, X, arm, tool_length=file.tool_length_m, payload=file.payload_kg)
    return replace(robot, feet=(foot_at(scene, place, holds),))


def _rigid(X: FloatArray) -> FloatArray:
    """The pose without the rounding of products."""
    U, _, Vt = np.linalg.svd(X[:3, :3])
    clean = np.eye(4)
    clean[:3, :3], clean[:3, 3] = U @ Vt, X[:3, 3]
    return clean


def _given(path: FloatArray | None, _: FreeSpace) -> FloatArray | None:
    """What `plan_move` tries first."""
    return path


def _named(name: str, start: FloatArray, end: FloatArray, end_name: str) -> FreeMove:
    return FreeMove(
        name=name,
        start=start,
        end=end,
        start_name="the posture before",
        end_name=end_name,
        # What may be asked is bounded by joints and feet.
        allowed=_NO_LIMIT,
    )


def _lifted(node: Candidate, foot: Side) -> FloatArray:
    """Postures (k, 5) of the climber from where a foot holds to where it is lifted; one where it is free."""
    if foot not in node.feet:
        return node.climber[None]
    climber = Climber()
    X_12, normal = climber.poses(node.climber)[0], np.array([0.0, 1.0, 0.0])
    way = [node.climber]
    for height in np.linspace(0.0, LIFT_M, _LIFT_POSTURES)[1:]:
        X = X_12.copy()
        X[:3, 3] += (height if foot == 2 else -height) * normal
        found = climber.reaching(X)
        if not found:
            break
        way.append(min(found, key=lambda angles: float(np.abs(angles - way[-1]).max())))
    return np.array(way)


def _request(robot: Robot, obstacles: tuple[Obstacle, ...], options: PlannerOptions) -> StrokeRequest:
    """What planning a free move of the climbing joints needs; the other foot is the tool."""
    q = np.zeros(robot.dof)
    X_WT = Kinematics(robot).tool_pose(q)
    corners = X_WT.translation + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]])
    path = ToolPath.straight(corners, np.array(X_WT.rotation), np.ones(1), SpeedProfile().law)
    cell = Workcell.of(robot, obstacles, options)
    times = np.array([0.0, 1.0])
    state = JobState(posture=q)
    return StrokeRequest(
        cell=cell, state=state, strokes=(), number=0, task=ToolTask(path), times=times, first=q
    )


def _slowed(request: StrokeRequest, segment: Segment, speed: float) -> Segment:
    """The same motion so slow that the foot keeps below a speed, certified again."""
    cell = request.cell
    trajectory, kinematics = segment.trajectory, Kinematics(cell.robot)
    t = np.linspace(0.0, trajectory.duration, _FOOT_SPEED_SAMPLES)
    q, v, *_ = trajectory.states(t)
    J = kinematics.tool_point_jacobians(q)[1]
    fastest = float(np.linalg.norm(np.einsum("kij,kj->ki", J, v), axis=1).max())
    # Between samples it may be a little faster.
    factor = max(1.0, fastest / speed * (1 + 4 / _FOOT_SPEED_SAMPLES)) * _SLOWING_FACTOR
    slow = QuinticTrajectory(
        t=trajectory.t * factor, q=trajectory.q, v=trajectory.v / factor, a=trajectory.a / factor**2
    )
    task = replace(segment.task, max_speed=speed)
    certificate = _certified(cell, cell.robot, task, slow)
    return replace(segment, trajectory=slow, certificate=certificate, task=task)
