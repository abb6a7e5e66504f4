"""What of the tool's pose is prescribed: all of it, point and axis, point and a cone, or the point alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, cross
from cmbot.common.errors import InputError
from cmbot.common.representation import ShortRepr
from cmbot.robot import Kinematics, Robot
from cmbot.scene import Keep
from cmbot.toolpath import ToolPath, ToolPoses, shortest_turns

# Sine of an angle below which a rotation vector is zero, and the cosine below which a turn counts as nearly
# half a one.
_ZERO_ANGLE_SINE, _NEARLY_HALF_A_TURN = 1e-300, -0.9


@dataclass(frozen=True, eq=False)
class ToolTask(ShortRepr):
    """The part of a tool path that the arm has to follow, as m task coordinates.

    The first three are the tool point in W, m; then, for ``pose``, a rotation vector in W; for ``axis``, the
    two components of that vector along the tool's own x and y axes, rad.

    Attributes
    ----------
    path : ToolPath
    keep : str
        ``pose`` (m = 6), ``axis`` (m = 5) or ``position`` (m = 3).
    max_speed : float or None
        Of the tool point, m/s: `SPEED_TOLERANCE` above the scene's. None: any.
    cone : float or None
        With ``position``: largest angle between the tool's axis and that of the path, rad. It is no task
        coordinate but an inequality. None: any.
    speed_tolerance : float or None
        By what share the tool's speed may miss that of the path's process parts. None: any.
    max_base_torque : float or None
        Largest torque on the base, Nm. None: any.
    max_sway : float or None
        Largest sway of the tool at work, and largest swing after it, m. None: any.
    lean : (3, 3) or None
        With ``axis``: rotation in the tool's frame by which the axis leans from that of the path all along.
    """

    path: ToolPath
    keep: Literal["pose", "axis", "position"] = "pose"
    max_speed: float | None = None
    cone: float | None = None
    lean: FloatArray | None = None
    speed_tolerance: float | None = None
    max_base_torque: float | None = None
    max_sway: float | None = None

    def __post_init__(self) -> None:
        if self.keep not in ("pose", "axis", "position"):
            raise InputError("ToolTask", "keep", self.keep, "a kind", ("pose", "axis", "position"))
        if self.cone is not None and self.keep != "position":
            raise InputError("ToolTask", "cone", self.cone, "None, or keep: position")

    @staticmethod
    def of(
        path: ToolPath, keep: Keep, max_speed: float | None = None, speed_tolerance: float | None = None
    ) -> ToolTask:
        """Return the task of what a scene keeps of the tool along a path."""
        if isinstance(keep, str):
            return ToolTask(path, keep, max_speed, speed_tolerance=speed_tolerance)
        return ToolTask(path, "position", max_speed, keep.angle, speed_tolerance=speed_tolerance)

    def jacobian(self, R_WT: FloatArray, J: FloatArray) -> FloatArray:
        """Task rows (..., m, n) of tool Jacobians `J` (..., 6, n) at orientations `R_WT` (..., 3, 3)."""
        if self.keep == "pose":
            return J
        if self.keep == "position":
            return J[..., :3, :]
        turns = np.swapaxes(R_WT[..., :2], -1, -2) @ J[..., 3:, :]
        return np.concatenate([J[..., :3, :], turns], axis=-2)

    def smallest_singular_value(self, robot: Robot, q: FloatArray) -> float:
        """Return that of the task Jacobian in posture `q` (n,): Chang 2021, Eq. (19)."""
        X_WT, J = Kinematics(robot).tool_jacobian(q)
        # By coordinates that have one unit.
        J = robot.metric.positions(J)
        return float(np.linalg.svd(self.jacobian(X_WT.rotation, J), compute_uv=False)[-1])

    def error(self, X_WT: Any, goal: ToolPoses) -> FloatArray:
        """Task coordinates (m,) from `X_WT` to a goal, one pose."""
        if self.keep != "pose":
            return np.asarray(self.errors(X_WT.translation[None], X_WT.rotation[None], goal)[0])
        # In a quarter of the time of a batch of one.
        turn = pin.log3(goal.rotation[0] @ X_WT.rotation.T)
        return np.concatenate([goal.point[0] - X_WT.translation, turn])

    def errors(self, p_WT: FloatArray, R_WT: FloatArray, goals: ToolPoses) -> FloatArray:
        """Task coordinates (N, m) from N tool poses to the goals, one each or one for all."""
        translation = goals.point - p_WT
        if self.keep == "position":
            return translation
        if self.keep == "pose":
            return np.concatenate([translation.T, _rotation_vectors(R_WT, goals.rotation)]).T
        turns = shortest_turns(R_WT[:, :, 2], goals.rotation[:, :, 2])
        return np.concatenate([translation, np.einsum("kij,ki->kj", R_WT[:, :, :2], turns)], axis=1)

    def held_at_start(self) -> ToolTask:
        """Return the task of holding the tool where this one starts."""
        free = replace(self, max_speed=None, speed_tolerance=None, max_base_torque=None)
        return replace(free, path=self.path.held())

    @property
    def on_axis(self) -> ToolTask:
        """The task of holding the axis in the middle of its cone; without a cone this one."""
        return self if self.cone is None else replace(self, keep="axis", cone=None)

    def leaning(self, lean: FloatArray) -> ToolTask:
        """Return the task of holding the axis where `lean` (3, 3) takes it from that of the path."""
        return replace(self.on_axis, lean=lean)

    def goals(self, times: ArrayLike) -> ToolPoses:
        """Return the poses of the tool to hold at `times` (N,)."""
        poses = self.path.poses(times)
        return poses if self.lean is None else replace(poses, rotation=poses.rotation @ self.lean)

    @property
    def kept(self) -> str:
        """What is prescribed of the tool, in words."""
        return self.keep if self.cone is None else f"axis within {np.degrees(self.cone):g} deg"

    @property
    def dimension(self) -> int:
        """Number m of task coordinates."""
        return task_dimension(self.keep)

    def rotation(self, R_WT: FloatArray, goals: ToolPoses) -> FloatArray:
        """Angles (N,), rad, by which orientations `R_WT` (N, 3, 3) miss what is prescribed.

        Where a cone is, that between the axes.
        """
        R_goal = goals.rotation
        if self.keep == "position" and self.cone is None:
            return np.zeros(len(R_WT))
        if self.keep != "pose":
            z, z_goal = R_WT[:, :, 2], R_goal[:, :, 2]
            sine = np.linalg.norm(cross(z, z_goal), axis=1)
            return np.asarray(np.arctan2(sine, (z * z_goal).sum(axis=1)))
        # |R_goal - R| = 2 sqrt(2) sin(angle/2), exact for small angles where the trace is not.
        chord = np.linalg.norm(R_WT - R_goal, axis=(1, 2)) / (2 * np.sqrt(2))
        return np.asarray(2 * np.arcsin(np.minimum(chord, 1.0)))


def task_dimension(keep: Keep) -> int:
    """Return the number m of task coordinates."""
    return {"pose": 6, "axis": 5, "position": 3}[keep] if isinstance(keep, str) else 3


def _rotation_vectors(R_WT: FloatArray, R_goal: FloatArray) -> FloatArray:
    """Rotation vectors (3, N) of the turns from orientations (N, 3, 3) to others, (N, 3, 3) or (1, 3, 3)."""
    sine, cosine = _sine_and_cosine(R_WT, R_goal)
    size = np.sqrt((sine * sine).sum(axis=0))
    # What follows is exact but for half turns, whose axis it does not see; SciPy's own costs ten times
    # more.
    vectors = sine * (np.arctan2(size, cosine) / np.maximum(size, _ZERO_ANGLE_SINE))
    vectors[:, size <= _ZERO_ANGLE_SINE] = 0.0
    far = np.flatnonzero(cosine < _NEARLY_HALF_A_TURN)
    if len(far):
        goal = R_goal if len(R_goal) == 1 else R_goal[far]
        vectors[:, far] = Rotation.from_matrix(goal @ R_WT[far].transpose(0, 2, 1)).as_rotvec().T
    return np.asarray(vectors)


def _sine_and_cosine(R_WT: FloatArray, R_goal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Of the turns from orientations to others: their axes times their sines, (3, N), and cosines (N,).

    Half the sum of the cross products, and of the scalar products less one, of both orientations' axes.
    """
    if len(R_goal) != 1:
        turned = np.einsum("kij,klj->ilk", R_goal, R_WT)
        sine = 0.5 * np.stack(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        return sine, 0.5 * (turned[0, 0] + turned[1, 1] + turned[2, 2] - 1.0)
    goal = R_goal[0].T
    # One product with a matrix is quickest.
    products = 0.5 * np.vstack([np.hstack([-pin.skew(axis) for axis in goal]), goal.reshape(1, 9)])
    parts = products @ R_WT.transpose(2, 1, 0).reshape(9, -1)
    return parts[:3], parts[3] - 0.5
