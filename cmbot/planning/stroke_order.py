"""The order and the directions of strokes in which the tool travels least between them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.planning.request import end_posture_of, strokes_of
from cmbot.planning.workcell.workcell import robot_of
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Scene, Stroke, StrokeFile

# Share of the arm's length that the tool travels as a turn by one radian does.
_TURN_LENGTH_SHARE = 0.25


def in_least_travel(scene: Scene) -> Scene:
    """Return the scene with its strokes in the order and the directions of least travel.

    Parameters
    ----------
    scene : Scene
        Its strokes have starts of their own.

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    """
    robot = robot_of(scene)
    strokes = strokes_of(scene, robot)
    at, end = (
        None if q is None else Kinematics(robot).tool_pose(q).homogeneous
        for q in (np.array(scene.posture), end_posture_of(scene, robot))
    )
    first = np.stack([stroke.path.reversed().end_pose for stroke in strokes])
    last = np.stack([stroke.path.end_pose for stroke in strokes])
    # Node 2 k is stroke k as given, node 2 k + 1 its reverse.
    enter, leave = (np.stack(pair, axis=1).reshape(-1, 4, 4) for pair in ((first, last), (last, first)))
    before = np.zeros(len(enter)) if at is None else _travel(robot, at[None], enter)[0]
    after = np.zeros(len(leave)) if end is None else _travel(robot, leave, end[None])[:, 0]
    nodes = least_travel(before, _travel(robot, leave, enter), after)
    return scene.with_strokes(_ordered(strokes, nodes))


def least_travel(before: FloatArray, between: FloatArray, after: FloatArray) -> list[int]:
    """Return the nodes of the shortest way through every stroke once (Held and Karp, 1962).

    Nodes 2 k and 2 k + 1 are the two directions of stroke k.

    Parameters
    ----------
    before : (2 s,)
        From the start to each node.
    between : (2 s, 2 s)
        From each node to each.
    after : (2 s,)
        From each node to the end.
    """
    nodes = len(before)
    strokes = nodes // 2
    # Length of the shortest way through a set of strokes that ends at a node, and the node before it.
    length = np.full((1 << strokes, nodes), np.inf)
    came = np.full((1 << strokes, nodes), -1)
    for node in range(nodes):
        length[1 << node // 2, node] = before[node]
    for done in range(1, 1 << strokes):
        for node in range(nodes):
            if done >> node // 2 & 1:
                continue
            through = length[done] + between[:, node]
            best = int(through.argmin())
            total = done | 1 << node // 2
            if through[best] < length[total, node]:
                length[total, node], came[total, node] = through[best], best
    done = (1 << strokes) - 1
    node = int((length[done] + after).argmin())
    way = list[int]()
    while node >= 0:
        way.append(node)
        done, node = done & ~(1 << node // 2), int(came[done, node])
    return way[::-1]


def _travel(robot: Robot, start: FloatArray, end: FloatArray) -> FloatArray:
    """How far (N, M), m, the tool travels from poses (N, 4, 4) to others (M, 4, 4), turns included."""
    away = np.linalg.norm(start[:, None, :3, 3] - end[None, :, :3, 3], axis=2)
    turns = np.einsum("nki,mkj->nmij", start[:, :3, :3], end[:, :3, :3])
    angle = Rotation.from_matrix(turns.reshape(-1, 3, 3)).magnitude().reshape(away.shape)
    return np.asarray(away + _TURN_LENGTH_SHARE * robot.reach * angle)


def _ordered(strokes: Sequence[Stroke], nodes: Sequence[int]) -> tuple[StrokeFile, ...]:
    files = []
    for node in nodes:
        file = strokes[node // 2].file
        files.append(file.changed(backwards=file.backwards != bool(node % 2)))
    return tuple(files)
