"""A plan's job as an MCAP file of ROS 2 messages, for Foxglove, RViz and ``ros2 bag``."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.archive.folder import write_file
from cmbot.archive.ros.trajectory_file import trajectory_message
from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere, load_mesh
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra
from cmbot.common.reading.validation import given_path
from cmbot.planning import Plan, require_plan
from cmbot.robot import link_poses

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
    try:
        from mcap_ros2.writer import Writer
    except ImportError as error:
        raise MissingExtra("mcap-ros2-support", "ros") from error
    content = io.BytesIO()
    with Writer(content) as writer:
        schemas = {name: writer.register_msgdef(name, text) for name, text in _schemas().items()}
        for topic, kind, time, message in messages(plan, effort=effort):
            nanoseconds = round(1e9 * time)
            writer.write_message(topic, schemas[kind], message, nanoseconds, nanoseconds)
    write_file(target, content.getvalue())


def messages(plan: Plan, *, effort: bool) -> Iterator[tuple[str, str, float, Message]]:
    """Yield topic, type, time and content of every message, in the order of time."""
    samples, _ = plan.job_samples
    stamp = _stamp(0.0)
    job = trajectory_message(plan, effort=effort).message
    # A message of MCAP has all fields: those left out are empty.
    job["points"] = [{"effort": [], **point} for point in job["points"]]
    yield "/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", 0.0, job
    yield "/markers", "visualization_msgs/msg/MarkerArray", 0.0, {"markers": list(_markers(plan, stamp))}
    some = np.unique(np.append(np.arange(0, len(samples.t), round(_PERIOD_S / 0.01)), len(samples.t) - 1))
    names, poses = link_poses(plan.robot, samples.q[some])
    # O0 has the axes of W.
    held = np.array([*plan.robot.foot_point, 0.0, 0.0, 0.0, 1.0])
    for k, each in zip(some, poses, strict=True):
        time = float(samples.t[k])
        header = {"stamp": _stamp(time), "frame_id": WORLD}
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
        transforms = [
            {
                "header": header,
                "child_frame_id": name,
                "transform": {"translation": _vector(pose[:3]), "rotation": _quaternion(pose[3:])},
            }
            for name, pose in zip([*names, FOOT], [*each, held], strict=True)
        ]
        yield "/tf", "tf2_msgs/msg/TFMessage", time, {"transforms": transforms}
        wrench = {
            "force": _vector(samples.guardrail_force[k]),
            "torque": _vector(samples.guardrail_torque[k]),
        }
        message = {"header": header | {"frame_id": FOOT}, "wrench": wrench}
        yield "/base_wrench", "geometry_msgs/msg/WrenchStamped", time, message


def _markers(plan: Plan, stamp: Message) -> Iterator[Message]:
    header, count = {"stamp": stamp, "frame_id": WORLD}, 0

    def marker(kind: int, name: str, X: FloatArray, scale: Any, colour: Any, points: Any = ()) -> Message:
        nonlocal count
        count += 1
        return {
            "header": header,
            "ns": name,
            "id": count,
            "type": kind,
            "pose": {
                "position": _vector(X[:3, 3]),
                "orientation": _quaternion(Rotation.from_matrix(X[:3, :3]).as_quat()),
            },
            "scale": _vector(scale),
            "color": {**dict(zip("rgb", colour, strict=True)), "a": 1.0},
            "points": [_vector(point) for point in points],
        }

    for obstacle in plan.scene.all_obstacles:
        yield from _solids(obstacle, marker)
    for stroke in plan.strokes:
        width = (_LINE_WIDTH, 0.0, 0.0)
        path = stroke.task.path.outline()
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
        case Mesh(path=path, scale=scale):
            mesh = load_mesh(path, obstacle.name, scale=scale)
            corners = np.array(mesh.vertices)[np.array(mesh.faces).ravel()]
            yield marker(_TRIANGLES, obstacle.name, X, (1.0, 1.0, 1.0), colour, corners)


def _stamp(time: float) -> Message:
    seconds, nanoseconds = divmod(round(1e9 * time), 10**9)
    return {"sec": seconds, "nanosec": nanoseconds}


def _vector(values: Any) -> Message:
    return {axis: float(value) for axis, value in zip("xyz", values, strict=True)}


def _quaternion(values: Any) -> Message:
    return {axis: float(value) for axis, value in zip("xyzw", values, strict=True)}


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
