"""Enclosures of the certificate against dense samples of random trajectories, and what they cost.

    python benchmarks/enclosures.py                  # 100 trajectories
    python benchmarks/enclosures.py --number 1000

Every trajectory of the shipped arm is sampled evenly, and about the time of each enclosure's largest value as
densely as 100,000 samples a segment. No sample may lie outside. Times are process times of this machine; how
they grow with the number of segments means something elsewhere.
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning import ToolTask, certify, measure, robot_of
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import PlannerOptions
from cmbot.toolpath import SpeedProfile, ToolPath
from cmbot.trajectory import QuinticTrajectory, SplineSpace

_SEGMENTS = (4, 12)
_EVEN, _DENSE, _WINDOW = 1000, 100_000, 100
_SIZES = (50, 200, 1000)
_BOUNDS = (
    "torque on the guardrail, share of its peak",
    "joint torque, share of its bound",
    "tool deviation, m",
    "tool rotation, rad",
    "tool lag, m",
    "clearance, m",
)


@dataclass(frozen=True, kw_only=True)
class Case:
    """A random trajectory and the task of a random path beside it."""

    trajectory: QuinticTrajectory
    task: ToolTask


def case(seed: int, robot: Robot, posture: FloatArray) -> Case:
    """Return the case of a seed."""
    rng = np.random.default_rng(seed)
    segments = int(rng.integers(*_SEGMENTS))
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 1.0, segments))])
    steps = rng.normal(scale=rng.choice([0.02, 0.1, 0.3]), size=(segments + 1, robot.dof))
    q = posture + np.cumsum(steps, axis=0) - steps[0]
    space = SplineSpace(t)
    trajectory = space.trajectory(space.least_jerk(q))
    p_WT, R_WT = Kinematics(robot).tool_poses(q)
    legs = int(rng.integers(1, 4))
    ends = np.unique(np.linspace(0, segments, legs + 1).astype(int))
    profile = SpeedProfile(
        kind=rng.choice(["trapezoidal", "jerk_limited"]), ramp=float(rng.uniform(0.1, 0.5))
    )
    path = ToolPath.straight(p_WT[ends], R_WT[0], np.diff(t[ends]), profile.law)
    return Case(trajectory=trajectory, task=ToolTask(path, rng.choice(["pose", "axis"])))


def outside(
    robot: Robot, clearances: Clearances, case: Case, *, even: int = _EVEN, window: int = _WINDOW
) -> tuple[int, int, FloatArray]:
    """Samples outside their enclosures, samples, and how far each bound lies above the largest sample.

    Samples are `even` ones, and `window` on each side of the times of largest values.
    """
    x, task = case.trajectory, case.task
    found = certify(robot, task, x, clearances, PlannerOptions(), via_points=len(x.t))
    checks = {check.quantity.split(" of ")[0]: check for check in found.checks}
    wrong = number = 0
    widths = []
    at = {
        name: checks[name] for name in ("torque", "tool deviation", "tool rotation", "tool lag", "clearance")
    }
    t_even = np.linspace(0, x.t[-1], even)
    torques = Dynamics(robot).efforts(*x.states(t_even)).guardrail_torque
    times = [t_even]
    for time_ in (t_even[np.linalg.norm(torques, axis=1).argmax()], *(check.time for check in at.values())):
        step = float(np.diff(x.t)[np.clip(np.searchsorted(x.t, time_) - 1, 0, len(x.t) - 2)]) / _DENSE
        spread = np.arange(-window, window + 1)
        times += [np.clip(time_ + s * spread, 0, x.t[-1]) for s in (step, t_even[1] / window)]
    t = np.concatenate(times)
    samples = measure(robot, task, clearances, t, [x.evaluate(t, order) for order in range(4)])
    limit = robot.limits.torque
    guardrail = np.linalg.norm(samples.guardrail_torque, axis=1)
    share = np.abs(samples.joint_torque / limit).max(axis=1)
    torque = at["torque"]
    for values, bound in (
        (guardrail / guardrail.max(), found.guardrail_torque_bound / guardrail.max()),
        (share, torque.value / torque.bound),
        (samples.tool_deviation, at["tool deviation"].value),
        (samples.tool_rotation, at["tool rotation"].value),
        (samples.tool_lag, at["tool lag"].value),
        (-samples.clearance, -found.clearance_bound),
    ):
        wrong += int((values > bound).sum())
        number += len(values)
        widths.append(bound - values.max())
    return wrong, number, np.array(widths)


def costs(size: int) -> float:
    """Process time, s, of a certificate of the triangle's trajectory cut into `size` - 1 segments."""
    scene = load_scene("triangle")
    robot = robot_of(scene)
    made = case(1, robot, np.array(scene.posture))
    t = np.linspace(0, made.trajectory.t[-1], size)
    q, v, a = made.trajectory.states(t)
    fine = QuinticTrajectory(t=t, q=q, v=v, a=a)
    clearances = Clearances(robot, scene.all_obstacles)
    best = np.inf
    for _ in range(5):
        began = time.process_time()
        certify(robot, made.task, fine, clearances, PlannerOptions(), via_points=size)
        best = min(best, time.process_time() - began)
    return float(best)


def main() -> int:
    """Compare, measure and print; 1 when a sample lies outside."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--number", type=int, default=100, help="random trajectories")
    number = parser.parse_args().number
    scene = load_scene("triangle")
    robot = robot_of(scene)
    clearances, posture = Clearances(robot, scene.all_obstacles), np.array(scene.posture)
    with threadpool_limits(limits=1, user_api="blas"):
        each = [outside(robot, clearances, case(seed, robot, posture)) for seed in range(number)]
        seconds = {size: costs(size) for size in _SIZES}
    wrong, samples = sum(e[0] for e in each), sum(e[1] for e in each)
    console = Console()
    console.print(f"{number} trajectories, {samples} samples, {wrong} outside")
    widths = Table("bound", "above the largest sample: median", "largest", title="Widths")
    for name, column in zip(_BOUNDS, np.transpose([e[2] for e in each]), strict=True):
        widths.add_row(name, f"{np.median(column):.1e}", f"{column.max():.1e}")
    console.print(widths)
    table = Table("via-points", "certificate, s", title="Costs")
    for size, value in seconds.items():
        table.add_row(str(size), f"{value:.3f}")
    console.print(table)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
