"""How the arm and what it stands on bend, as the pages draw it: joints, tubes, and beams below the foot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, interpolated
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.elastic.strain import tube_strains
from cmbot.planning import Plan, bending_arm, held_guardrail
from cmbot.simulation import Tracking, elastic_arm_of
from cmbot.views.drawing.support import Rails, packed_strains, pole_of

# Least time between two equilibria, s; the page interpolates.
_MIN_EQUILIBRIUM_STEP_S = 0.2

# Coordinates that bend by less than this share of the largest are on a line.
_STRAIGHT_SHARE = 1e-9

# Factors with which a page begins, and the largest deflection it then draws, as a share of the reach.
_SCALES = (1, 2, 5, 10, 20, 50, 100, 200)
_SHOWN_SHARE = 0.08

Intervals = Sequence[tuple[float, float]]


def drawn_factor(deflection: float, reach: float) -> int:
    """Return the factor by which a page draws a largest `deflection` at first, for an arm of that `reach`, m.

    It is the largest round number with which no more than 8 % of the reach is drawn; 1 where the deflection
    itself is as large as that.
    """
    return max((f for f in _SCALES if f * deflection <= _SHOWN_SHARE * reach), default=_SCALES[0])


def most_factor(deflection: float, reach: float) -> int:
    """Return the largest factor that a page offers: up to that at which the reach is drawn, 2 to 200."""
    return int(np.clip(reach / max(deflection, 1e-9), 2, _SCALES[-1]))


class Bending:
    """The elastic arm of a plan, and its elastic coordinates along motions.

    At rest they are those of equilibrium. In vibration they are, beside it, those of least energy that put
    the tool where the simulation has it.
    """

    def __init__(self, arm: ElasticArm, plan: Plan, *, simulated: bool) -> None:
        self._arm = arm
        self._plan = plan
        self.simulated = simulated
        self._tubes = tube_strains(arm)

    @classmethod
    def of(cls, plan: Plan, tracking: Tracking | None) -> Bending | None:
        """Return that of a plan, as it was simulated where it was; None where nothing bends."""
        if tracking is not None:
            return cls(elastic_arm_of(plan, tracking.options), plan, simulated=True)
        arm = bending_arm(plan.scene, plan.robot)
        return None if arm is None else cls(arm, plan, simulated=False)

    def data(self) -> dict[str, Any]:
        """Return the chain, ready for JSON.

        ``joints``: pose of the joint's frame in the one before, axis (linear, angular), and whether it is
        driven, with the index among the driven or the elastic ones. ``links``: of each link of the robot the
        joints whose frames carry its beginning and its end, the pose of the link's frame in the latter, the
        ends of its tube, and which of the beams of ``strains`` are its segments. ``base``: the joint that
        carries the ``foot``, in W; -1 where it is rigid. ``frame``: the guardrail's beams, with ``strains``
        where these are known; None without. ``pole``: the beams of a pole that carries the foot, each from
        where it is held to the foot.
        """
        pole = None if self._arm.base is None else pole_of(self._plan.scene)
        return {
            "foot": list(self._arm.robot.foot_point),
            "joints": list(self._joints()),
            "links": list(self._links()),
            "strains": packed_strains(self._tubes),
            "base": 5 if self._arm.base is not None else -1,
            "frame": None if self._rails is None else self._rails.data(),
            "pole": [] if pole is None else pole.beams.tolist(),
        }

    def largest_strain(self, u: FloatArray) -> float:
        """Return the largest strain of guardrail and links at elastic coordinates `u` (N, f)."""
        beams = [self._tubes, None if self._rails is None else self._rails.strains]
        # A strain is convex in the coordinates: along a straight piece of them it is largest at an end.
        bent = np.abs(np.diff(u, 2, axis=0)).max(axis=1) > _STRAIGHT_SHARE * np.abs(u).max(initial=0.0)
        ends = u[np.concatenate([[True], bent, [True]])[: len(u)]]
        return max(float(each.largest(ends).max(initial=0.0)) for each in beams if each is not None)

    def poses(self, q: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the poses (N, m, 7) of the links' joints and the tool's places (N, 3) in W of the bent arm.

        In postures `q` (N, n) with elastic coordinates `u` (N, f); position, then quaternion x, y, z, w.
        """
        arm, model, data = self._arm, self._arm.model, self._arm.model.createData()
        joints = (arm.driven + 1).tolist()
        poses, tool = np.empty((len(q), len(joints), 7)), np.empty((len(q), 3))
        for k, configuration in enumerate(arm.configuration(q, u)):
            pin.framesForwardKinematics(model, data, configuration)
            poses[k] = [_pose(data.oMi[joint]) for joint in joints]
            tool[k] = data.oMf[arm.tool_frame_id].translation
        return poses, tool

    def coordinates(
        self, t: FloatArray, q: FloatArray, dynamic: FloatArray | None = None, on: Intervals = ()
    ) -> FloatArray:
        """Return the elastic coordinates (N, f), m and rad, in postures `q` (N, n) at times `t` (N,), s.

        `dynamic` (N, 3), m, is the tool's displacement in W beside its sag; the tool is `on` in intervals.
        """
        every = max(int(_MIN_EQUILIBRIUM_STEP_S / max(float(np.diff(t).max(initial=0.0)), 1e-9)), 1)
        some = np.unique(np.append(np.arange(0, len(t), every), len(t) - 1))
        if np.ptp(q, axis=0).max(initial=0.0) == 0.0:
            some = some[:1]
        at_work = np.zeros(len(t), dtype=bool)
        for begin, end in on:
            at_work |= (t >= begin) & (t <= end)
        arms = [self._arm.tool_off]
        if self._arm.robot.pushed and at_work.any():
            arms.append(self._arm)
        found = [Sag(arm).equilibria(q[some])[:2] for arm in arms]
        coarse = np.where(at_work[some, None], found[-1][0], found[0][0])
        u = interpolated(t, t[some], coarse)
        if len(arms) > 1:  # the force sets in at once
            on_u, off_u = (interpolated(t, t[some], each[0]) for each in reversed(found))
            u = np.where(at_work[:, None], on_u, off_u)
        if dynamic is not None:
            shapes = self._shapes(q[some], found[0][0], found[0][1])
            spread = interpolated(t, t[some], shapes.reshape(len(some), -1)).reshape(len(t), -1, 3)
            u = u + np.einsum("kfi,ki->kf", spread, np.nan_to_num(dynamic))
        return u

    def _shapes(self, q: FloatArray, u: FloatArray, tangent: FloatArray) -> FloatArray:
        """Elastic coordinates (K, f, 3) of least energy for displacements of the tool along x, y and z."""
        arm, data = self._arm, self._arm.model.createData()
        J = np.empty((len(q), 3, len(arm.elastic)))
        for k, configuration in enumerate(arm.configuration(q, u)):
            J[k] = arm.tool_jacobian(configuration, data)[1][:3, arm.elastic]
        yielding = np.linalg.solve(tangent, J.transpose(0, 2, 1))
        return np.asarray(yielding @ np.linalg.pinv(J @ yielding))

    def _joints(self) -> Iterator[dict[str, Any]]:
        arm, model = self._arm, self._arm.model
        data = model.createData()
        pin.computeJointJacobians(model, data, np.zeros(model.nq))
        driven = {int(index): number for number, index in enumerate(arm.driven)}
        elastic = {int(index): number for number, index in enumerate(arm.elastic)}
        for joint in range(1, model.njoints):
            place = int(model.joints[joint].idx_v)
            J = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL).reshape(6, -1)
            yield {
                "pose": _pose(model.jointPlacements[joint]),
                "axis": J[:, place].tolist(),
                "driven": place in driven,
                "index": driven.get(place, elastic.get(place, 0)),
            }

    def _links(self) -> Iterator[dict[str, Any]]:
        arm, robot = self._arm, self._arm.robot
        model, rigid = arm.model, robot.model
        # Joints of the chain that drive, and where the chain ends.
        driving = [*(arm.driven + 1).tolist(), model.njoints]
        tubes = {
            rigid.frames[rigid.getFrameId(link)].parentJoint: (rigid.frames[rigid.getFrameId(link)], tube)
            for link, tube in robot.elasticity.items()
        }
        for number in range(1, rigid.njoints):
            first, following = driving[number - 1 : number + 1]
            end = following - 1
            start = next((k for k in range(first + 1, following) if " segment " in model.names[k]), following)
            if following < model.njoints:
                X = model.jointPlacements[following] * rigid.jointPlacements[number + 1].inverse()
            else:
                tool = model.frames[arm.tool_frame_id].placement
                X = tool * rigid.frames[robot.tool_frame_id].placement.inverse()
            frame, tube = tubes.get(number, (None, None))
            ends, beams = None, []
            if frame is not None and tube is not None:
                segments = range(arm.options.segments)
                beams = [segments.stop * list(robot.elasticity).index(frame.name) + k for k in segments]
                ends = [*frame.placement.act(np.array(tube.start)), *frame.placement.act(np.array(tube.end))]
            yield {"start": start - 2, "end": end - 1, "pose": _pose(X), "tube": ends, "beams": beams}

    @cached_property
    def _rails(self) -> Rails | None:
        elastic = self._arm.base is not None and bool(self._plan.scene.elastic_guardrail.post_positions)
        return Rails(held_guardrail(self._plan.scene, self._plan.robot)) if elastic else None


def _pose(X: Any) -> list[float]:
    return [float(value) for value in pin.SE3ToXYZQUAT(X)]
