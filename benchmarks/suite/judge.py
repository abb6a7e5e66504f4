"""Planning one scene, and judging what comes out by the oracle's own kinematics, dynamics and distances."""

from __future__ import annotations

import re
import resource
import time
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import BPoly

from cmbot import plan
from cmbot.common.errors import InputError, LimitViolation, OptimisationFailed, PathNotFound, PlanningError
from cmbot.planning import Plan
from suite.oracle import Oracle
from suite.task import TimedPath, read_scene
from suite.world import FloatArray, World, limits_in

__all__ = ["CPU_LIMIT", "plan_scene", "violations"]

CPU_LIMIT = 60
"""Processor time after which planning a scene counts as too slow, s."""


_KINDS = {PathNotFound: "no path", OptimisationFailed: "not optimised", LimitViolation: "limit violated"}
_SAMPLES, _DISTANCES = 2000, 1000
# Rounding of the checks: shares of bounds, m, rad.
_SHARE, _LENGTH, _ANGLE = 1e-6, 1e-6, 1e-6
# A lower bound is false when it exceeds what was found by more than this share, beside its own error.
_BOUND = 1e-4
_TRIES = 300
# What an error may claim: that no posture within the joint ranges holds the tool at a point, and that the
# scene's posture is no start. Of the rest, such as "no way was found", it says how much was tried.
_OUT_OF_REACH = re.compile(r"out of reach: |with its tool stretched out")
_NO_START = re.compile(r"is blocked: (in )?the posture to start in ")


def plan_scene(folder: str) -> dict[str, Any]:
    """Plan a scene and judge the plan, or the reason why there is none."""
    scene, world, path, R = read_scene(folder)
    oracle = Oracle(world, path, R, scene.strokes[0].keep)
    begin = time.process_time()
    # Of processor time, so that a busy machine makes no plan slow; the signal SIGXCPU ends the process.
    resource.setrlimit(resource.RLIMIT_CPU, (int(begin) + CPU_LIMIT, resource.RLIM_INFINITY))
    try:
        made = plan(scene)
    except InputError as error:
        _unlimited()
        return {"status": "refused", "reason": str(error)}
    except PlanningError as error:
        seconds = time.process_time() - begin
        _unlimited()
        return {
            "status": _KINDS.get(type(error), type(error).__name__),
            "cpu_seconds": seconds,
            "reason": str(error),
            "at": getattr(error, "time", None),
            "false_claim": _false_claim(oracle, error, np.array(scene.posture)),
        }
    seconds = time.process_time() - begin
    _unlimited()
    return {
        "status": "planned",
        "cpu_seconds": seconds,
        "stages": {name: getattr(made.seconds, name) for name in ("path", "optimise", "certify", "total")},
        "fallbacks": list(made.fallbacks),
        "moved": made.start.moved,
        "peak": made.figures.peak_guardrail_torque,
        "floor": made.torque_floor,
        "floor_error": None if made.lower_bound is None else made.lower_bound.error,
        "gap": made.gap_to_floor,
        "violations": violations(made, world, path, R),
        "false_bound": _false_bound(made, oracle),
    }


def _unlimited() -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))


def violations(made: Any, world: World, path: TimedPath | None, R: FloatArray) -> list[str]:
    """What a plan breaks at dense samples of its quintics, a sentence each.

    `made` is a plan, or has its trajectory, figures, options, robot and scene for a segment; `path` is None
    where the tool is free.
    """
    knots, found = made.trajectory, list[str]()
    motion = BPoly.from_derivatives(knots.t, np.stack([knots.q, knots.v, knots.a], axis=1))
    times = np.linspace(knots.t[0], knots.t[-1], _SAMPLES)
    q, v, a, j = (motion(times, order) for order in range(4))

    def check(name: str, share: FloatArray) -> None:
        if not share.max() <= 1.0 + _SHARE:
            k, joint = np.unravel_index(share.argmax(), share.shape)
            found.append(
                f"{name} of {world.joints[joint]}: {share.max():.6f} of its bound at {times[k]:.3f} s"
            )

    acceleration, jerk = _rates(made, world)
    check("velocity", np.abs(v) / world.velocity)
    check("acceleration", np.abs(a) / acceleration)
    check("jerk", np.abs(j) / jerk)
    tau, torque = np.empty_like(q), np.empty(len(q))
    for k in range(len(q)):
        tau[k] = pin.rnea(world.model, world.data, q[k], v[k], a[k])
        # The pass leaves the joints' poses relative to each other; the first is relative to W.
        torque[k] = np.linalg.norm(world.data.liMi[1].act(world.data.f[1]).angular)
    check("torque", np.abs(tau) / world.torque)
    if outside := [k for k in range(len(q)) if not world.in_range(q[k])]:
        found.append(f"a joint leaves its range at {times[outside[0]]:.3f} s")
    if torque.max() > made.figures.peak_guardrail_torque * (1 + _SHARE):
        found.append(f"the torque on the base reaches {torque.max():.4f} Nm, stated is less")
    chosen = np.linspace(0, len(q) - 1, _DISTANCES).astype(int)
    distance = np.array([world.distance(q[k]) for k in chosen])
    if distance.min() < world.margin - _LENGTH:
        k = chosen[distance.argmin()]
        found.append(f"clearance {distance.min():.5f} m at {times[k]:.3f} s, the margin is {world.margin} m")
    if path is not None:
        found += _tool_violations(made, world, path, R, times, q)
    return found


def _tool_violations(
    made: Any, world: World, path: TimedPath, R: FloatArray, times: FloatArray, q: FloatArray
) -> list[str]:
    """Deviation from the legs and turn of the tool beyond what the options allow."""
    options, found, keep = made.options, list[str](), made.scene.strokes[0].keep
    away, lag, turned = np.empty(len(q)), np.empty(len(q)), np.zeros(len(q))
    for k in range(len(q)):
        p, R_k = world.pose(q[k])
        away[k] = path.leg_distance(times[k], p)
        lag[k] = np.linalg.norm(p - path.point(times[k]))
        if keep == "pose":
            turned[k] = np.linalg.norm(pin.log3(R.T @ R_k))
        elif keep == "axis":
            turned[k] = np.arctan2(np.linalg.norm(np.cross(R[:, 2], R_k[:, 2])), R[:, 2] @ R_k[:, 2])
    allowed = float(np.hypot(options.max_tool_lag_m, options.max_tool_deviation_m))
    for name, value, bound, unit in (
        ("deviation", away, options.max_tool_deviation_m + _LENGTH, "m"),
        ("distance from its timed place", lag, allowed + _LENGTH, "m"),
        ("turn", turned, np.radians(options.max_tool_rotation_deg) + _ANGLE, "rad"),
    ):
        if not value.max() <= bound:
            k = int(value.argmax())
            found.append(f"{name} of the tool is {value[k]:.6f} {unit} at {times[k]:.3f} s")
    return found


def _rates(made: Any, world: World) -> tuple[FloatArray, FloatArray]:
    limits = made.scene.robot.limits or made.robot.urdf.with_name("joint_limits.yaml")
    return limits_in(limits, world.joints)


def _false_bound(made: Plan, oracle: Oracle) -> str:
    """Why the stated lower bound is none; empty where nothing speaks against it."""
    bound = made.lower_bound
    if bound is None or made.torque_floor is None:
        return ""
    # The via-points' times are the knots' where every via-point is one.
    t = float(made.task.path.via_times(made.scene.strokes[0].via_points)[bound.via_point])
    seed = made.trajectory.evaluate([t])[0]
    least, q = oracle.least_gravity_torque(oracle.path.point(t), [seed])
    if bound.value - bound.error <= least * (1 + _BOUND):
        return ""
    claimed = f"{bound.value:.4f} Nm less {bound.error:.2g} at via-point {bound.via_point + 1}"
    return f"{claimed}; {least:.4f} Nm was found there in {_degrees(q)}"


def _false_claim(oracle: Oracle, error: PlanningError, start: FloatArray) -> str:
    """Why an error is wrong; empty where nothing speaks against it. `start` is the scene's posture."""
    t, reason = getattr(error, "time", None), str(error)
    if t is not None and _OUT_OF_REACH.search(reason):
        q = oracle.in_range_somewhere(oracle.path.point(float(t)), _TRIES)
        return "" if q is None else f"within reach and range at {t:.3f} s: {_degrees(q)}"
    if _NO_START.search(reason) and oracle.world.admissible(start):
        return f"the start is admissible: {_degrees(start)}"
    return ""


def _degrees(q: FloatArray | None) -> str:
    return "no posture" if q is None else f"{np.degrees(q).round(4).tolist()} deg"
