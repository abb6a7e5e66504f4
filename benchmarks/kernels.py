"""What one evaluation of the inner functions costs, each way of doing it beside the others.

    python benchmarks/kernels.py

Processor times of one thread. What cmbot does is marked; all answers are compared before any is timed.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from measure import process_time
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from cmbot import load_scene
from cmbot.collision import Clearances, PairedShapes
from cmbot.planning import robot_of
from cmbot.robot import Dynamics, Kinematics, Postures, Robot
from cmbot.scene import Scene

__all__ = ["Kernel", "kernels", "measured"]

FloatArray = NDArray[np.float64]
Way = tuple[str, bool, Callable[[], FloatArray]]
SIZES = (50, 500, 2000)
# The path whose clearances are looked at swings by so much, rad; nearer than the margin, m, is too near.
_SWING, _MARGIN = 0.3, 0.02
_ROUNDING, _GJK = 1e-9, 1e-7


@dataclass(frozen=True, kw_only=True)
class Kernel:
    """One way of evaluating something.

    Attributes
    ----------
    what, way : str
    used : bool
        By cmbot, where there are many.
    number : int
        States or postures in one call.
    microseconds : float
        Each of them.
    """

    what: str
    way: str
    used: bool
    number: int
    microseconds: float


def kernels(number: int = 500) -> list[dict[str, Any]]:
    """Measure all ways for one size of a call; the first row is what the others are compared with."""
    return [
        {"kernel": f"{row.what}: {row.way}" + (" (used)" if row.used else ""), **asdict(row)}
        for row in measured(number)
    ]


def measured(number: int) -> Iterator[Kernel]:
    """Measure all ways of evaluating `number` states or postures."""
    scene, robot = shipped()
    for what, tolerance, ways in (
        ("wrench and joint torques", _ROUNDING, _values(robot, number)),
        ("their derivatives", _ROUNDING, _derivatives(robot, number)),
        ("tool poses", _ROUNDING, _tool_poses(robot, number)),
        ("smallest clearance", _GJK, _smallest(robot, scene, number)),
        ("collision check", 0.0, _collision_check(robot, scene, number)),
    ):
        expected = ways[0][2]()
        for way, used, run in ways:
            off = np.abs(run() - expected).max() / max(1.0, np.abs(expected).max())
            if not off <= tolerance:
                sys.exit(f"error: {what}: {way} is off by {off:.1e}")
            microseconds = 1e6 * process_time(run, repeats=5)[0] / number
            yield Kernel(what=what, way=way, used=used, number=number, microseconds=microseconds)


def shipped() -> tuple[Scene, Robot]:
    """Return the triangle and its robot."""
    scene = load_scene("triangle")
    return scene, robot_of(scene)


def states(robot: Robot, number: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Random positions, velocities and accelerations (N, n)."""
    q, v, a = np.random.default_rng(0).normal(size=(3, number, robot.dof))
    return q, v, a


def _values(robot: Robot, number: int) -> list[Way]:
    dynamics, (q, v, a) = Dynamics(robot), states(robot, number)
    data = robot.model.createData()

    def loop() -> FloatArray:
        rows = np.empty((number, 6 + robot.dof))
        for k in range(number):
            rows[k, 6:] = pin.rnea(robot.model, data, q[k], v[k], a[k])
            rows[k, :6] = -data.liMi[1].act(data.f[1]).vector
        return rows

    def parallel() -> FloatArray:
        at = dynamics.efforts(q, v, a)
        return np.hstack([at.guardrail_force, at.guardrail_torque, at.joint_torque])

    return [("pinocchio in a loop", False, loop), ("pinocchio.rneaInParallel", True, parallel)]


def _derivatives(robot: Robot, number: int) -> list[Way]:
    dynamics, (q, v, a) = Dynamics(robot), states(robot, number)
    floating, data = robot.floating_model, robot.floating_model.createData()
    still = np.zeros(6)

    def free_flyer() -> FloatArray:
        rows = np.empty((number, 6, robot.dof))
        for k in range(number):
            at = (np.append(still, [1.0, *q[k]]), np.append(still, v[k]), np.append(still, a[k]))
            rows[k] = pin.computeRNEADerivatives(floating, data, *at)[0][:6, 6:]
        return rows

    return [
        ("pinocchio in a loop, free-flyer", False, free_flyer),
        ("pinocchio in a loop, forces in W", True, lambda: -dynamics.wrench_derivatives(q, v, a).d_q),
    ]


def _tool_poses(robot: Robot, number: int) -> list[Way]:
    kinematics, postures, (q, _, _) = Kinematics(robot), Postures(robot), states(robot, number)

    def loop() -> FloatArray:
        return np.array([kinematics.tool_pose(q_k).translation for q_k in q])

    return [
        ("pinocchio in a loop", False, loop),
        ("all together", True, lambda: postures.at(q).tool_point),
    ]


def _path(scene: Scene, number: int) -> FloatArray:
    """A smooth path of postures about the scene's own."""
    rng = np.random.default_rng(1)
    t = np.linspace(0.0, 2 * np.pi, number)[:, None]
    return np.asarray(scene.posture + _SWING * rng.uniform(-1, 1, 7) * np.sin(t + rng.uniform(0, 6, 7)))


def _smallest(robot: Robot, scene: Scene, number: int) -> list[Way]:
    clearances, q = Clearances(robot, scene.all_obstacles), _path(scene, number)
    model, data = robot.model, robot.model.createData()
    geometry = PairedShapes(robot, scene.all_obstacles).geometry
    found = pin.GeometryData(geometry)

    def all_pairs() -> FloatArray:
        least = np.empty(number)
        for k, q_k in enumerate(q):
            pin.computeDistances(model, data, geometry, found, q_k)
            least[k] = min(result.min_distance for result in found.distanceResults)
        return least

    def one_by_one() -> FloatArray:
        return np.array([clearances.query(q_k[None]).distance[0] for q_k in q])

    return [
        ("coal on all pairs", False, all_pairs),
        ("one by one, remembering", False, one_by_one),
        ("many in one call", True, lambda: clearances.query(q).distance),
    ]


def _collision_check(robot: Robot, scene: Scene, number: int) -> list[Way]:
    clearances, (q, _, _) = Clearances(robot, scene.all_obstacles), states(robot, number)

    def near(some: FloatArray) -> FloatArray:
        return (clearances.query(some, _MARGIN).distance < _MARGIN).astype(float)

    return [
        (
            "coal until a pair is",
            False,
            lambda: np.hstack([near(q_k[None]) for q_k in q]),
        ),
        ("many in one call", True, lambda: near(q)),
    ]


def main() -> None:
    """Measure and print."""
    sizes = " / ".join(map(str, SIZES))
    table = Table(title=f"Kernels, {sizes} in one call; * what cmbot does with many")
    for heading in ("what", "how", "times the first", "us each"):
        table.add_column(heading, justify="left" if heading in ("what", "how") else "right")
    with threadpool_limits(limits=1):
        columns = [list(measured(number)) for number in SIZES]
    first: dict[tuple[str, int], float] = {}
    for rows in zip(*columns, strict=True):
        units = [first.setdefault((row.what, row.number), row.microseconds) for row in rows]
        ratios = (f"{row.microseconds / unit:.2f}" for row, unit in zip(rows, units, strict=True))
        table.add_row(
            rows[0].what,
            rows[0].way + (" *" if rows[-1].used else ""),
            " / ".join(ratios),
            " / ".join(f"{row.microseconds:.1f}" for row in rows),
        )
    Console(soft_wrap=True).print(table)


if __name__ == "__main__":
    main()
