"""The shapes of a robot and of what stands around it, and the pairs of them whose distances count."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.collision.distances import ShapePair
from cmbot.collision.shapes import coal_shapes
from cmbot.robot import Robot
from cmbot.scene import Obstacle

__all__ = ["PairedShapes"]


class PairedShapes:
    """A robot's collision shapes and the obstacles', paired.

    Parameters
    ----------
    robot : Robot
        Its own shapes stay as they are.
    obstacles : sequence of Obstacle

    Attributes
    ----------
    geometry : pinocchio.GeometryModel
        All shapes, with P collision pairs.
    pairs : list of ShapePair
    shapes : list of two int
        Indices of each pair's shapes: the second is carried by an earlier joint than the first, or by none.
    joints : list of int
        What carries each shape; 0: nothing.
    """

    def __init__(self, robot: Robot, obstacles: Sequence[Obstacle]) -> None:
        self.geometry: Any = pin.GeometryModel(robot.collision_model)
        self.pairs: list[ShapePair] = []
        self.shapes: list[tuple[int, int]] = []
        self.joints = [int(shape.parentJoint) for shape in self.geometry.geometryObjects]
        self._model = robot.model
        own_pairs = [(pair.first, pair.second) for pair in self.geometry.collisionPairs]
        moving = [i for i, joint in enumerate(self.joints) if joint > 0]
        self.geometry.removeAllCollisionPairs()
        for i, j in own_pairs:
            # The link further out is the one that moves.
            first, second = sorted((i, j), key=self.joints.__getitem__, reverse=True)
            if self.joints[first] != self.joints[second]:
                self._add(first, second, self._link_of(second), of_arm=True, at_work=False)
        tool_joint = robot.model.frames[robot.tool_frame_id].parentJoint
        for obstacle in obstacles:
            for k, (shape, X_OS) in enumerate(coal_shapes(obstacle.shape, obstacle.name)):
                X_WS = pin.SE3(np.array(obstacle.X_WO)) * X_OS
                j = self.geometry.addGeometryObject(
                    pin.GeometryObject(f"obstacle {obstacle.name} {k}", 0, X_WS, shape)
                )
                self.joints.append(0)
                for i in moving:
                    at_work = obstacle.workpiece and self.joints[i] == tool_joint
                    self._add(i, j, obstacle.name, of_arm=False, at_work=at_work)

    def _add(self, i: int, j: int, other: str, *, of_arm: bool, at_work: bool) -> None:
        self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.shapes.append((i, j))
        pair = ShapePair(link=self._link_of(i), other=other, of_arm=of_arm, at_work=at_work)
        self.pairs.append(pair)

    def _link_of(self, shape: int) -> str:
        return str(self._model.frames[self.geometry.geometryObjects[shape].parentFrame].name)
