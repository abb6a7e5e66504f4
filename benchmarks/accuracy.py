"""How well the accuracy budget tells where the tool will be: prints the table of docs/accuracy.md.

``python benchmarks/accuracy.py`` plans six scenes and compares the radius that `plan.accuracy` tells with
that of a Monte Carlo of its own: exact bent arms, their sway integrated by MuJoCo. Some minutes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, bending_arm
from cmbot.robot import Kinematics
from cmbot.scene import Placement, Scene, Uncertainty

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "helpers"))
from elastic_in_mujoco import Twin

HEADINGS = ("scene", "told, mm", "Monte Carlo, mm", "ratio", "sway, mm", "by MuJoCo, mm")
# Between postures at which statics are computed, s; of MuJoCo's steps and of the points that are compared, s.
BETWEEN, STEP, EVERY = 0.25, 2e-4, 50
FACTORS = np.linspace(-1.0, 1.0, 5)
"""At which stiffness MuJoCo integrates, in units of the stated share."""
MAST = [2.5e5, 2.5e5, 1e8, 2.5e5, 2.5e5, 1.5e5]
"""Stiffness below an arm of another maker, N/m and Nm/rad: a steel tube of 1 m, 100 x 3 mm, uncoupled."""
LEGS = [{"by": [0, 0.25, 0], "seconds": 4}, {"by": [0.1, 0, -0.1], "seconds": 3}]


def scenes() -> Iterator[tuple[str, Scene]]:
    """Scenes of the shipped arm and of two others, with names."""
    triangle = cmbot.load_scene("triangle").as_data()
    elastic = triangle | {"robot": triangle["robot"] | {"joints": "elastic"}}
    yield "triangle, elastic joints", cmbot.load_scene(elastic)
    for name, compensate in (("line", False), ("line, compensated", True)):
        data = cmbot.load_scene("line").as_data()
        yield name, cmbot.load_scene(data | {"planner": data["planner"] | {"compensate": compensate}})
    data = cmbot.load_scene("pipe").as_data()
    yield "pipe, soft rail", cmbot.load_scene(data | {"guardrail": {"stiffness_factor": 0.5}})
    for model, frames, posture in (
        ("panda", ("panda_link0", "panda_hand_tcp"), [0, -45, 0, -135, 0, 90, 45]),
        ("ur10", ("base_link", "tool0"), [0, -90, 90, -90, -90, 0]),
    ):
        base, tool = frames
        yield (
            f"{model} on a mast",
            cmbot.load_scene(
                {
                    "format": "cmbot-scene/2",
                    "name": f"{model}_mast",
                    "robot": {"model": model, "base_frame": base, "tool_frame": tool},
                    "start": {"posture_deg": posture},
                    "tool_path": {"keep": "axis", "legs": LEGS},
                    "guardrail": {"bays": 0, "stiffness": MAST},
                }
            ),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class MonteCarlo:
    """Distances (D,), m, of draws, and the largest sway at any stiffness, m."""

    distances: FloatArray
    sway: float


def bent_tool(arm: ElasticArm, q: FloatArray) -> FloatArray:
    """Places (N, 3), m, of the bent arm's tool."""
    return np.asarray(Kinematics(arm.robot).tool_poses(q)[0] + Sag(arm).at(q).tool)


def swayed(
    plan: Plan, arm: ElasticArm, factor: float, after_s: float = 0.0, *, sets_in: bool = False
) -> FloatArray:
    """What MuJoCo adds (N, 3), m, to the bent arm at rest during the planned motion, and so long after it.

    A process force is there from the start, or sets in at once then.
    """
    motion, soft = plan.trajectory, arm.softened(factor)

    def states(t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        at = np.minimum(t, motion.duration)
        moves = (t <= motion.duration)[:, None]
        return motion.evaluate(at), motion.evaluate(at, 1) * moves, motion.evaluate(at, 2) * moves

    steps = int((motion.duration + after_s) / STEP) // EVERY * EVERY
    q = states(STEP * EVERY * np.arange(steps // EVERY + 1))[0]
    start = Sag(soft.tool_off if sets_in else soft).at(q[:1]).u[0]
    damping = arm_modes(soft, q[len(q) // 2]).damping(arm.robot.damping_ratio)
    twin = Twin(soft, timestep=STEP)
    return np.asarray(twin.drive(states, start, steps, EVERY, damping=damping) - bent_tool(soft, q))


def monte_carlo(plan: Plan, draws: int, seed: int) -> MonteCarlo:
    """Return the largest distances from the path of a stroke, by the exact bent arm of each draw."""
    arm, unknown = bending_arm(plan.scene, plan.robot), plan.scene.uncertainty
    if arm is None:
        sys.exit(f"{plan.scene.name}: nothing bends")
    rng, path, motion = np.random.default_rng(seed), plan.job.strokes[0].task.path, plan.trajectory
    sways = np.array([swayed(plan, arm, 1 + unknown.stiffness_share * f, sets_in=True) for f in FACTORS])
    fine = STEP * EVERY * np.arange(sways.shape[1])
    t = np.linspace(0.0, path.duration, int(np.ceil(path.duration / BETWEEN)) + 1)
    # A compensated plan's joints aim beside the path by the sag that is predicted.
    goal = path.position(t) if plan.compensation is None else bent_tool(arm, motion.evaluate(t))
    planned = np.zeros_like(goal) if plan.compensation else path.leg_offset(t, motion_tool(plan, t))
    # At rest, too, where a chord would have no direction.
    along = path.leg_directions(fine)
    reference = motion_tool(plan, t) if plan.compensation is None else goal
    found = np.empty(draws)
    for k in range(draws):
        share = rng.uniform(-1, 1)
        error = planned + drawn_tool(arm, plan, t, share, unknown, rng) - reference
        at = np.array([np.interp(fine, t, column) for column in error.T]).T
        number = np.clip(np.searchsorted(FACTORS, share) - 1, 0, len(FACTORS) - 2)
        part = (share - FACTORS[number]) / (FACTORS[number + 1] - FACTORS[number])
        at += (1 - part) * sways[number] + part * sways[number + 1]
        across = at - np.sum(at * along, axis=1, keepdims=True) * along
        found[k] = np.linalg.norm(across, axis=1).max()
    sways -= np.sum(sways * along, axis=2, keepdims=True) * along
    return MonteCarlo(distances=found, sway=float(np.linalg.norm(sways, axis=2).max()))


def motion_tool(plan: Plan, t: FloatArray) -> FloatArray:
    """Places (N, 3), m, of the rigid arm's tool."""
    return np.asarray(Kinematics(plan.robot).tool_poses(plan.trajectory.evaluate(t))[0])


def drawn_tool(
    arm: ElasticArm,
    plan: Plan,
    t: FloatArray,
    share: float,
    unknown: Uncertainty,
    rng: np.random.Generator,
) -> FloatArray:
    """Places (N, 3), m, of the tool at rest of one draw."""
    robot, joints = arm.robot, unknown.joints
    drawn = arm.softened(1 + unknown.stiffness_share * share, rng.uniform(0, unknown.payload_kg))
    commanded = plan.trajectory.evaluate(t)
    turning = ~robot.limits.prismatic
    q = commanded + np.radians(joints.calibration_deg) * rng.normal(size=robot.dof) * turning
    q = q + np.radians(joints.backlash_arcmin / 60) / 2 * rng.uniform(-1, 1, q.shape) * turning
    for number, name in enumerate(robot.joints):
        spring = robot.joint_elasticity.get(name)
        if spring is not None:
            data = robot.model.createData()
            torque = np.array([pin.computeGeneralizedGravity(robot.model, data, x)[number] for x in q])
            windup = joints.friction_share * np.abs(torque) / spring.stiffness
            q[:, number] += windup * rng.uniform(-1, 1, len(q))
    tool = bent_tool(drawn, q) + bowed(arm, q, unknown.temperature_k, rng)
    foot, path = np.array(robot.foot_point), plan.job.strokes[0].task.path.position(t)
    middle = 0.5 * (path.min(axis=0) + path.max(axis=0))
    for about, placed in ((foot, unknown.foot), (middle, unknown.workpiece)):
        tool = displaced(tool, about, placed, rng)
    return tool


def displaced(tool: FloatArray, about: FloatArray, placed: Placement, rng: np.random.Generator) -> FloatArray:
    """Points (N, 3), m, moved as a rigid body that is not quite where it should be."""
    turn = pin.exp3(np.radians(placed.deg) * rng.normal(size=3))
    return np.asarray(about + (tool - about) @ turn.T + 1e-3 * placed.mm * rng.normal(size=3))


def bowed(arm: ElasticArm, q: FloatArray, kelvin: float, rng: np.random.Generator) -> FloatArray:
    """What tubes that are warmer on one side add (N, 3), m, to the tool's place."""
    robot, data, tubes = arm.robot, arm.robot.model.createData(), arm.robot.elasticity
    given = {robot.model.getFrameId(link): np.array([tube.start, tube.end]) for link, tube in tubes.items()}
    ends, tool = np.empty((len(given), len(q), 2, 3)), Kinematics(robot).tool_poses(q)[0]
    for k, posture in enumerate(q):
        pin.framesForwardKinematics(robot.model, data, posture)
        for own, (frame, points) in zip(ends, given.items(), strict=True):
            own[k] = points @ data.oMf[frame].rotation.T + data.oMf[frame].translation
    added = np.zeros((len(q), 3))
    for own, tube in zip(ends, tubes.values(), strict=True):
        expansion = 12e-6 if tube.young > 1.5e11 else 23e-6
        sides = rng.uniform(-1, 1, 2) * expansion * kelvin * tube.length / tube.outer_diameter
        along = np.diff(own, axis=1)
        across = np.linalg.svd(along / np.linalg.norm(along, axis=2, keepdims=True))[2][:, 1:]
        added += np.cross(sides @ across, tool - own.mean(axis=1))
    return added


def rows(draws: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Rows of the table, as they are computed."""
    for name, scene in scenes():
        plan = cmbot.plan(scene, progress=False)
        accuracy = plan.accuracy
        if accuracy is None:
            sys.exit(f"{name}: nothing bends")
        found = monte_carlo(plan, draws, seed)
        radius = 1e3 * float(np.quantile(found.distances, accuracy.probability))
        sway = next(part.bias_mm for part in accuracy.parts if part.name == "sway")
        told = accuracy.within_mm
        radii = f"{told:.2f}", f"{radius:.2f}", f"{told / radius:.3f}"
        yield name, *radii, f"{sway:.3f}", f"{1e3 * found.sway:.3f}"


def main() -> None:
    """Print the table, a row at a time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=20261126)
    given: Any = parser.parse_args()
    print("| " + " | ".join(HEADINGS) + " |")
    print("|" + "---|" * len(HEADINGS))
    for row in rows(given.draws, given.seed):
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
