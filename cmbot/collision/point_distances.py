"""Smallest distances of an arm by coal alone: every pair in every posture, one after the other.

The certificate's clearances come from a broad phase, caches and bounds along motions; nothing of these is
used here.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np
import pinocchio as pin

from cmbot.collision.obstacles import Obstacle
from cmbot.collision.shapes import coal_shapes, without_tip
from cmbot.common.arrays import FloatArray
from cmbot.robot import Robot


class PointDistances:
    """Distances of a robot's moving shapes to obstacles and to its own other shapes.

    Parameters
    ----------
    robot : Robot
    obstacles : sequence of Obstacle

    Attributes
    ----------
    names : list of (str, str)
        What is a pair's: a link, and another one or an obstacle.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self._model, self._data, self._coupling = robot.model, robot.model.createData(), robot.coupling
        own = list(robot.collision_model.geometryObjects)
        self._shapes = [(int(one.parentJoint), one.placement, one.geometry) for one in own]
        links = [str(robot.model.frames[one.parentFrame].name) for one in own]
        moving = [k for k, (joint, _, _) in enumerate(self._shapes) if joint > 0]
        both = [(pair.first, pair.second) for pair in robot.collision_model.collisionPairs]
        self._pairs = [pair for pair in both if len({self._shapes[k][0] for k in pair}) > 1]
        tool, fixed_tool = robot.model.frames[robot.tool_frame_id], robot.fixed_tool
        for obstacle in obstacles:
            for geometry in coal_shapes(obstacle.shape, obstacle.name):
                number = len(self._shapes)
                X_WO = pin.SE3(np.array(obstacle.X_WO))
                self._shapes.append((0, X_WO, geometry))
                links.append(obstacle.name)
                for k in moving:
                    if obstacle.contact and self._shapes[k][0] == tool.parentJoint:
                        # Without its tip: what the arm carries, or a fixed tool.
                        whole, X_JT, pair, name = own[k], tool.placement, (len(links), number), links[k]
                        if fixed_tool is not None:
                            whole = pin.GeometryObject("fixed tool", 0, X_WO, geometry)
                            X_JT, pair, name = fixed_tool, (k, len(links)), obstacle.name
                        if (rest := without_tip(whole, X_JT, obstacle.contact)) is not None:
                            self._pairs.append(pair)
                            self._shapes.append((int(rest.parentJoint), rest.placement, rest.geometry))
                            links.append(name)
                    else:
                        self._pairs.append((k, number))
        self.names = [(links[first], links[second]) for first, second in self._pairs]

    def smallest(self, q: FloatArray) -> tuple[FloatArray, list[tuple[str, str]]]:
        """Return the smallest distance (N,), m, in postures `q` (N, n), and which pair's it is.

        Below zero where shapes overlap. Infinite without pairs, whose names are then empty.
        """
        distance, names = np.full(len(q), np.inf), [("", "")] * len(q)
        # One for all: to make them takes as long as to measure.
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        for k, posture in enumerate(self._coupling.positions(q)):
            pin.forwardKinematics(self._model, self._data, posture)
            placed = ((self._data.oMi[joint] * X_JS, shape) for joint, X_JS, shape in self._shapes)
            shapes = [(shape, coal.Transform3s(X_WS.rotation, X_WS.translation)) for X_WS, shape in placed]
            for (i, j), name in zip(self._pairs, self.names, strict=True):
                result.clear()
                found = coal.distance(*shapes[i], *shapes[j], request, result)
                if found < distance[k]:
                    distance[k], names[k] = found, name
        return distance, names
