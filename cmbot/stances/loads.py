"""Loads of many stances: what each makes of the arm's wrench, objective and bounds; how it bends."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import Literal

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic import SharedFrame, with_legs
from cmbot.elastic.first_order import Bases
from cmbot.hold import Foot, bears, needed_all_over, needed_by_load, share_of_bounds
from cmbot.robot import Climber, HoldingJoint, Robot, holding_rows, leg_compliance
from cmbot.scene import Scene, axis_point, feet_at
from cmbot.stances.bounds import Bounds, StanceObjective
from cmbot.stances.candidates import AnyCandidate, Candidate

_METRE_MM = 1e3


class _Support:
    """On what each candidate stands: the shares of its feet, and its stiffness at O0 in W."""

    def __init__(self, scene: Scene, candidates: Sequence[AnyCandidate], robot: Robot) -> None:
        self._guardrail, self._number = scene.elastic_guardrail, dict[tuple[float, ...], int]()
        self._file = scene.guardrail
        given = self._guardrail.stiffness
        self._given = None if given is None else np.array(given)
        self._hold = None if scene.base is None else scene.base.hold
        if self._hold is not None:
            # Where the link that is held is in the base frame.
            frames = robot.model.frames
            base, link = (
                frames[robot.model.getFrameId(name)].placement
                for name in (robot.base_frame, self._hold.link or robot.base_frame)
            )
            self._link = (base.inverse() * link).homogeneous
        # An identified base is what the arm stood on, legs included.
        self._identified = bool(scene.identified and scene.identified.base)
        points = list[FloatArray]()
        for candidate in candidates:
            each = [] if not isinstance(candidate, Candidate) else self._points(candidate)
            for point in each if len(each) > 1 or given is None else ():
                if self._key(point) not in self._number:
                    self._number[self._key(point)] = len(points)
                    points.append(point)
        self._frame = SharedFrame(self._guardrail, np.array(points)) if points else None

    def _points(self, candidate: Candidate) -> list[FloatArray]:
        return [axis_point(self._guardrail, place) for place in candidate.stance.held]

    @staticmethod
    def _key(point: FloatArray) -> tuple[float, ...]:
        return tuple(np.round(point, 3).tolist())

    def _numbers(self, candidate: Candidate) -> list[int]:
        return [self._number[self._key(point)] for point in self._points(candidate)]

    def feet(self, candidate: AnyCandidate, legs: FloatArray | None) -> tuple[Foot, ...]:
        """The feet that hold, with `SharedFrame.shares` by the legs; of a mount that by which it is held."""
        if not isinstance(candidate, Candidate):
            held = self._hold
            return () if held is None else (held.foot(candidate.base @ self._link, candidate.base[:3, 3]),)
        shares: tuple[FloatArray, ...] = (np.eye(6),)
        if candidate.stance.foot_2 is not None and self._frame is not None:
            shares = self._frame.shares(self._numbers(candidate), candidate.root[:3, 3], legs)
        return feet_at(self._file, candidate.stance, self._guardrail, shares)

    def stiffness(self, candidate: AnyCandidate, legs: FloatArray | None) -> FloatArray | None:
        """Its stiffness (6, 6) at O0 in W, legs included; None: rigid."""
        if not isinstance(candidate, Candidate):
            return candidate.stiffness
        if self._given is not None:
            return self._given if self._identified else with_legs(self._given, legs)
        if self._frame is None:
            return None
        return self._frame.stiffness(self._numbers(candidate), candidate.root[:3, 3], legs)


class StanceLoads:
    """What stances make of the arm's wrench: values and gradients in the base's frame.

    Parameters
    ----------
    scene : Scene
    candidates : sequence of Candidate or MountCandidate
    robot : Robot
        In the scene's stance.
    arm : Robot
        The arm on a base at the origin of its own frame.
    objective : str
        The objective.
    bounds : Bounds
    """

    def __init__(
        self,
        scene: Scene,
        candidates: Sequence[AnyCandidate],
        robot: Robot,
        arm: Robot,
        objective: StanceObjective,
        bounds: Bounds,
    ) -> None:
        gravity = np.array(robot.model.gravity.linear)
        base = np.array([each.base for each in candidates])
        root = np.array([each.root for each in candidates])
        self.rotation = base[:, :3, :3]
        away = root[:, :3, 3] - base[:, :3, 3]
        self.foot = np.einsum("cji,cj->ci", self.rotation, away)
        self.gravity = np.einsum("cji,j->ci", self.rotation, gravity)
        climber, body = Climber(), arm.model.inertias[0]
        weights = [
            climber.weight(each.climber)
            if isinstance(each, Candidate)
            else (float(body.mass), np.array(body.lever))
            for each in candidates
        ]
        self._mass, centre = (np.array(part) for part in zip(*weights, strict=True))
        lever = np.einsum("cij,cj->ci", root[:, :3, :3], centre)
        self._centre = self.foot + np.einsum("cji,cj->ci", self.rotation, lever)
        still = self._mass[:, None] * gravity
        self._still = np.hstack([still, np.cross(lever, still)])
        support = _Support(scene, candidates, robot)
        joints = [_locked(each, robot, arm, climber) for each in candidates]
        legs = [
            leg_compliance(part, len(each.feet), each.root[:3, 3])
            for part, each in zip(joints, candidates, strict=True)
        ]
        each_leg = [*zip(candidates, legs, strict=True)]
        feet = [support.feet(each, leg) for each, leg in each_leg]
        self._feet(feet)
        self._lock(joints, feet, root[:, :3, 3], gravity)
        self._stiffness = self._turned([support.stiffness(each, leg) for each, leg in each_leg])
        self.bends = self._stiffness is not None or bool(arm.elasticity or arm.joint_elasticity)
        self.objective: StanceObjective | Literal["use"] = objective
        self._bounds = bounds
        about_base = scene.planner.moment_about == "base"
        self._point = -away if about_base else np.zeros_like(away)
        self._weights = np.array(scene.planner.axis_weights)

    def within(self, bounds: Bounds) -> StanceLoads:
        """Return the same with other bounds."""
        loads = copy(self)
        loads._bounds = bounds
        return loads

    def by_use(self) -> StanceLoads:
        """Return the same that ranks by the share that feet use of what they bear, and lets that exceed 1."""
        loads = copy(self)
        loads.objective, loads._bounded = "use", False
        return loads

    def _lock(
        self,
        joints: Sequence[Sequence[HoldingJoint]],
        feet: Sequence[Sequence[Foot]],
        foot_points: FloatArray,
        gravity: FloatArray,
    ) -> None:
        """What the locked joints of C stances hold: rows, constants, limits and efforts of J at most."""
        C, J = len(joints), max((len(part) for part in joints), default=0)
        self._rows, self._own = np.zeros((C, J, 6)), np.zeros((C, J))
        self._limits, self._efforts = np.full((C, J), np.inf), np.full((C, J), np.inf)
        for c, part in enumerate(joints):
            shares = [foot.share for foot in feet[c]] or [np.eye(6)]
            rows, own = holding_rows(part, shares, foot_points[c], gravity, self._still[c])
            self._rows[c, : len(part)], self._own[c, : len(part)] = rows, own
            self._limits[c, : len(part)] = [joint.limit for joint in part]
            self._efforts[c, : len(part)] = [joint.effort for joint in part]

    def held(self, of: IntArray, wrench: FloatArray) -> FloatArray:
        """Largest torque (N,), Nm, of a locked joint, and largest shares of limits and efforts: (3, N).

        NaN where no joint is locked.
        """
        if not self._rows.shape[1]:
            return np.full((3, len(of)), np.nan)
        torque = np.abs(np.einsum("kji,ki->kj", self._rows[of], wrench) + self._own[of])
        parts = (torque, torque / self._limits[of], torque / self._efforts[of])
        return np.array([part.max(axis=1, initial=0.0) for part in parts])

    def _feet(self, feet: Sequence[tuple[Foot, ...]]) -> None:
        # Where there is no second foot, the first one stands for it.
        parts = [[each[min(k, len(each) - 1)] for each in feet] for k in (0, 1)] if all(feet) else []
        self._from_wrench = [np.array([foot.from_wrench for foot in part]) for part in parts]
        self._parts, self._alike = parts, [_alike(part) for part in parts]
        self._bounded = any(foot.bounded for part in parts for foot in part)

    def _turned(self, each: Sequence[FloatArray | None]) -> FloatArray | None:
        """Stiffness (C, 6, 6) along the axes of the bases; what is rigid is very stiff beside what bends."""
        known = [K for K in each if K is not None]
        if not known:
            return None
        rigid = np.diag(np.max([np.diag(K) for K in known], axis=0)) * 1e4
        K = np.array([rigid if one is None else one for one in each])
        T = np.zeros_like(K)
        T[:, :3, :3] = T[:, 3:, 3:] = self.rotation
        return np.asarray(T.transpose(0, 2, 1) @ K @ T)

    def bases(self, of: IntArray) -> Bases:
        """Return on what stances stand."""
        return Bases(
            foot=self.foot[of],
            stiffness=None if self._stiffness is None else self._stiffness[of],
            carrier_mass=self._mass[of],
            carrier_centre=self._centre[of],
        )

    def wrench(
        self, of: IntArray, first_moment: FloatArray, mass: float, push: FloatArray, tool: FloatArray
    ) -> FloatArray:
        """Wrench (N, 6) about O0 in W from first moments (N, 3) and pushes at tool points, in the base."""
        force = mass * self.gravity[of] + push
        torque = np.cross(first_moment - mass * self.foot[of], self.gravity[of])
        if push.any():
            torque += np.cross(tool - self.foot[of], push)
        R = self.rotation[of]
        return np.hstack([np.einsum("kij,kj->ki", R, part) for part in (force, torque)])

    def adhesion(
        self, of: IntArray, wrench: FloatArray, *, nearly: bool = False
    ) -> tuple[FloatArray, FloatArray]:
        """Adhesion (N,) that the feet need, and its gradients (N, 6); zero where none is flat.

        What they need `nearly` is quicker: see `needed_all_over`.
        """
        value, gradient = np.zeros(len(of)), np.zeros((len(of), 6))
        for foot, rows, load, by_wrench in self._by_foot(of, wrench):
            if foot.contact is None:
                continue
            known = value[rows]
            needed, by_load = needed_all_over(foot, load) if nearly else needed_by_load(foot, load, known)
            more = needed > known
            value[rows[more]] = needed[more]
            gradient[rows[more]] = np.einsum("ki,kij->kj", by_load[more], by_wrench[more])
        return value, gradient

    def _by_foot(
        self, of: IntArray, wrench: FloatArray
    ) -> Iterator[tuple[Foot, IntArray, FloatArray, FloatArray]]:
        """Yield feet, the rows whose feet are like that, their loads and what makes them of the wrench."""
        whole = wrench + self._still[of]
        for by_wrench, feet, alike in zip(self._from_wrench, self._parts, self._alike, strict=True):
            for kind in np.unique(alike[of]):
                rows = np.flatnonzero(alike[of] == kind)
                by = by_wrench[of[rows]]
                yield feet[int(of[rows[0]])], rows, np.einsum("kij,kj->ki", by, whole[rows]), by

    def torque(self, of: IntArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weighted moment (N,), Nm, and its gradients (N, 3) by the torque in W."""
        moment = self._weights * (wrench[:, 3:] - np.cross(self._point[of], wrench[:, :3]))
        value = np.linalg.norm(moment, axis=1)
        return value, self._weights * moment / np.maximum(value, 1e-9)[:, None]

    def slope(self, of: IntArray, wrench: FloatArray, tool: FloatArray) -> FloatArray:
        """Derivatives (N, 3) of what is ranked by the torque in the base's frame; sag by that of the base."""
        if self.objective in ("torque", "use"):
            by_torque = self.torque(of, wrench)[1]
        elif self.objective == "hold":
            by_torque = self.adhesion(of, wrench, nearly=True)[1][:, 3:]
        elif self._stiffness is None:
            by_torque = self.torque(of, wrench)[1]
        else:
            R, lever = self.rotation[of], tool - self.foot[of]
            whole = (wrench + self._still[of]).reshape(-1, 2, 3) @ R
            motion = np.zeros((len(of), 3, 6))
            motion[:, :, :3] = np.eye(3)
            motion[:, :, 3:] = np.cross(lever[:, None], np.eye(3))
            compliance = motion @ np.linalg.inv(self._stiffness[of])
            sag = np.einsum("kij,kj->ki", compliance, whole.reshape(-1, 6))
            unit = sag / np.maximum(np.linalg.norm(sag, axis=1), 1e-12)[:, None]
            return np.asarray(np.einsum("ki,kij->kj", unit, compliance[:, :, 3:]))
        return np.asarray(np.einsum("kij,ki->kj", self.rotation[of], by_torque))

    def holds(self, of: IntArray, wrench: FloatArray) -> BoolArray:
        """Whether feet and locked joints bear it, and torque and adhesion are within their bounds."""
        good = self.torque(of, wrench)[0] <= self._bounds.base_torque_nm
        if np.isfinite(self._bounds.adhesion_n):
            good &= self.adhesion(of, wrench)[0] <= self._bounds.adhesion_n
        good &= ~(self.held(of, wrench)[1] > 1.0)
        kept = np.flatnonzero(good)
        for foot, rows, load, _ in self._by_foot(of[kept], wrench[kept]) if self._bounded else ():
            good[kept[rows]] &= bears(foot, load)
        return good

    def weakest_foot(self, number: int) -> Foot:
        """Return that of a stance on which a magnet can pull least."""
        return min((part[number] for part in self._parts), key=lambda foot: foot.most_adhesion)

    @property
    def bounded(self) -> bool:
        """Whether something is known of what feet bear."""
        return self._bounded

    def use(self, of: IntArray, wrench: FloatArray) -> FloatArray:
        """Largest share (N,) of what feet bear, safety included."""
        use = np.zeros(len(of))
        for foot, rows, load, _ in self._by_foot(of, wrench):
            use[rows] = np.maximum(use[rows], share_of_bounds(foot, load))
        return use

    @property
    def sags(self) -> bool:
        """Whether postures are judged by their sag."""
        return self.bends and (self.objective in ("sag", "sway") or bool(np.isfinite(self._bounds.sag_mm)))

    @property
    def most_sag(self) -> float:
        """Bound of the sag, m."""
        return self._bounds.sag_mm / _METRE_MM


def _locked(candidate: AnyCandidate, robot: Robot, arm: Robot, climber: Climber) -> list[HoldingJoint]:
    """The locked joints of a stance, with limits and springs of those of the robot."""
    if not isinstance(candidate, Candidate):
        return [joint.moved(pin.SE3(candidate.base)) for joint in arm.holding_joints]
    known = {joint.name: joint for joint in robot.locked_joints}
    return [
        replace(joint, limit=known[joint.name].limit, spring=known[joint.name].spring).moved(
            pin.SE3(candidate.root)
        )
        for joint in climber.holding_joints(candidate.climber)
        if joint.foot < len(candidate.feet)
    ]


def _alike(feet: Sequence[Foot]) -> IntArray:
    """Numbers (C,) that are the same for feet that need and bear the same under the same load."""
    kinds = dict[object, int]()
    keys = [
        (foot.contact, foot.friction, foot.gap, foot.safety, foot.adhesion, foot.force, foot.moment)
        for foot in feet
    ]
    return np.array([kinds.setdefault(key, len(kinds)) for key in keys])
