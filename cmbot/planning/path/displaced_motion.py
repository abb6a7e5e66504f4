"""An earlier motion along a path that has moved since."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import Motion, StrokeRequest
from cmbot.scene import Keep
from cmbot.toolpath import ToolPoses
from cmbot.trajectory import QuinticTrajectory, SplineSpace

# Shares of the times between via-points at which it is put onto the path.
_AT_SHARES = np.array([0.25, 0.5, 0.75])
# What is kept of what the tool missed the path by: splines follow the displacement nearly, not quite.
_MISS_KEPT = 0.95
# Distance, m, of the points on the tool's axes that say how these have turned; and of those that do not turn,
# so that a straight path whose tool has no axis turns as little as it can.
_ON_AXIS_M, _UNTURNED_M = 0.1, 1e-3


def displaced(request: StrokeRequest, earlier: Motion, placed: FloatArray) -> QuinticTrajectory:
    """Return an earlier motion along a stroke, displaced to its path as it is now.

    It leads through the postures `placed` at the via-points. In between the tool misses the path by nearly
    what it missed the earlier one by, turned with the path, as far as splines with these knots can: an
    optimised motion uses what it may miss the path by.

    Parameters
    ----------
    request : StrokeRequest
    earlier : Motion
        With as many knots at the same shares of its time.
    placed : (n, d), rad, of joints that slide m
    """
    space, before = SplineSpace(request.times), earlier.trajectory
    rate = before.duration / request.times[-1]
    knots = np.stack([rate**k * before.evaluate(space.t * rate, k) for k in range(3)], axis=1)
    between = space.t[:-1, None] + np.diff(space.t)[:, None] * _AT_SHARES
    t = np.concatenate([space.t, between.ravel()])
    q, n, postures = before.evaluate(t * rate), len(space.t), request.cell.postures
    tool, then, now = postures.tool_at(q), earlier.task.goals(t * rate), request.task.goals(t)
    turn = _turn(then, now, request.task.keep)
    point = now.point + _MISS_KEPT * turn.apply(tool.tool_point - then.point)
    goals = ToolPoses(point=point, rotation=turn.as_matrix() @ tool.tool_rotation)
    differ = project_onto_task(postures, request.task, q, goals)[0] - q
    rows = space.design(between.ravel(), 0)
    A = sparse.csc_array(rows @ space.basis)
    missing = differ[n:] - rows @ space.least_jerk(differ[:n])
    coefficients = splu(sparse.csc_array(A.T @ A)).solve(A.T @ missing)
    z = space.least_jerk(placed - knots[:, 0]) + space.basis @ coefficients
    return space.trajectory(z + knots.reshape(-1, knots.shape[-1]))


def _turn(then: ToolPoses, now: ToolPoses, keep: Keep) -> Rotation:
    """How a path has turned, by the poses of the tool then and now, (N,); as little as these allow."""
    axes = {"pose": 3, "axis": 1, "position": 0}[str(keep)]
    turned, before = (
        np.vstack(
            [
                poses.point - poses.point.mean(axis=0),
                *(_ON_AXIS_M * poses.rotation[..., 3 - k] for k in range(1, axes + 1)),
                _UNTURNED_M * np.eye(3),
            ]
        )
        for poses in (now, then)
    )
    return Rotation.align_vectors(turned, before)[0]
