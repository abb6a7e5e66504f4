"""A plan's job as ROS 2 messages: a trajectory in JSON for controllers, or all in an MCAP file.

MCAP files are for Foxglove, RViz and ``ros2 bag``.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from heapq import heapify, heappop, heappush
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import to_json
from scipy.spatial.transform import Rotation

from cmbot.archive.folder import write_file
from cmbot.collision import Box, Capsule, Cylinder, Obstacle, Sphere, load_mesh
from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError, optional_module
from cmbot.common.reading.validation import given_path, hint
from cmbot.planning import Plan, require_plan
from cmbot.robot import Dynamics, Postures, link_poses
from cmbot.trajectory import QuinticTrajectory

# Points of a message unless more are asked for.
_DEFAULT_MAX_POINTS = 200
# Times between two points at which the motion is compared, and most points of all.
_TIMES_BETWEEN_POINTS, _LARGEST_MESSAGE = 16, 100_000
_NANO = 1e-9
# What moves by less, rad or m, is at rest; times at which that is seen.
_AT_REST_STEP, _TIMES_OF_MOTION = 1e-6, 2001
# Joints that are off by less are where the plan has them, rad or m.
_SAME_JOINTS = 1e-9
# Points are tried in numbers that grow by this factor.
_MORE_POINTS = 1.1

MAX_DEVIATION = 1e-3
"""What the quintics through points of a message may be off the plan, rad and m."""


@dataclass(frozen=True, kw_only=True)
class RosTrajectory:
    """A ``trajectory_msgs/JointTrajectory``.

    Attributes
    ----------
    message : dict
    points : int
    deviation : float, rad, of joints that slide m
        How far the quintics through its points, which controllers drive, are from the plan at most.
    tool_deviation : float, m
        How far they lead the tool point off where the plan has it at work, at most.
    left_out : dict of str to float, rad, of joints that slide m
        The joints that move in the plan and are not in the message, and how far from end to end.
    """

    message: dict[str, Any]
    points: int
    deviation: float
    tool_deviation: float
    left_out: dict[str, float]

    def follows(self, plan: Plan) -> bool:
        """Whether the quintics are as near to the plan as its tool has to be to its path."""
        near_tool = self.tool_deviation <= plan.options.max_tool_deviation_m
        return near_tool and self.deviation <= MAX_DEVIATION


def enough_points(plan: Plan, least: int) -> int:
    """Return a number of points, `least` or more, whose quintics follow the plan."""
    while not trajectory_message(plan, message_times(plan.job.trajectory, least)).follows(plan):
        least = int(np.ceil(_MORE_POINTS * least))
    return least


def export_ros(
    plan: Plan,
    path: str | Path,
    *,
    max_points: int | None = None,
    rate: float | None = None,
    joints: Sequence[str] | None = None,
    effort: bool = False,
) -> RosTrajectory:
    """Write the planned job of a plan as JSON of a ``trajectory_msgs/JointTrajectory``, whole or not at all.

    Its points have positions, velocities and accelerations: the quintics that controllers make of these are
    the plan's own where all its knots are among them.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.
    max_points : int, optional
        Of more knots those are left out that matter least; by default 200.
    rate : float, Hz, optional
        Points in equal steps, and one at the end, in place of knots.
    joints : sequence of str, optional
        In their order, in place of all joints: for a message to one of several controllers.
    effort : bool
        Give the points the joints' torques, too, Nm, of joints that slide forces, N. The controller of
        ros2_control refuses such a message, but for those of Jazzy and later that command efforts.

    Returns
    -------
    RosTrajectory
        What was written, and how far it is from the plan.

    Raises
    ------
    InputError
        When `plan` is none, a joint is none of the arm's, or the points are too few or too many.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.export_ros")
    target = given_path(path, "cmbot.export_ros", "path", "the path of a file to write")
    nanoseconds = message_times(plan.job.trajectory, max_points, rate)
    found = trajectory_message(plan, nanoseconds, joints=joints, effort=effort)
    write_file(target, to_json(found.message) + b"\n")
    return found


def message_times(
    trajectory: QuinticTrajectory, max_points: int | None = None, rate: float | None = None
) -> IntArray:
    """Return the times (k,), whole nanoseconds, of the points of a message, which begins with time 0.

    Raises
    ------
    InputError
        When these are too few or too many.
    """
    if rate is not None:
        if not (rate > 0 and trajectory.duration * rate < _LARGEST_MESSAGE):
            expected = f"a frequency, Hz, for up to {_LARGEST_MESSAGE} points"
            raise InputError("cmbot.export_ros", "rate", f"{rate:g}", expected)
        inside = np.arange(0, int(np.ceil(trajectory.duration * rate))) / rate
        return _whole(np.append(trajectory.t[0] + inside, trajectory.t[-1]))
    most = _DEFAULT_MAX_POINTS if max_points is None else max_points
    if not 2 <= most <= _LARGEST_MESSAGE:
        raise InputError("cmbot.export_ros", "max_points", most, f"2 to {_LARGEST_MESSAGE}")
    return _whole(_fewer(trajectory, most))


def trajectory_message(
    plan: Plan,
    nanoseconds: IntArray | None = None,
    *,
    joints: Sequence[str] | None = None,
    effort: bool = False,
) -> RosTrajectory:
    """Return the job of a plan at times (k,), by default its knots, as a message; errors as `export_ros`."""
    trajectory, names = plan.job.trajectory, plan.robot.joints
    if nanoseconds is None:
        nanoseconds = message_times(trajectory)
    for joint in joints or ():
        if joint not in names:
            at = dict(plan.scene.robot.locked or ()).get(joint)
            locked = "" if at is None else f" that moves: this one is locked at {at:g}"
            expected = f"a joint{locked or hint(joint, names)}"
            raise InputError("cmbot.export_ros", "joints", joint, expected, tuple(names))
    columns = list(range(len(names))) if joints is None else [names.index(joint) for joint in joints]
    t = np.minimum(trajectory.t[0] + _NANO * nanoseconds, trajectory.t[-1])
    q, v, a = trajectory.states(t)
    fields = {"positions": q, "velocities": v, "accelerations": a}
    if effort:
        fields["effort"] = _efforts(plan, t)
    rows = zip(*(values[:, columns].tolist() for values in fields.values()), strict=True)
    points = [
        {**dict(zip(fields, row, strict=True)), "time_from_start": _stamp(time)}
        for row, time in zip(rows, nanoseconds.tolist(), strict=True)
    ]
    header = {"stamp": _stamp(0), "frame_id": ""}
    message = {"header": header, "joint_names": [names[k] for k in columns], "points": points}
    deviation = _deviation(trajectory, t)
    return RosTrajectory(
        message=message,
        points=len(points),
        deviation=float(deviation[:, columns].max(initial=0.0)),
        tool_deviation=_tool_deviation(plan, t, np.flatnonzero(deviation.max(axis=1) > _SAME_JOINTS)),
        left_out=_left_out(trajectory, names, columns),
    )


def _left_out(
    trajectory: QuinticTrajectory, names: Sequence[str], columns: Sequence[int]
) -> dict[str, float]:
    """The joints that move without being in a message, and how far from end to end."""
    times = np.linspace(trajectory.t[0], trajectory.t[-1], _TIMES_OF_MOTION)
    moves = np.ptp(trajectory.evaluate(times), axis=0)
    return {
        name: float(moves[k]) for k, name in enumerate(names) if k not in columns and moves[k] > _AT_REST_STEP
    }


def _whole(t: FloatArray) -> IntArray:
    """Whole nanoseconds from the first of times, none twice."""
    return np.unique(np.rint((t - t[0]) / _NANO).astype(np.intp))


def _deviation(trajectory: QuinticTrajectory, t: FloatArray) -> FloatArray:
    """How far the quintics between times (k,) are from a trajectory at most, (k - 1, n)."""
    every = _times_between(t, np.arange(len(t) - 1))
    away = np.abs(_through(trajectory, t).evaluate(every) - trajectory.evaluate(every))
    return np.asarray(away.reshape(len(t) - 1, _TIMES_BETWEEN_POINTS - 1, -1).max(axis=1))


def _tool_deviation(plan: Plan, t: FloatArray, steps: IntArray) -> float:
    """How far the quintics of some steps between times (k,) lead the tool off at work, m."""
    trajectory, every = plan.job.trajectory, _times_between(t, steps)
    strokes = [segment for segment in plan.job.segments if segment.kind == "stroke"]
    if not len(every):
        return 0.0
    every = every[np.any([(each.begin <= every) & (every <= each.end) for each in strokes], axis=0)]
    postures = Postures(plan.robot)
    both = (motion.evaluate(every) for motion in (_through(trajectory, t), trajectory))
    one, other = (postures.at(q).tool_point for q in both)
    return float(np.linalg.norm(one - other, axis=1).max(initial=0.0))


def _through(trajectory: QuinticTrajectory, t: FloatArray) -> QuinticTrajectory:
    """The quintics that a controller makes of a trajectory's states at times (k,)."""
    q, v, a = trajectory.states(t)
    return QuinticTrajectory(t=t, q=q, v=v, a=a)


def _times_between(t: FloatArray, steps: IntArray) -> FloatArray:
    """Times within some of the steps between times (k,)."""
    shares = np.arange(1, _TIMES_BETWEEN_POINTS) / _TIMES_BETWEEN_POINTS
    return np.asarray((t[steps, None] + shares * np.diff(t)[steps, None]).ravel())


def _fewer(trajectory: QuinticTrajectory, most: int) -> FloatArray:
    """So many knots at most: one after the other that without which the motion changes least is left out."""
    t = trajectory.t
    before, after = np.arange(len(t)) - 1, np.arange(len(t)) + 1
    version = np.zeros(len(t), dtype=np.intp)

    def cost(k: int) -> tuple[float, int, int]:
        without = _deviation(trajectory, t[[before[k], after[k]]])
        return float(without.max()), k, int(version[k])

    if len(t) <= most:
        return t
    left = [cost(k) for k in range(1, len(t) - 1)]
    heapify(left)
    kept = np.ones(len(t), dtype=np.bool_)
    while kept.sum() > most:
        _, k, counted = heappop(left)
        if not kept[k] or counted != version[k]:
            continue
        kept[k] = False
        after[before[k]], before[after[k]] = after[k], before[k]
        for beside in (before[k], after[k]):
            if 0 < beside < len(t) - 1:
                version[beside] += 1
                heappush(left, cost(int(beside)))
    return np.asarray(t[kept])


def _efforts(plan: Plan, t: FloatArray) -> FloatArray:
    """The joints' torques (k, n) at times (k,) of the job; a join belongs to the segment that ends there."""
    segments, torque = plan.job.segments, np.empty((len(t), plan.robot.dof))
    numbers = np.searchsorted([segment.end for segment in segments[:-1]], t)
    for number, segment in enumerate(segments):
        which = numbers == number
        robot = plan.robot if segment.kind == "stroke" else plan.robot.tool_off
        states = plan.job.trajectory.states(t[which])
        torque[which] = Dynamics(robot).efforts(*states).joint_torque
    return torque


WORLD, FOOT = "world", "O0"
# Between two messages of the motion, s.
_PERIOD_S = 0.02
_STEEL, _WORKPIECE, _PATH = (0.49, 0.55, 0.6), (0.18, 0.62, 0.56), (0.48, 0.17, 0.75)
_CUBE, _SPHERE, _CYLINDER, _LINE_STRIP, _TRIANGLES = 1, 2, 3, 4, 11
_LINE_WIDTH = 0.01  # m
_SEPARATOR = "=" * 80

Message = dict[str, Any]


def export_mcap(plan: Plan, path: str | Path, *, effort: bool = False) -> None:
    """Write the planned job of a plan as an MCAP file of ROS 2 messages, whole or not at all.

    Every 0.02 s, and at the end: ``/joint_states``, ``/tf`` (each link in the frame ``world``, which is W,
    and ``O0``, where the foot holds), ``/base_wrench``, what the arm exerts on the base, in ``O0``. At its
    beginning, once: ``/joint_trajectory``, the whole job as a ``trajectory_msgs/JointTrajectory`` of at most
    200 points, and ``/markers``, obstacles and tool paths. Time 0 is the beginning of the job.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.
    effort : bool
        Give the points of ``/joint_trajectory`` the joints' torques, too: see `export_ros`.

    Raises
    ------
    InputError
        When `plan` is none.
    MissingExtra
        When mcap-ros2-support is not installed.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.export_mcap")
    target = given_path(path, "cmbot.export_mcap", "path", "the path of a file to write")
    write_file(target, bag(messages(plan, effort=effort)))


def bag(each: Iterable[tuple[str, str, float, Message]]) -> bytes:
    """Return the content of the MCAP file of `messages`; errors as `export_mcap`."""
    content, made = io.BytesIO(), optional_module("mcap_ros2.writer", "mcap-ros2-support", "ros")
    with made.Writer(content) as writer:
        schemas = {name: writer.register_msgdef(name, text) for name, text in _schemas().items()}
        for topic, kind, time, message in each:
            nanoseconds = round(1e9 * time)
            writer.write_message(topic, schemas[kind], message, nanoseconds, nanoseconds)
    return content.getvalue()


def messages(plan: Plan, *, effort: bool) -> Iterator[tuple[str, str, float, Message]]:
    """Yield topic, type, time and content of every message, in the order of time."""
    samples, _ = plan.job_samples
    job = trajectory_message(plan, effort=effort).message
    # A message of MCAP has all fields: those left out are empty.
    job["points"] = [{"effort": [], **point} for point in job["points"]]
    yield "/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", 0.0, job
    yield "/markers", "visualization_msgs/msg/MarkerArray", 0.0, {"markers": list(_markers(plan))}
    some = np.unique(np.append(np.arange(0, len(samples.t), round(_PERIOD_S / 0.01)), len(samples.t) - 1))
    names, poses = link_poses(plan.robot, samples.q[some])
    # O0 has the axes of W.
    held = np.array([*plan.robot.foot_point, 0.0, 0.0, 0.0, 1.0])
    for k, each in zip(some, poses, strict=True):
        time = float(samples.t[k])
        header = {"stamp": _stamp(round(1e9 * time)), "frame_id": WORLD}
        yield (
            "/joint_states",
            "sensor_msgs/msg/JointState",
            time,
            {
                "header": header | {"frame_id": ""},
                "name": list(plan.robot.joints),
                "position": samples.q[k].tolist(),
                "velocity": samples.v[k].tolist(),
                "effort": samples.joint_torque[k].tolist(),
            },
        )
        transforms = []
        for name, pose in zip([*names, FOOT], [*each, held], strict=True):
            transform = {"translation": _vector(pose[:3]), "rotation": _vector(pose[3:], "xyzw")}
            transforms.append({"header": header, "child_frame_id": name, "transform": transform})
        yield "/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": transforms}
        force, torque = _vector(samples.guardrail_force[k]), _vector(samples.guardrail_torque[k])
        message = {"header": header | {"frame_id": FOOT}, "wrench": {"force": force, "torque": torque}}
        yield "/base_wrench", "geometry_msgs/msg/WrenchStamped", time, message


def _markers(plan: Plan) -> Iterator[Message]:
    header, count = {"stamp": _stamp(0), "frame_id": WORLD}, 0

    def marker(kind: int, name: str, X: FloatArray, scale: Any, colour: Any, points: Any = ()) -> Message:
        nonlocal count
        count += 1
        turn = Rotation.from_matrix(X[:3, :3]).as_quat()
        return {
            "header": header,
            "ns": name,
            "id": count,
            "type": kind,
            "pose": {"position": _vector(X[:3, 3]), "orientation": _vector(turn, "xyzw")},
            "scale": _vector(scale),
            "color": {**dict(zip("rgb", colour, strict=True)), "a": 1.0},
            "points": [_vector(point) for point in points],
        }

    for obstacle in plan.scene.all_obstacles:
        yield from _solids(obstacle, marker)
    for stroke, path in zip(plan.strokes, plan.outlines, strict=True):
        width = (_LINE_WIDTH, 0.0, 0.0)
        yield marker(_LINE_STRIP, f"path {stroke.name}", np.eye(4), width, _PATH, path)


def _solids(obstacle: Obstacle, marker: Callable[..., Message]) -> Iterator[Message]:
    """Yield the markers that show an obstacle."""
    X, colour = obstacle.X_WO, _WORKPIECE if obstacle.workpiece else _STEEL
    match obstacle.shape:
        case Box(size=size):
            yield marker(_CUBE, obstacle.name, X, size, colour)
        case Sphere(radius=radius):
            yield marker(_SPHERE, obstacle.name, X, [2 * radius] * 3, colour)
        case Cylinder(radius=radius, length=length) | Capsule(radius=radius, length=length):
            yield marker(_CYLINDER, obstacle.name, X, (2 * radius, 2 * radius, length), colour)
            for end in (-0.5, 0.5) if isinstance(obstacle.shape, Capsule) else ():
                ball = X.copy()
                ball[:3, 3] += end * length * X[:3, 2]
                yield marker(_SPHERE, obstacle.name, ball, [2 * radius] * 3, colour)
        case shape:
            mesh = load_mesh(shape.path, obstacle.name, scale=shape.scale)
            corners = np.array(mesh.vertices)[np.array(mesh.faces).ravel()]
            yield marker(_TRIANGLES, obstacle.name, X, (1.0, 1.0, 1.0), colour, corners)


def _stamp(nanoseconds: int) -> Message:
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def _vector(values: Any, axes: str = "xyz") -> Message:
    return {axis: float(value) for axis, value in zip(axes, values, strict=True)}


def _schemas() -> dict[str, str]:
    """Return the definition of each type that is written, then all others, which may be its parts."""
    text = (files("cmbot.archive.ros") / "ros_messages.txt").read_text(encoding="utf-8")
    parts = dict(part.split("\n", 1) for part in text.split("MSG: ")[1:])
    kinds = (
        "geometry_msgs/WrenchStamped",
        "sensor_msgs/JointState",
        "tf2_msgs/TFMessage",
        "trajectory_msgs/JointTrajectory",
        "visualization_msgs/MarkerArray",
    )
    return {
        kind.replace("/", "/msg/"): f"{_SEPARATOR}\n".join(
            [parts[kind], *(f"MSG: {name}\n{part}" for name, part in parts.items() if name != kind)]
        )
        for kind in kinds
    }
