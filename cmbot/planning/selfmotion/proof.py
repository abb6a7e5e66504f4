"""Proofs about all postures that hold the tool at a via-point, without samples of them.

Branch and bound over boxes of joint angles that cover every posture within the joint ranges (Hansen and
Walster, Global Optimization Using Interval Analysis). A box is dropped when nothing in it can hold the tool,
or when all in it is inadmissible or has no smaller objective than the bound to be proven; it is narrowed to
the part that can hold the tool, and halved. The angles of a spherical joint follow from the others in closed
form, so only the others are halved. What a box may contain is bounded by first derivatives at its middle and
bounds of the second derivatives within it; all of it in floating-point numbers, for whose rounding
`_CONDITION_ROUNDING` is allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, cross
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.joint_boxes import (
    JointBoxes,
    azimuth_between,
    common_moves,
    inverses,
    narrowed,
    without_pivot,
)
from cmbot.planning.selfmotion.spherical_joint import WristChain, turns, wrist_chain
from cmbot.planning.workcell.objectives import WeightedMoment, WrenchObjective
from cmbot.planning.workcell.workcell import Workcell
from cmbot.robot import PostureBatch, Postures, ToolBatch, frame_about

# Boxes are dropped when they miss a condition by more than this, m, rad, or a share of Nm.
_CONDITION_ROUNDING = 1e-9
# Of clearances, m: distances are computed to 1e-6 m.
_DISTANCE_ROUNDING = 2e-6
# Boxes are first halved until no joint's half is wider than this, rad, by the centre of the spherical joint
# alone.
_COARSE_HALF_WIDTH = 0.12
# Boxes at most at a time, and of a whole proof; an unfinished proof has a larger error.
_MOST_BOXES, _MOST_WORK = 40_000, 100_000
# Halvings at most.
_MAX_HALVINGS = 120
# Rounds and boxes of a proof that nothing holds the tool: where something does, boxes only become more.
_REACH_ROUNDS, _REACH_BOXES = 24, 5000
# Angles that follow from others are halved only where their boxes are this many times as wide.
_DEPENDENT_WIDTH_RATIO = 4.0
# In boxes in which the arm moves further than this, m, clearances are not computed.
_MAX_CLEARANCE_BOX_M = 0.25
# Accuracy of a proof, as a share of the bound.
_PROOF_ACCURACY = 1e-5
# Boxes whose middles are tried as postures, in each round.
_BOXES_TRIED, _TRIAL_INTERVAL = 5, 3
# Fewer boxes than this are halved twice in a round: what a round costs is then not theirs.
_FEW_BOXES = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Proof:
    """What is true of every admissible posture at a via-point.

    Attributes
    ----------
    lowest : float
        No admissible posture has a smaller objective at rest; infinite where there is none at all.
    posture : (n,) or None
        An admissible one with a smaller objective than the value that was to be proven, where one was met.
    value : float
        Its objective, or that value.
    boxes : int
        How many were examined.
    """

    lowest: float
    posture: FloatArray | None
    value: float
    boxes: int


class TorqueFloorProof:
    """Proves bounds of the objective at rest over all admissible postures at via-points.

    Use `of`, which returns None where there is no proof: the objective is not a moment, the arm and its task
    do not decouple (`wrist_chain`), or the task leaves open where the force on the tool points.

    Parameters
    ----------
    request : StrokeRequest
    chain : WristChain
    function : WeightedMoment
        The request's objective.
    """

    def __init__(self, request: StrokeRequest, chain: WristChain, function: WeightedMoment) -> None:
        cell = request.cell
        self._request, self._cell, self._chain = request, request.cell, chain
        limits = cell.robot.limits
        self._range = limits.sampled
        self._lever = chain.lever_bounds()
        self._goal_frame = frame_about(chain.axis[0])
        model = cell.robot.model
        self._gravity = float(np.linalg.norm(model.gravity.linear))
        self._moment = _moment_bounds(request.cell)
        # The weights are looked at by themselves: what the force adds on the task does not change there.
        self._unloaded = Postures(cell.robot.tool_off)
        self._push = float(np.linalg.norm(cell.robot.tool_force))
        self._inner = chain.joints[: chain.inner]
        self._wrist = chain.joints[chain.inner :]
        self._function = function
        self._heaviest = float(function.weights.max())
        self._weight = _weights(request.cell)

    @staticmethod
    def of(request: StrokeRequest) -> TorqueFloorProof | None:
        """Return what proves bounds for a request; None where nothing does."""
        objective = request.cell.objective
        function = objective.function if isinstance(objective, WrenchObjective) else None
        chain = wrist_chain(request) if isinstance(function, WeightedMoment) else None
        if chain is None or not isinstance(function, WeightedMoment):
            return None
        if request.task.keep != "pose" and any(request.cell.robot.tool_force[:2]):
            # Only along the axis that the task keeps is it the same in all postures on it.
            return None
        return TorqueFloorProof(request, chain, function)

    def prove(self, via_point: int, value: float) -> Proof:
        """Prove that no admissible posture at a via-point has a smaller objective than `value`.

        Where one has, the proof is of the smallest.
        """
        goal = self._chain.goal_centre[via_point]
        boxes = self._coarse(goal)
        boxes = JointBoxes.joined(boxes, replace(boxes, side=-boxes.side))
        examined, left_out, posture = len(boxes), np.inf, None
        for number in range(_MAX_HALVINGS):
            boxes = self._by_centre(boxes, goal)
            boxes = self._by_wrist(boxes)
            boxes, lowest = self._admissible(boxes, via_point, value * (1 - _PROOF_ACCURACY))
            if len(boxes) == 0:
                break
            found = None
            if number % _TRIAL_INTERVAL == 0:
                found = self._tried(boxes, lowest, via_point, value)
            if found is not None:
                posture, value = found
                keep = lowest < value * (1 - _PROOF_ACCURACY)
                boxes, lowest = boxes[keep], lowest[keep]
            examined += 2 * len(boxes)
            if examined > _MOST_WORK or len(boxes) > _MOST_BOXES or self._request.deadline.expired():
                left_out = float(lowest.min(initial=np.inf))
                break
            boxes = self._halved(boxes)
            if len(boxes) < _FEW_BOXES:
                boxes = self._halved(boxes)
        else:
            left_out = float(lowest.min(initial=np.inf))
        lowest_value = min(left_out, value * (1 - _PROOF_ACCURACY)) if np.isfinite(value) else left_out
        return Proof(lowest=max(lowest_value, 0.0), posture=posture, value=value, boxes=examined)

    def holds_nothing(self, via_point: int) -> bool:
        """Whether it is proven that no posture within the joint ranges holds the tool at a via-point."""
        goal = self._chain.goal_centre[via_point]
        boxes = self._coarse(goal)
        boxes = JointBoxes.joined(boxes, replace(boxes, side=-boxes.side))
        for _ in range(_REACH_ROUNDS):
            boxes = self._by_wrist(self._by_centre(boxes, goal))
            boxes, _, keep = self._on_task(boxes, goal, np.zeros_like(boxes.lower))
            boxes = boxes[keep]
            if len(boxes) == 0 or len(boxes) > _REACH_BOXES:
                break
            boxes = self._halved(boxes)
        return len(boxes) == 0

    def _coarse(self, goal: FloatArray) -> JointBoxes:
        """Boxes that cover all postures with the centre of the spherical joint at `goal` (3,)."""
        lower, upper = self._range
        boxes = JointBoxes(lower[None], upper[None], np.ones(1, dtype=np.intp))
        split = self._inner[1:]
        while True:
            boxes = self._by_centre(boxes, goal)
            half = boxes.half[:, split]
            if len(boxes) == 0 or half.max() <= _COARSE_HALF_WIDTH:
                return boxes
            wide = half.max(axis=1) > _COARSE_HALF_WIDTH
            joint = split[half[wide].argmax(axis=1)]
            boxes = JointBoxes.joined(boxes[~wide], boxes[wide].halved(joint))

    def _by_centre(self, boxes: JointBoxes, goal: FloatArray) -> JointBoxes:
        """Drop and narrow boxes by where the inner joints may place the centre of the spherical joint.

        Its height along the first axis and distance from it do not depend on the first joint, whose angle
        follows.
        """
        chain, inner = self._chain, self._inner
        middle, half = boxes.middle[:, inner], boxes.half[:, inner]
        middle[:, 0] = 0.0
        axes, p, _ = self._placed(middle)
        frame = self._goal_frame
        J = np.stack([cross(a, p - o) for a, o in axes[1:]], axis=2)
        off = self._second_order(half[:, 1:], self._lever[1:]) + chain.slack + _CONDITION_ROUNDING
        goal = frame.T @ (goal - chain.origin[0])
        at = (p - chain.origin[0]) @ frame
        J = np.einsum("ij,kin->kjn", frame, J)
        radius, wanted = np.hypot(at[:, 0], at[:, 1]), float(np.hypot(goal[0], goal[1]))
        unit = np.divide(at[:, :2], radius[:, None], out=np.zeros((len(at), 2)), where=radius[:, None] > 0)
        along = np.abs(np.einsum("ki,kin->kn", unit, J[:, :2])) * half[:, 1:]
        across = np.stack([-unit[:, 1], unit[:, 0]], axis=1)
        aside = (np.abs(np.einsum("ki,kin->kn", across, J[:, :2])) * half[:, 1:]).sum(axis=1) + off
        height = (np.abs(J[:, 2]) * half[:, 1:]).sum(axis=1) + off
        spread = along.sum(axis=1) + off
        # On the first axis there is no radial direction.
        flat = radius < _CONDITION_ROUNDING
        spread[flat] = (np.linalg.norm(J[flat, :2], axis=1) * half[flat, 1:]).sum(axis=1) + off[flat]
        keep = np.abs(goal[2] - at[:, 2]) <= height
        keep &= wanted >= radius - spread
        keep &= wanted <= np.hypot(radius + spread, aside)
        width = np.where(radius > spread, np.arctan2(aside, np.maximum(radius - spread, 0.0)), np.pi)
        if wanted > chain.slack:
            width += np.arcsin(min(1.0, (chain.slack + _CONDITION_ROUNDING) / wanted))
        else:
            width[:] = np.pi
        angle = np.arctan2(goal[1], goal[0]) - np.arctan2(at[:, 1], at[:, 0])
        return narrowed(boxes, inner[0], angle, width, keep)[0]

    def _by_wrist(self, boxes: JointBoxes) -> JointBoxes:
        """Narrow the angles of the spherical joint, which follow from those of the inner joints."""
        chain = self._chain
        u, v, w = chain.axis[-3:]
        *_, R = self._placed(boxes.middle[:, self._inner])
        turned = boxes.half[:, self._inner].sum(axis=1) + _CONDITION_ROUNDING
        across = R.transpose(0, 2, 1) @ chain.goal_rotation
        z, z_back = across @ w, across.transpose(0, 2, 1) @ u
        # Middle angle: u and w stay at theirs, up to the turn of the inner joints.
        sine, cosine = u @ cross(v, w), u @ w - (u @ v) * (v @ w)
        size, phase = np.hypot(sine, cosine), np.arctan2(sine, cosine)
        between = np.arccos(np.clip(z @ u, -1.0, 1.0))
        high = np.cos(np.maximum(between - turned, 0.0)) - (u @ v) * (v @ w)
        low = np.cos(np.minimum(between + turned, np.pi)) - (u @ v) * (v @ w)
        keep = (low <= size + _CONDITION_ROUNDING) & (high >= -size - _CONDITION_ROUNDING)
        first, last = (np.arccos(np.clip(x / size, -1.0, 1.0)) for x in (high, low))
        angle = phase + boxes.side * 0.5 * (first + last)
        boxes, kept = narrowed(boxes, self._wrist[1], angle, 0.5 * (last - first) + _CONDITION_ROUNDING, keep)
        z, z_back, turned = z[kept], z_back[kept], turned[kept]
        b, spread = boxes.middle[:, self._wrist[1]], boxes.half[:, self._wrist[1]]
        # Outer angles: azimuths about u and w.
        y = turns(v, b) @ w
        angle, width = azimuth_between(u, z, turned, y, spread)
        boxes, kept = narrowed(boxes, self._wrist[0], angle, width, np.ones(len(boxes), dtype=np.bool_))
        if chain.free_axis is not None:
            return boxes
        y = turns(v, -b[kept]) @ u
        angle, width = azimuth_between(w, y, spread[kept], z_back[kept], turned[kept])
        return narrowed(boxes, self._wrist[2], angle, width, np.ones(len(boxes), dtype=np.bool_))[0]

    def _placed(self, q: FloatArray) -> tuple[list[tuple[FloatArray, FloatArray]], FloatArray, FloatArray]:
        """Axes and origins of the inner joints at `q` (N, k), the centre (N, 3), the rotation after them."""
        steps = list(self._chain.walk(q))
        _, origin, R = steps[-1]
        p = origin + R @ (self._chain.centre - self._chain.origin[self._chain.inner - 1])
        return [(axis, o) for axis, o, _ in steps], p, R

    @staticmethod
    def _second_order(half: FloatArray, lever: FloatArray) -> FloatArray:
        """Bounds (N,) of half the second-order term over boxes with `half` (N, k) edges.

        The second derivative by joints i and j is at most the lever of the later one.
        """
        before = np.cumsum(half, axis=1) - half
        return 0.5 * (half * (half + 2 * before)) @ lever

    def _admissible(self, boxes: JointBoxes, via_point: int, enough: float) -> tuple[JointBoxes, FloatArray]:
        """Drop boxes without admissible postures below `enough`; the others, narrowed, and lower bounds."""
        if len(boxes) == 0:
            return boxes, np.empty(0)
        middle = boxes.middle
        at = self._unloaded.at(middle)
        value, slope = self._objective(at, via_point)
        boxes, along, keep = self._on_task(boxes, self._chain.goal_centre[via_point], slope)
        low, high = boxes.lower - middle, boxes.upper - middle
        reach = np.maximum(np.abs(low), np.abs(high))
        linear = np.minimum(slope * low, slope * high).sum(axis=1)
        off = self._gravity * self._second_order(reach, self._moment)
        lowest = value + np.maximum(linear, along) - self._heaviest * off
        keep &= lowest < enough
        robot = self._cell.robot
        torque, slopes = at.joint_torque, self._torque_slopes(at)
        if robot.pushed:
            pushed = self._cell.postures.tool_at(middle)
            torque, slopes = torque + pushed.torque_against_push, slopes + _push_slopes(pushed)
            # A second derivative of the force's lever, of its direction, and twice the product of the first.
            off = off + self._second_order(reach, np.full(robot.dof, 4 * self._push * robot.reach))
        spread = np.einsum("kij,kj->ki", np.abs(slopes), reach) + off[:, None]
        keep &= (np.abs(torque) - spread <= robot.limits.torque * (1 + _CONDITION_ROUNDING)).all(axis=1)
        boxes, lowest = boxes[keep], lowest[keep]
        clear = self._clear(boxes)
        return boxes[clear], lowest[clear]

    def _on_task(
        self, boxes: JointBoxes, goal: FloatArray, slope: FloatArray
    ) -> tuple[JointBoxes, FloatArray, BoolArray]:
        """Narrow boxes to the part that may hold the tool.

        To first order, postures on the task are ``base - tilt t``, with one inner joint's move t, and each
        angle within `width` of that. Also returns lower bounds (N,) of `slope` (N, n) times the moves from
        the middles, and which boxes may hold the tool.
        """
        chain, k, joints = self._chain, self._chain.inner, self._chain.joints
        half, slope = boxes.half[:, joints], slope[:, joints]
        steps = list(chain.walk(boxes.middle[:, joints]))
        axes = np.stack([axis for axis, _, _ in steps], axis=2)
        _, origin, R = steps[k - 1]
        p = origin + R @ (chain.centre - chain.origin[k - 1])
        J = np.stack([cross(axis, p - o) for axis, o, _ in steps[:k]], axis=2)
        off = self._second_order(half[:, :k], self._lever) + chain.slack + _CONDITION_ROUNDING
        error, turn, turn_off = self._turns_left(steps[-1][2], axes, half)
        keep = (np.abs(error) <= (np.abs(turn) * half[:, None]).sum(axis=2) + turn_off).all(axis=1)
        rows = np.arange(len(boxes))
        E, tilt, t = np.zeros((len(boxes), k, 3)), np.zeros((len(boxes), k)), np.zeros(len(boxes))
        if k == 3:
            E, sound = inverses(J)
        else:
            pivot, others, inverse, sound = without_pivot(J)
            E[rows[:, None], others] = inverse
            tilt = np.einsum("kij,kj->ki", E, J[rows, :, pivot])
            tilt[rows, pivot] = -1.0
            t = half[rows, pivot]
        base = np.einsum("kij,kj->ki", E, goal - p)
        F, wrist_sound = inverses(turn[:, :, k:])
        FT = F @ turn[:, :, :k]
        base = np.hstack([base, np.einsum("kij,kj->ki", F, error) - np.einsum("kij,kj->ki", FT, base)])
        tilt = np.hstack([tilt, -np.einsum("kij,kj->ki", FT, tilt)])
        E = np.concatenate([E, -FT @ E], axis=1)
        width = np.linalg.norm(E, axis=2) * off[:, None]
        width[:, k:] += np.einsum("kij,kj->ki", np.abs(F), turn_off)
        width[~sound] = np.inf
        width[~wrist_sound, k:] = np.inf
        if k > 3:
            width[rows, pivot] = 0.0
        first, last = common_moves(base, width + half, tilt, t)
        keep &= first <= last
        ends = np.stack([tilt * first[:, None], tilt * last[:, None]])
        low = np.maximum(base - width - ends.max(axis=0), -half)
        high = np.minimum(base + width - ends.min(axis=0), half)
        keep &= (low <= high).all(axis=1)
        rate = -(slope * tilt).sum(axis=1)
        along = (slope * base).sum(axis=1) + np.minimum(rate * first, rate * last)
        along -= np.linalg.norm(np.einsum("ki,kij->kj", slope, E), axis=1) * off
        along -= (np.abs(np.einsum("ki,kij->kj", slope[:, k:], F)) * turn_off).sum(axis=1)
        along[~(sound & wrist_sound & keep)] = -np.inf
        lower, upper, middle = boxes.lower.copy(), boxes.upper.copy(), boxes.middle
        lower[:, joints] = np.where(keep[:, None], middle[:, joints] + low, lower[:, joints])
        upper[:, joints] = np.where(keep[:, None], middle[:, joints] + high, upper[:, joints])
        return JointBoxes(lower, upper, boxes.side), along, keep

    def _turns_left(
        self, R: FloatArray, axes: FloatArray, half: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What is left to turn the last link, (N, 3), from rotations `R` (N, 3, 3), to first order.

        Also its derivatives (N, 3, n) by the joints, and bounds (N, 3) of what is of second order in boxes.
        """
        chain = self._chain
        off = np.repeat(0.5 * half.sum(axis=1, keepdims=True) ** 2 + _CONDITION_ROUNDING, 3, axis=1)
        if chain.free_axis is None:
            M = chain.goal_rotation @ R.transpose(0, 2, 1)
            error = 0.5 * np.stack(
                [M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]], axis=1
            )
            return error, axes, off
        # Two components across the free axis; the last joint takes what its own box allows.
        z, z_goal = R @ chain.free_axis, chain.goal_rotation @ chain.free_axis
        frame = R @ frame_about(chain.free_axis)[:, :2]
        error, turn = np.zeros((len(R), 3)), np.zeros((len(R), 3, axes.shape[2]))
        error[:, :2] = np.einsum("kji,kj->ki", frame, z_goal - z)
        turn[:, :2] = np.einsum(
            "kji,kjn->kin", frame, cross(axes.transpose(0, 2, 1), z[:, None]).transpose(0, 2, 1)
        )
        turn[:, :2, -1] = 0.0
        turn[:, 2, -1] = 1.0
        off[:, 2] = half[:, -1]
        return error, turn, off

    def _objective(self, at: PostureBatch, via_point: int) -> tuple[FloatArray, FloatArray]:
        """The objective (N,) at rest and its derivatives (N, n), the force on the tool as on the task."""
        goal = self._request.goals[via_point]
        push = goal.rotation[0] @ self._cell.robot.tool_force
        lever = goal.point[0] - np.array(self._cell.robot.foot_point)
        constant = np.concatenate([push, cross(lever, push)])
        value, gradient = self._function(at.guardrail_wrench + constant)
        # The torque's derivative is the moved first moment crossed with gravity.
        return value, np.einsum("kij,kj->ki", cross(self._moved(at), at.arm.gravity), gradient[:, 3:])

    @staticmethod
    def _moved(at: PostureBatch) -> FloatArray:
        """Derivatives (N, n, 3), kg m/rad, of the first moment of the masses by the joints."""
        return cross(at.axis, at.carried_moment.transpose(2, 0, 1))

    def _torque_slopes(self, at: PostureBatch) -> FloatArray:
        """Derivatives (N, n, n) of the static joint torques."""
        # By joints i <= j: gravity times axis i crossed with the moved moment of joint j.
        about = cross(self._moved(at), -at.arm.gravity)
        H = np.einsum("kia,kja->kij", at.axis, about)
        upper = np.triu(H)
        return np.asarray(upper + np.triu(H, 1).transpose(0, 2, 1))

    def _clear(self, boxes: JointBoxes) -> BoolArray:
        """Which boxes may hold a posture that keeps the safety margin."""
        clearances, margin = self._cell.clearances, self._cell.options.safety_margin_m
        reach = boxes.half @ clearances.reach
        clear = np.ones(len(boxes), dtype=np.bool_)
        # Wider ones are nearly always clear somewhere.
        check = np.flatnonzero(reach < _MAX_CLEARANCE_BOX_M)
        least = margin - _DISTANCE_ROUNDING - reach[check]
        clear[check] = clearances.query(boxes.middle[check], least).distance >= least
        return clear

    def _tried(
        self, boxes: JointBoxes, lowest: FloatArray, via_point: int, value: float
    ) -> tuple[FloatArray, float] | None:
        """An admissible posture below `value` near the middles of the boxes that allow most; None without."""
        request = self._request
        limits = request.cell.robot.limits
        chosen = np.argsort(lowest, kind="stable")[:_BOXES_TRIED]
        q = boxes.middle[chosen]
        q, reached = project_onto_task(request.cell.postures, request.task, q, request.goals[via_point])
        q = q[reached]
        at = request.cell.postures.at(q)
        found = request.cell.objective.at_rest(at)
        good = limits.contain(q) & (found < value) & request.cell.strong(at)
        for k in np.flatnonzero(good)[np.argsort(found[good], kind="stable")]:
            if request.cell.clear(q[k : k + 1])[0]:
                return q[k], float(found[k])
        return None

    def _halved(self, boxes: JointBoxes) -> JointBoxes:
        """Halve each box across the joint whose move would move most."""
        half = boxes.half
        following = _DEPENDENT_WIDTH_RATIO * half[:, self._inner[1:]].sum(axis=1)
        wide = half.copy()
        follow = [self._inner[0], *self._wrist]
        if self._chain.free_axis is not None:
            follow = follow[:-1]
        for joint in follow:
            wide[:, joint] = np.maximum(half[:, joint] - following, 0.0)
        return boxes.halved((wide * self._weight).argmax(axis=1))


def _push_slopes(at: ToolBatch) -> FloatArray:
    """Derivatives (N, n, n) of what turning joints bear of the force on the tool."""
    push, arm = at.push[:, None], at.tool_point[:, None] - at.origin
    # Joints up to a joint's own turn its axis, the lever and the force together: its share stays.
    lever = np.triu(np.einsum("kia,kja->kij", at.axis, cross(cross(at.axis, arm), push)), 1)
    turned = cross(at.axis, push)
    direction = np.einsum("kia,kja->kij", cross(at.axis, arm), turned)
    return np.asarray(-lever - np.triu(direction, 1))


def _weights(cell: Workcell) -> FloatArray:
    """How much the arm moves with each joint (n,), from 0 to 1."""
    reach, moment = cell.clearances.reach, _moment_bounds(cell)
    shares = [part / part.max() for part in (reach, moment) if part.max() > 0]
    return np.asarray(np.max(shares, axis=0))


def _moment_bounds(cell: Workcell) -> FloatArray:
    """Bounds (n,), kg m, of the first moments about each axis of all beyond it; they fall along the arm."""
    at = cell.postures.at(np.zeros((1, cell.robot.dof)))
    axis, origin, centre = at.axis[0], at.origin[0], at.centre[0]
    n = len(axis)
    bounds = np.zeros(n)
    for j in range(n):
        for body in range(j, n):
            points = np.vstack([origin[j : body + 1], centre[body]])
            steps = np.diff(points, axis=0)
            length = np.linalg.norm(cross(steps[0], axis[j]))
            length += np.linalg.norm(steps[1:], axis=1).sum()
            bounds[j] += at.arm.mass[body] * length
    return np.asarray(np.maximum.accumulate(bounds[::-1])[::-1])
