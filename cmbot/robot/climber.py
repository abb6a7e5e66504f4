"""The climbing mechanism of the shipped robot: its joints between foot 1, the arm's base and foot 2."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.installation import model_folder
from cmbot.robot.description.xml_file import parse_urdf
from cmbot.robot.holding_joints import HoldingJoint, holding_joints

CLIMBING_JOINTS = ("climb_1", "climb_2", "climb_3", "climb_4", "climb_5")
# Feet are where they should be when they miss it by less, m and rad.
_FOOT_MISS = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class ClimberBodies:
    """The climber without the arm in a posture, in the frame of foot 1.

    Attributes
    ----------
    mass, centre : (6,) and (6, 3), kg and m
        Of foot 1 and of what each climbing joint moves, in their order.
    origin, axis : (5, 3), m
        Of the joints.
    foot_2, base : (4, 4)
        Poses of foot 2 and of the arm's base.
    """

    mass: FloatArray
    centre: FloatArray
    origin: FloatArray
    axis: FloatArray
    foot_2: FloatArray
    base: FloatArray


class Climber:
    """Kinematics of the climbing joints, rad; poses (4, 4) are in the frame of foot 1.

    It owns pinocchio's working memory, so it is not to be shared between threads.
    """

    def __init__(self) -> None:
        self._model, self._locked = _model()
        self._data = self._model.createData()
        self._foot = self._model.getFrameId("foot_2")
        self._base = self._model.getFrameId("arm_base")
        index = [self._model.joints[self._model.getJointId(name)].idx_q for name in CLIMBING_JOINTS]
        self._index = np.array(index)
        self.lower = np.array(self._model.lowerPositionLimit)[self._index]
        self.upper = np.array(self._model.upperPositionLimit)[self._index]
        self.effort = np.array(self._model.effortLimit)[self._index]

    @property
    def working(self) -> FloatArray:
        """The working stance (5,), as the SRDF has it."""
        return np.asarray(self._locked[self._index])

    def _configuration(self, angles: FloatArray) -> FloatArray:
        q = np.array(self._locked)
        q[self._index] = angles
        return q

    def poses(self, angles: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Poses of foot 2 and of the arm's base."""
        pin.framesForwardKinematics(self._model, self._data, self._configuration(angles))
        foot, base = self._data.oMf[self._foot], self._data.oMf[self._base]
        return np.array(foot.homogeneous), np.array(base.homogeneous)

    def weight(self, angles: FloatArray) -> tuple[float, FloatArray]:
        """Mass, kg, and centre of mass (3,), m, of what does not move while the arm works."""
        pin.forwardKinematics(self._model, self._data, self._configuration(angles))
        fixed = [0, *(self._model.getJointId(name) for name in CLIMBING_JOINTS)]
        bodies = [(self._model.inertias[k], self._data.oMi[k]) for k in fixed]
        mass = sum(body.mass for body, _ in bodies)
        first = sum(body.mass * X.act(body.lever) for body, X in bodies)
        return float(mass), np.asarray(first / mass)

    def bodies(self, angles: FloatArray) -> ClimberBodies:
        """Return masses, joints and frames in a posture (5,)."""
        foot, base = self.poses(angles)
        joints = [self._model.getJointId(name) for name in CLIMBING_JOINTS]
        places = [self._data.oMi[k] for k in joints]
        inertias = [self._model.inertias[k] for k in (0, *joints)]
        poses = [pin.SE3.Identity(), *places]
        axes = [self._model.joints[k].shortname() for k in joints]
        columns = ["XYZ".index(name[-1]) for name in axes]
        return ClimberBodies(
            mass=np.array([inertia.mass for inertia in inertias]),
            centre=np.array([X.act(body.lever) for X, body in zip(poses, inertias, strict=True)]),
            origin=np.array([X.translation for X in places]),
            axis=np.array([X.rotation[:, k] for X, k in zip(places, columns, strict=True)]),
            foot_2=foot,
            base=base,
        )

    def holding_joints(self, angles: FloatArray) -> tuple[HoldingJoint, ...]:
        """Return the joints (5,) locked in a posture, in the frame of foot 1, with their efforts."""
        climbing = {self._model.getJointId(name) for name in CLIMBING_JOINTS}
        moving = set(range(1, self._model.njoints)) - climbing
        return holding_joints(self._model, moving, self._configuration(angles), "arm_base")

    def hanging(self, R_WF: FloatArray) -> FloatArray | None:
        """The working stance with foot 1 turned about its normal so that the base hangs as there.

        None where no turn within the joint's range does that.

        Parameters
        ----------
        R_WF : (3, 3)
            Of foot 1; its y axis points out of the steel.
        """
        angles = self.working
        # The turn about the normal by which the foot's z axis is off the vertical.
        angles[0] -= np.arctan2(R_WF[2, 0], R_WF[2, 2]) * -1.0
        angles[0] = (angles[0] + np.pi) % (2 * np.pi) - np.pi
        level = abs(R_WF[2, 1]) < _FOOT_MISS
        return angles if level and self.lower[0] <= angles[0] <= self.upper[0] else None

    def reaching(self, X_12: FloatArray) -> list[FloatArray]:
        """Return the postures (5,) within the joint ranges that put foot 2 at `X_12`: up to four.

        The legs move in a plane that the first joint turns about the normal of foot 1; so where both feet
        have the same normal, two angles of that joint are possible, and with each the knee on either side.

        Parameters
        ----------
        X_12 : (4, 4)
            Pose of foot 2, whose y axis is that of foot 1.
        """
        if X_12[1, 1] < 1 - _FOOT_MISS:
            return []
        side, ankle, hip, leg = self._plane
        x, height, z = X_12[:3, 3]
        aside, found = float(np.hypot(x, z)), list[FloatArray]()
        if aside < abs(side):
            return []
        # The angle by which the first joint brings foot 2 as far out of the legs' plane as it is.
        lean, middle = np.arccos(side / aside), np.arctan2(x, z)
        for first in (middle - lean, middle + lean):
            along = x * np.cos(first) - z * np.sin(first)
            reach = np.array([along, height]) - ankle - hip
            length = float(np.hypot(*reach))
            if not 0 < length <= 2 * leg:
                continue
            bend = np.arccos(length / (2 * leg))
            for knee in (bend, -bend):
                # At zero a leg points along y.
                second = np.arctan2(reach[1], reach[0]) - np.pi / 2 + knee
                third = -2 * knee
                fourth = np.pi - second - third
                angles = np.array([first, second, third, fourth, 0.0])
                found += self._with_last(self._within(angles), X_12)
        return found

    @cached_property
    def _plane(self) -> tuple[float, FloatArray, FloatArray, float]:
        """Of the legs: how far foot 2 is beside, foot 2 from joint 4 and joint 2 from foot 1 (2,), length."""
        places = {name: self._model.jointPlacements[self._model.getJointId(name)] for name in CLIMBING_JOINTS}
        steps = [np.array(places[name].translation) for name in CLIMBING_JOINTS]
        # Ankle 2 is upside down where both feet have the same normal.
        return float(sum(step[2] for step in steps)), -steps[4][:2], (steps[0] + steps[1])[:2], steps[2][1]

    def _within(self, angles: FloatArray) -> FloatArray:
        """The same angles on the turn that is within the ranges, where one is."""
        middle = 0.5 * (self.lower + self.upper)
        return np.asarray(angles - 2 * np.pi * np.round((angles - middle) / (2 * np.pi)))

    def _with_last(self, angles: FloatArray, X_12: FloatArray) -> list[FloatArray]:
        """The posture with foot 2 turned about its normal as it should be, where that is possible."""
        X, _ = self.poses(angles)
        turned = X[:3, :3].T @ X_12[:3, :3]
        angles[4] = np.arctan2(turned[0, 2], turned[2, 2])
        X, _ = self.poses(angles)
        good = (angles >= self.lower).all() and (angles <= self.upper).all()
        return [angles] if good and np.abs(X - X_12).max() < _FOOT_MISS else []


@cache
def _model() -> tuple[Any, FloatArray]:
    """Model of the whole robot, and where its SRDF locks the joints."""
    folder = model_folder() / "urdf"
    model = pin.buildModelFromUrdf(str(folder / "cmbot.urdf"))
    q = pin.neutral(model)
    for entry in parse_urdf(folder / "cmbot.srdf", "an SRDF", ()).findall("group_state/joint"):
        name = entry.get("name", "")
        if name in CLIMBING_JOINTS:
            q[model.joints[model.getJointId(name)].idx_q] = float(entry.get("value", "0"))
    return model, q
