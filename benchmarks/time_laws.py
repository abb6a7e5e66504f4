"""The shortest time of legs with ``seconds: auto``, beside copp's and toppra's along the same joint paths.

    python benchmarks/time_laws.py

copp's third order has the same bounds of velocity, acceleration and jerk; toppra's second order has none of
jerk: it is what jerk costs. Both are of the path alone, with jerk that jumps; a plan's splines have none that
does, and its certificate holds. Times are of motions, not of this machine.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import copp_py
import numpy as np
import toppra
from rich.console import Console
from rich.table import Table
from scipy.interpolate import BSpline
from suite.arms import arm_named

from cmbot import load_scene, plan
from cmbot.planning import Plan
from cmbot.planning.request import build_request
from cmbot.planning.timing.leg_paths import leg_paths
from cmbot.robot import JointLimits
from cmbot.scene import Scene

__all__ = ["Compared", "compared", "copp_seconds", "scenes", "toppra_seconds"]

# Stations along a path, and rounds of copp's linearization until a round gains less than this.
_STATIONS, _ROUNDS, _GAIN = 301, 15, 1e-4
_FORMAT: dict[str, Any] = {"format": "cmbot-scene/2", "name": "shortest", "guardrail": {"bays": 0}}
_SHORTEST = {"seconds": "auto", "speed_profile": {"kind": "shortest"}}
_LEGS: Mapping[str, dict[str, Any]] = {
    "straight": {"legs": [{"by": [0, -0.3, 0]}], "via_points": 40},
    "there and back": {"legs": [{"by": [0, -0.3, 0]}, {"by": [0, 0.3, 0]}], "via_points": 80},
    "rounded corner": {
        "legs": [{"by": [0, -0.2, 0]}, {"by": [0, 0, 0.15]}],
        "blend_radius_m": 0.05,
        "via_points": 50,
    },
    "turning": {
        "legs": [{"to": {"frame": "tool", "xyz": [0.1, 0.2, 0], "rpy_deg": [0, 15, 0]}}],
        "via_points": 40,
    },
}
# Legs of other arms, from a posture each.
_POSTURES_DEG = {
    "panda": (0, -45, 0, -135, 0, 90, 45),
    "xarm7": (0, -30, 0, 60, 0, 90, 0),
    "ur10": (0, -90, 90, -90, -90, 0),
}
_OTHER_LEGS: Mapping[str, dict[str, Any]] = {
    "along": {"legs": [{"by": [-0.2, 0, 0.1]}], "via_points": 40},
    "across": {"legs": [{"by": [0, 0.4, 0]}], "via_points": 40},
}


def scenes() -> Iterator[tuple[str, Scene]]:
    """Yield what is planned in the shortest time, with a name."""
    own = {**_FORMAT, "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]}}
    for name, path in _LEGS.items():
        yield f"cmbot, {name}", load_scene({**own, "tool_path": {**path, **_SHORTEST}})
    for arm, posture in _POSTURES_DEG.items():
        base, tool = arm_named(arm).base, arm_named(arm).tool
        other = {
            **_FORMAT,
            "robot": {"model": str(arm_named(arm).urdf), "base_frame": base, "tool_frame": tool},
            "start": {"posture_deg": posture},
            "planner": {"start": "pinned"},
        }
        for name, path in _OTHER_LEGS.items():
            yield f"{arm}, {name}", load_scene({**other, "tool_path": {**path, **_SHORTEST}})


@dataclass(frozen=True, kw_only=True)
class Compared:
    """Times of the legs with ``seconds: auto`` of a plan, s."""

    planned: float
    copp: float
    toppra: float


def copp_seconds(q: BSpline, limits: JointLimits) -> float:
    """Return copp's third-order time along a joint path."""
    stations = np.linspace(0.0, 1.0, _STATIONS)
    robot = copp_py.Robot(len(limits.velocity), capacity=_STATIONS)
    robot.append_s(stations)
    robot.set_q(q(stations), q(stations, 1), q(stations, 2), 0, dddq=q(stations, 3))
    everywhere = {"start_idx_s": 0, "length": _STATIONS}
    robot.add_velocity_limits(limits.velocity, -limits.velocity, **everywhere)
    robot.add_acceleration_limits(limits.acceleration, -limits.acceleration, **everywhere)
    second = copp_py.solver.topp2_ra
    problem = second.Problem(robot.constraints, idx_s_interval=(0, _STATIONS - 1), a_boundary=(0.0, 0.0))
    around = second.solve(problem, second.Options())
    robot.add_jerk_limits(limits.jerk, -limits.jerk, **everywhere)
    robot.constraints.amax_substitute(around, 0)
    third, seconds, anchor = copp_py.solver.topp3_socp, np.inf, {}
    for _ in range(_ROUNDS):
        profile = third.solve(third.Problem(robot.constraints, around, **anchor))
        around, anchor = profile.a, {"b_linearization": profile.b}
        before, seconds = seconds, float(copp_py.interpolation.s_to_t_topp3(stations, profile)[0])
        if seconds > before * (1 - _GAIN):
            break
    return seconds


def toppra_seconds(q: BSpline, limits: JointLimits) -> float:
    """Return toppra's second-order time along a joint path."""
    stations = np.linspace(0.0, 1.0, _STATIONS)
    path = toppra.SplineInterpolator(stations, q(stations))
    bounds = [
        toppra.constraint.JointVelocityConstraint(limits.velocity),
        toppra.constraint.JointAccelerationConstraint(limits.acceleration),
    ]
    found = toppra.algorithm.TOPPRA(bounds, path, gridpoints=stations, parametrizer="ParametrizeConstAccel")
    return float(found.compute_trajectory(0.0, 0.0).duration)


def compared(planned: Plan) -> Compared:
    """Compare the times of a plan's legs, along the joint paths that it follows."""
    (stroke,) = planned.job.strokes
    request = build_request(planned.scene, planned.options)
    laws = planned.scene.strokes[0].time_laws or ()
    paths = leg_paths(request, [law.leg for law in laws], stroke.trajectory)
    limits = planned.robot.limits
    return Compared(
        planned=sum(law.duration for law in laws),
        copp=sum(copp_seconds(path.q, limits) for path in paths),
        toppra=sum(toppra_seconds(path.q, limits) for path in paths),
    )


def main() -> int:
    """Plan, compare, print."""
    table = Table("legs", "planned, s", "copp, third order, s", "above it", "toppra, second order, s")
    for name, scene in scenes():
        times = compared(plan(scene, progress=False))
        above = f"{100 * (times.planned / times.copp - 1):+.2f} %"
        table.add_row(name, f"{times.planned:.3f}", f"{times.copp:.3f}", above, f"{times.toppra:.3f}")
    Console().print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
