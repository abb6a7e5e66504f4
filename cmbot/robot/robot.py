"""The robot: a working arm, all other joints locked, placed in the world frame of the bridge."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import counted
from cmbot.common.representation import card
from cmbot.hold import Foot, Holding
from cmbot.robot.arm_model import attach_payload
from cmbot.robot.description.completion import Lift
from cmbot.robot.elasticity import JointElasticity, LinkTube
from cmbot.robot.holding_joints import HoldingJoint, holding_rows, leg_compliance
from cmbot.robot.joint_kinds import Coupling, PostureMetric, prismatic_joints, slide_axes
from cmbot.robot.limits import JointLimits

# Least length, m, by which moves of joints that slide are measured.
_MIN_PRISMATIC_SCALE_M = 0.1
_SAME_PLACE_M = 1e-3
"""Points that are no further apart are one and the same, m."""
_ZERO_FORCE = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Robot:
    """An arm on its base, ready for planning. Its pinocchio models must not be changed.

    World frame W: fixed to the bridge; x along the guardrail, y outward, z up. O0 is where foot 1 holds.

    Attributes
    ----------
    name : str
        From the URDF.
    urdf : pathlib.Path
        The file it was read from.
    description : str
        The content of that file with what was added to it, masses or a tool; empty where nothing was.
    model : pinocchio.Model
        The arm with all its m joints, also those that follow others: it takes ``coupling.positions(q)``.
        Fixed base, universe = W. ``model.inertias[0]`` is that of everything that does not move, but
        for what stands on the floor.
    coupling : Coupling
        How the m joints follow the n of a posture; m is n where none follows another.
    collision_model : pinocchio.GeometryModel
        Collision shapes and the pairs of them that may collide.
    read_visual_model : callable
        Reads what `visual_model` is; no plan needs it.
    limits : JointLimits
        Of the n joints of a posture: those that move by themselves.
    group_states : mapping of str to (n,) array
        Postures by the names that the SRDF gives them, such as ``stow``: where the arm is put away.
    elasticity : mapping of str to LinkTube
        By link, base to tool: those of the arm that bend; in `model` they are rigid. Empty: all are.
    joint_elasticity : mapping of str to JointElasticity
        By joint, base to tool: those that give way in series with their drives. Empty: all are rigid.
    base_frame, tool_frame : str
        Names of the arm's first and last frame; the tool point is the origin of `tool_frame`, the tool's
        axis its z axis.
    flange : str
        The link to which a tool was fixed; without one `tool_frame`.
    payload : float
        Point mass at the tool, kg.
    tool_force : three floats
        Force that acts on the tool while it is on, at the tool point, along the tool's axes, N. It is part of
        every torque of this robot; see `tool_off`.
    tool_ramp : float
        Time in which that force sets in before a stroke, and ends after it, s; 0: at once, or there is none.
    content_hash : str
        SHA-256 of URDF, SRDF, joint-limits and elasticity file.
    fixed_tool : pinocchio.SE3 or None
        Pose X_WT of a tool that stands in W, while the arm holds the part that it works on. Then tool point,
        axis and Jacobian are this tool's, in the frame of the part, `tool_frame`: see `tool_seen`.
    foot_point : three floats, m
        O0 in W: where foot 1 holds. The wrench on the guardrail is about it.
    feet : tuple of Foot
        How it holds the guardrail; empty where it stands on something else.
    locked_joints : tuple of HoldingJoint
        Those between its root, which holds, and the arm's base, and those from there to a second foot.
    unplaced : tuple of str
        Sliding joints before the arm, such as a lift, of which nothing says where they are: at zero.
    loads_beside : mapping of str to float
        Masses, kg, by link, of what neither moves nor is on the arm's base, such as a lift's foot, where
        nothing says from which link on what bends carries the robot.
    lift : Lift or None
        The last joint before the arm, which is locked; None where its base stands still in any case.
    damping_ratio : float
        Of every mode, where nothing else is asked for: 0.01 (arms of aluminium tubes have 0.5 to 2 %), or as
        identified.
    remarks : tuple of str
        What the files do not say and had to be assumed, a sentence each.
    """

    name: str
    urdf: Path
    description: str
    model: Any
    coupling: Coupling
    collision_model: Any
    read_visual_model: Callable[[], Any]
    limits: JointLimits
    group_states: Mapping[str, FloatArray]
    elasticity: Mapping[str, LinkTube]
    joint_elasticity: Mapping[str, JointElasticity]
    base_frame: str
    tool_frame: str
    flange: str
    payload: float
    content_hash: str
    tool_force: tuple[float, float, float] = _ZERO_FORCE
    tool_ramp: float = 0.0
    fixed_tool: Any = None
    foot_point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    feet: tuple[Foot, ...] = ()
    locked_joints: tuple[HoldingJoint, ...] = ()
    unplaced: tuple[str, ...] = ()
    loads_beside: Mapping[str, float] = field(default_factory=dict)
    lift: Lift | None = None
    damping_ratio: float = 0.01
    remarks: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return (
            f"<Robot {self.name}: {self.dof} joints, {self.arm_mass:.2f} kg moving, payload "
            f"{self.payload:g} kg, tool {self.tool_frame}>"
        )

    def _repr_html_(self) -> str:
        """Card in a notebook."""
        limits, rows = self.limits, []
        for i, joint in enumerate(self.joints):
            units = limits.units(i, shown=True)
            bounds = zip(
                (limits.velocity, limits.acceleration), (units.velocity, units.acceleration), strict=True
            )
            rates = (f"{units.factor * bound[i]:.4g} {unit}" for bound, unit in bounds)
            torque = f"{limits.torque[i]:.4g} {units.torque}"
            rows.append((joint, limits.range_in_words(i), *rates, torque))
        return card(
            f"Robot {self.name}",
            f"{self.dof} joints, {self.arm_mass:.2f} kg moving, payload {self.payload:g} kg, "
            f"from {self.base_frame} to {self.tool_frame}",
            rows,
            ("joint", "range", "velocity", "acceleration", "effort"),
        )

    @cached_property
    def floating_model(self) -> Any:
        """The same arm below a massless free-flyer at O0, with the axes of W, a `pinocchio.Model`.

        Held still, the first six rows of its inverse dynamics are the wrench that the base exerts on the arm,
        and their derivatives are exact.
        """
        name = "guardrail"
        while self.model.existFrame(name):
            name += "_"
        floating = pin.Model()
        X_WO = pin.SE3(np.eye(3), np.array(self.foot_point))
        root = floating.addJoint(0, pin.JointModelFreeFlyer(), X_WO, name)
        floating.addJointFrame(root)
        floating = pin.appendModel(floating, self.model, floating.getFrameId(name), X_WO.inverse())
        floating.inertias[root] = pin.Inertia.Zero()
        floating.gravity = self.model.gravity
        return floating

    @cached_property
    def visual_model(self) -> Any:
        """Visual shapes, a `pinocchio.GeometryModel`; their meshes are read when it is first used.

        Raises
        ------
        ModelError
            When a mesh cannot be read.
        """
        return self.read_visual_model()

    @cached_property
    def tool_off(self) -> Robot:
        """The same robot with its tool off: no force acts on it."""
        return replace(self, tool_force=_ZERO_FORCE, tool_ramp=0.0) if self.pushed else self

    def force_share(self, t: FloatArray) -> FloatArray:
        """Return the share of the tool's force `t` (N,) s after it began to set in: of class C2."""
        x = np.clip(t / self.tool_ramp, 0.0, 1.0) if self.tool_ramp else np.heaviside(t, 1.0)
        return np.asarray(x**3 * (10 - 15 * x + 6 * x**2))

    def loaded(self, mass: float) -> Robot:
        """Return the same robot with a point mass, kg, more at its tool point."""
        model = self.model.copy()
        attach_payload(model, self.tool_frame, mass)
        return replace(self, model=model, payload=self.payload + mass)

    @property
    def with_rigid_joints(self) -> Robot:
        """The same robot with joints that do not give way."""
        locked = tuple(replace(joint, spring=None) for joint in self.locked_joints)
        return replace(self, joint_elasticity={}, locked_joints=locked)

    @property
    def pushed(self) -> bool:
        """Whether a force acts on its tool."""
        return any(self.tool_force)

    @property
    def pushed_at_once(self) -> bool:
        """Whether that force sets in at once."""
        return self.pushed and not self.tool_ramp

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints of a posture, base to tool: those that follow others are left out."""
        return tuple(self.model.names[i + 1] for i in self.coupling.own.tolist())

    @property
    def dof(self) -> int:
        """Number n of the joints of a posture."""
        return len(self.coupling.own)

    @property
    def tool_frame_id(self) -> int:
        """Index of the tool frame in `model`."""
        return int(self.model.getFrameId(self.tool_frame))

    def tool_seen(self, X_WE: Any, J: FloatArray) -> tuple[Any, FloatArray]:
        """Return pose and Jacobian (6, m) of the tool in W, or of a fixed tool in the part's frame.

        `X_WE`, a `pinocchio.SE3`, and `J` (6, m) are those of `tool_frame` in W. Seen from a part that moves
        by v and turns by w, a fixed tool at r from its origin moves by ``-(v + w x r)`` and turns by ``-w``.
        """
        if self.fixed_tool is None:
            return X_WE, J
        R, r = X_WE.rotation.T, self.fixed_tool.translation - X_WE.translation
        moved, turned = R @ (J[:3] - pin.skew(r) @ J[3:]), R @ J[3:]
        return X_WE.actInv(self.fixed_tool), -np.concatenate([moved, turned])

    @property
    def base_point(self) -> FloatArray:
        """Origin (3,) of the arm's first joint in W, m."""
        return np.array(self.model.jointPlacements[1].translation)

    @property
    def reach(self) -> float:
        """Upper bound of the tool point's distance from `base_point`, m.

        The sum of the links' lengths, where joints slide with these drawn out as far as they go.
        """
        return float(self._link_lengths[1].sum())

    @property
    def inner_reach(self) -> float:
        """Lower bound of that distance, m: the longest link less all others, or zero."""
        least, most = self._link_lengths
        return max(0.0, float((least + most).max() - most.sum()))

    def least_seconds(self, length: float) -> float:
        """Return a time in which no motion from rest to rest moves the tool point by a length, m, in s.

        Each joint moves it no further than the joint's own way times the longest distance at which that
        carries the tool; and in a time T no further than by v T, a T^2 / 4 and j T^3 / 32.
        """
        slides, limits = prismatic_joints(self.model), self.limits
        each = self.coupling.summed(np.where(slides, 1.0, self.levers))

        def beyond(T: float) -> float:
            ways = limits.velocity * T, limits.acceleration * T**2 / 4, limits.jerk * T**3 / 32
            return float(each @ np.min(ways, axis=0)) - length

        most = 1.0
        while beyond(most) < 0:
            most *= 2.0
        return float(brentq(beyond, 0.0, most))

    @property
    def levers(self) -> FloatArray:
        """Longest distances (m,), m, of the tool point from all joints, as far as the links may lead."""
        longest = self._link_lengths[1]
        if self.fixed_tool is None:
            return np.asarray(np.cumsum(longest[:0:-1])[::-1])
        return np.linalg.norm(self.fixed_tool.translation - self.base_point) + np.cumsum(longest[:-1])

    @property
    def _link_lengths(self) -> tuple[FloatArray, FloatArray]:
        """Least and largest distances (m + 1,), m, from each joint to the next; see `_steps`."""
        slides, steps = slide_axes(self.model), self._steps()
        ends = self.coupling.ranges(self.limits.lower, self.limits.upper)
        lower, upper = (np.where(prismatic_joints(self.model), end, 0.0) for end in ends)
        nearest = np.clip(-np.einsum("ij,ij->i", steps[:-1], slides), lower, upper)
        each = [
            np.linalg.norm(steps + np.vstack([way[:, None] * slides, np.zeros(3)]), axis=1)
            for way in (lower, upper, nearest)
        ]
        return each[2], np.maximum(each[0], each[1])

    @cached_property
    def metric(self) -> PostureMetric:
        """How far postures are apart, where joints slide in units of the links' lengths."""
        length = float(np.linalg.norm(self._steps(), axis=1).sum())
        return PostureMetric(prismatic=self.limits.prismatic, length=max(length, _MIN_PRISMATIC_SCALE_M))

    def _steps(self) -> FloatArray:
        """From each joint of the arm, at zero, to the next (m + 1, 3), m: first nothing, last to the tool."""
        steps = [placement.translation for placement in list(self.model.jointPlacements)[2:]]
        return np.array([np.zeros(3), *steps, self.model.frames[self.tool_frame_id].placement.translation])

    @property
    def base_pose(self) -> Any:
        """Pose X_WB of the base frame in W, a `pinocchio.SE3`."""
        return self.model.frames[self.model.getFrameId(self.base_frame)].placement

    @property
    def base_place(self) -> str:
        """Where the base frame is in W, in words; empty: nearer to its origin than 1 mm."""
        at = self.base_pose.translation
        return f"({', '.join(f'{x:.4g}' for x in at + 0.0)}) m" if np.linalg.norm(at) > _SAME_PLACE_M else ""

    @property
    def arm_mass(self) -> float:
        """Mass that the joints move, payload included, kg."""
        return float(sum(inertia.mass for inertia in self.model.inertias[1:]))

    @property
    def carrier_mass(self) -> float:
        """Mass that neither moves nor stands on the floor, kg: its load on the guardrail is constant."""
        return float(self.model.inertias[0].mass)

    @property
    def mass(self) -> float:
        """Mass of the whole robot, kg."""
        return self.arm_mass + self.carrier_mass

    @property
    def carrier_torque(self) -> FloatArray:
        """Constant torque (3,) about O0 on the guardrail by the weight of `carrier_mass`, Nm."""
        inertia = self.model.inertias[0]
        lever = inertia.lever - np.array(self.foot_point)
        return np.cross(lever, inertia.mass * self.model.gravity.linear)

    @property
    def holding_joints(self) -> tuple[HoldingJoint, ...]:
        """The locked joints between the arm's base and where it holds: a second foot may be free."""
        return tuple(joint for joint in self.locked_joints if joint.foot < max(len(self.feet), 1))

    @cached_property
    def holding_rows(self) -> tuple[FloatArray, FloatArray]:
        """Rows (k, 6) and constants (k,), Nm, that make torques of `holding_joints` of the arm's wrench."""
        foot, gravity = np.array(self.foot_point), np.array(self.model.gravity.linear)
        shares = [each.share for each in self.feet] or [np.eye(6)]
        return holding_rows(self.holding_joints, shares, foot, gravity, self._carrier_wrench)

    def holding_torque(self, wrench: FloatArray) -> FloatArray:
        """Return the torques (N, k), Nm, of `holding_joints`.

        Parameters
        ----------
        wrench : (N, 6), N and Nm
            Of the moving arm on the guardrail, about O0 in W.
        """
        rows, constant = self.holding_rows
        return np.asarray(wrench @ rows.T + constant)

    def holding_use(self, wrench: FloatArray) -> FloatArray:
        """Return the shares (N, k) of what `holding_joints` hold; `wrench` as of `holding_torque`."""
        return np.asarray(np.abs(self.holding_torque(wrench)) / self.holding_limits)

    @property
    def leg_compliance(self) -> FloatArray | None:
        """Compliance (k, 6, 6) about O0 of `holding_joints`, for each foot; None: they are rigid."""
        return leg_compliance(self.holding_joints, max(len(self.feet), 1), np.array(self.foot_point))

    @cached_property
    def holding_limits(self) -> FloatArray:
        """What `holding_joints` hold, (k,), Nm; infinite where nothing says it."""
        return np.array([joint.limit for joint in self.holding_joints])

    @property
    def _carrier_wrench(self) -> FloatArray:
        """Wrench (6,) of `carrier_mass` on the guardrail, about O0."""
        return np.hstack([self.carrier_mass * self.model.gravity.linear, self.carrier_torque])

    @cached_property
    def holding(self) -> Holding | None:
        """What its feet bear; None without a foot that has a flat contact or bounds."""
        if not any(foot.contact is not None or foot.bounded for foot in self.feet):
            return None
        return Holding(self.feet, self._carrier_wrench)

    def posture(
        self,
        q: ArrayLike,
        *,
        source: str = "Robot.posture",
        key: str = "q",
        error_type: type[InputError] = InputError,
    ) -> FloatArray:
        """Check one posture: n finite numbers within the joint ranges.

        Parameters
        ----------
        q : (n,), rad, of joints that slide m
        source, key, error_type
            Named in the error, and its type.

        Raises
        ------
        InputError
            When it has another length, is not finite or leaves a joint's range.
        """
        q = np.asarray(q, dtype=float)
        if q.shape != (self.dof,) or not np.isfinite(q).all():
            slides = bool(self.limits.prismatic.any())
            got = q.tolist() if slides else np.rad2deg(q).tolist()
            if q.ndim == 1 and q.size != self.dof:
                got = counted(q.size, "number")
            what = "finite joint position" if slides else "finite joint angle"
            raise error_type(source, key, got, counted(self.dof, what))
        outside = np.flatnonzero((q < self.limits.lower) | (q > self.limits.upper))
        if len(outside):
            i = int(outside[0])
            unit = self.limits.units(i, shown=True)
            raise error_type(
                source,
                f"{key}[{i}]",
                f"{unit.factor * q[i]:g} {unit.position}",
                f"{self.joints[i]} within its range {self.limits.range_in_words(i)}",
            )
        return q
