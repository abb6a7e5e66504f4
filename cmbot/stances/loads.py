"""Loads of many stances: what each makes of the arm's wrench, objective and bounds of the feet."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.elastic import SharedFrame
from cmbot.hold import Foot, Holding, needed_by_load
from cmbot.robot import Climber, Robot
from cmbot.scene import PlannerOptions, Scene, axis_point, feet_at
from cmbot.stances.candidates import Candidate


class _Shares:
    """What the feet of each candidate bear of a wrench."""

    def __init__(self, scene: Scene, candidates: Sequence[Candidate]) -> None:
        self._guardrail, self._number = scene.elastic_guardrail, dict[tuple[float, ...], int]()
        points = list[FloatArray]()
        for candidate in candidates:
            if candidate.stance.foot_2 is not None:
                for place in (candidate.stance.foot_1, candidate.stance.foot_2):
                    point = axis_point(scene.elastic_guardrail, place)
                    if self._key(point) not in self._number:
                        self._number[self._key(point)] = len(points)
                        points.append(point)
        self._frame = SharedFrame(scene.elastic_guardrail, np.array(points)) if points else None

    @staticmethod
    def _key(point: FloatArray) -> tuple[float, ...]:
        return tuple(np.round(point, 3).tolist())

    def of(self, candidate: Candidate) -> tuple[FloatArray, ...]:
        """The shares (6, 6) of its feet."""
        stance = candidate.stance
        if stance.foot_2 is None or self._frame is None:
            return (np.eye(6),)
        first, second = (
            self._number[self._key(axis_point(self._guardrail, place))]
            for place in (stance.foot_1, stance.foot_2)
        )
        return self._frame.shares(first, second, candidate.root[:3, 3])


class StanceLoads:
    """What stances make of the arm's wrench: values and gradients in the base's frame."""

    def __init__(
        self, scene: Scene, candidates: Sequence[Candidate], options: PlannerOptions, robot: Robot
    ) -> None:
        shared, climber = _Shares(scene, candidates), Climber()
        gravity = np.array(robot.model.gravity.linear)
        base = np.array([each.base for each in candidates])
        root = np.array([each.root for each in candidates])
        self.rotation = base[:, :3, :3]
        away = root[:, :3, 3] - base[:, :3, 3]
        self.foot = np.einsum("cji,cj->ci", self.rotation, away)
        self.gravity = np.einsum("cji,j->ci", self.rotation, gravity)
        weights = [climber.weight(each.climber) for each in candidates]
        mass, centre = (np.array(part) for part in zip(*weights, strict=True))
        still = mass[:, None] * gravity
        lever = np.einsum("cij,cj->ci", root[:, :3, :3], centre)
        self._still = np.hstack([still, np.cross(lever, still)])
        feet = [
            feet_at(scene.guardrail, each.stance, scene.elastic_guardrail, shared.of(each))
            for each in candidates
        ]
        # Where there is no second foot, the first one stands for it.
        self._feet = [[each[min(k, len(each) - 1)] for each in feet] for k in (0, 1)]
        self._from_wrench = [np.array([foot.from_wrench for foot in part]) for part in self._feet]
        self._alike = [_alike(part) for part in self._feet]
        self._holding = [Holding(each, self._still[k]) for k, each in enumerate(feet)]
        self._bounded = any(holding.bounded for holding in self._holding)
        self._torque = options.objective == "torque"
        self._point = -away if options.moment_about == "base" else np.zeros_like(away)
        self._weights = np.array(options.axis_weights)

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

    def adhesion(self, of: IntArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Adhesion (N,) that the feet need, and its gradients (N, 6); zero where none is flat."""
        value, gradient = np.zeros(len(of)), np.zeros((len(of), 6))
        whole = wrench + self._still[of]
        for by_wrench, feet, alike in zip(self._from_wrench, self._feet, self._alike, strict=True):
            load = np.einsum("kij,kj->ki", by_wrench[of], whole)
            for kind in np.unique(alike[of]):
                rows = np.flatnonzero(alike[of] == kind)
                foot = feet[int(of[rows[0]])]
                if foot.contact is None:
                    continue
                needed, by_load = needed_by_load(foot, load[rows])
                more = needed > value[rows]
                value[rows[more]] = needed[more]
                gradient[rows[more]] = np.einsum("ki,kij->kj", by_load[more], by_wrench[of[rows[more]]])
        return value, gradient

    def value(self, of: IntArray, wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Objective (N,) and its derivatives (N, 3) by the torque in the base's frame."""
        if self._torque:
            moment = self._weights * (wrench[:, 3:] - np.cross(self._point[of], wrench[:, :3]))
            value = np.linalg.norm(moment, axis=1)
            by_torque = self._weights * moment / np.maximum(value, 1e-9)[:, None]
        else:
            value, gradient = self.adhesion(of, wrench)
            by_torque = gradient[:, 3:]
        return value, np.einsum("kij,ki->kj", self.rotation[of], by_torque)

    def holds(self, of: IntArray, wrench: FloatArray) -> BoolArray:
        """Whether the feet bear it."""
        good = np.ones(len(of), dtype=np.bool_)
        for c in np.unique(of) if self._bounded else ():
            rows = of == c
            good[rows] = self._holding[c].share(wrench[rows])[0] <= 1.0
        return good


def _alike(feet: Sequence[Foot]) -> IntArray:
    """Numbers (C,) that are the same for feet that need the same adhesion for the same load."""
    kinds = dict[object, int]()
    return np.array([kinds.setdefault((foot.contact, foot.friction, foot.gap), len(kinds)) for foot in feet])
