"""A walk as files: every joint over time, and the steps with what was certified of them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.reading.validation import plain
from cmbot.hold import Holding
from cmbot.robot import ARM_JOINTS, CLIMBING_JOINTS, Climber, Dynamics
from cmbot.stances.walking.steps import Move
from cmbot.stances.walking.walk import Walk
from cmbot.version import __version__

_WALK_STEP_S = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class WalkSamples:
    """A move at N times.

    Attributes
    ----------
    move : Move
    t : (N,), s
        On the walk's clock.
    climber, arm : (N, 5) and (N, 7), rad
    root : (N, 7), m
        Pose of foot 1 in W, as position and quaternion x, y, z, w.
    feet : (N, 2, 3), m
        Where the feet are, in W.
    effort : (N, 12)
        Of what each climbing joint, then each joint of the arm can bear, where it moves; else NaN.
    share : (N, 2)
        Of what each foot can bear, safety included; NaN of one that goes, is free or has no bounds.
    """

    move: Move
    t: FloatArray
    climber: FloatArray
    arm: FloatArray
    root: FloatArray
    feet: FloatArray
    effort: FloatArray
    share: FloatArray


def walk_samples(walk: Walk) -> Iterator[WalkSamples]:
    """Yield the moves of a walk at equal times."""
    climber = Climber()
    for move, begin in zip(walk.moves, walk.begins, strict=True):
        trajectory = move.segment.trajectory
        t = np.linspace(
            0.0, trajectory.duration, max(int(np.ceil(trajectory.duration / _WALK_STEP_S)) + 1, 2)
        )
        q, v, a = trajectory.states(t)[:3]
        moves_arm = move.kind == "arm"
        angles = np.repeat(move.node.climber[None], len(t), axis=0)
        if not moves_arm:
            angles = q if move.holds == (1,) else q[:, ::-1]
        efforts = Dynamics(move.robot).efforts(q, v, a)
        root, feet = _feet(move, angles, climber)
        yield WalkSamples(
            move=move,
            t=begin + t,
            climber=angles,
            arm=q if moves_arm else np.repeat(move.arm[None], len(t), axis=0),
            root=root,
            feet=feet,
            effort=_efforts(move, efforts.joint_torque),
            share=_shares(move, efforts.guardrail_wrench),
        )


def _feet(move: Move, angles: FloatArray, climber: Climber) -> tuple[FloatArray, FloatArray]:
    """Poses (N, 7) of foot 1, and where both feet are (N, 2, 3)."""
    stays = move.node.foot_pose(2)
    roots, each = np.empty((len(angles), 7)), np.empty((len(angles), 2, 3))
    for k, posture in enumerate(angles):
        X_12 = climber.poses(posture)[0]
        root = stays @ np.linalg.inv(X_12) if move.holds == (2,) else move.node.root
        roots[k] = *root[:3, 3], *Rotation.from_matrix(root[:3, :3]).as_quat()
        each[k] = root[:3, 3], (root @ X_12)[:3, 3]
    # A quaternion and its negative are the same turn; beside each other they have the same sign.
    same = (roots[1:, 3:] * roots[:-1, 3:]).sum(axis=1) >= 0
    roots[1:, 3:] *= np.cumprod(np.where(same, 1.0, -1.0))[:, None]
    return roots, each


def _efforts(move: Move, torque: FloatArray) -> FloatArray:
    share = np.full((len(torque), len(CLIMBING_JOINTS) + len(ARM_JOINTS)), np.nan)
    names = [*CLIMBING_JOINTS, *ARM_JOINTS]
    share[:, [names.index(name) for name in move.robot.joints]] = np.abs(torque) / move.robot.limits.torque
    return share


def _shares(move: Move, wrench: FloatArray) -> FloatArray:
    robot, share = move.robot, np.full((len(wrench), 2), np.nan)
    constant = np.hstack([robot.carrier_mass * robot.model.gravity.linear, robot.carrier_torque])
    for number, foot in zip(move.holds, robot.feet, strict=True):
        if foot.bounded:
            share[:, number - 1] = Holding((foot,), constant).share(wrench)[0]
    return share


def walk_csv(walk: Walk) -> str:
    """Return every joint, the feet and what they bear over time: SI units and radians."""
    feet = [f"foot_{k}_{axis}" for k in (1, 2) for axis in "xyz"]
    shares = ["share_1", "share_2"]
    lines = [",".join(["t", "step", "move", "holds", *CLIMBING_JOINTS, *ARM_JOINTS, *feet, *shares])]
    number = {id(move): k for k, step in enumerate(walk.steps, start=1) for move in step.moves}
    for part in walk_samples(walk):
        step = number.get(id(part.move), len(walk.steps) + 1)
        names = [str(step), part.move.kind, "+".join(map(str, part.move.holds))]
        rows = np.hstack([part.climber, part.arm, part.feet.reshape(len(part.t), 6)])
        for t, row, share in zip(part.t, rows, part.share, strict=True):
            held = ["" if np.isnan(x) else f"{x:.4f}" for x in share]
            lines.append(",".join([f"{t:.6g}", *names, *(f"{x:.9g}" for x in row), *held]))
    return "\n".join([*lines, ""])


def walk_data(walk: Walk) -> dict[str, Any]:
    """Return a walk, ready for JSON: stances, the knots of every move, and what was certified of it."""
    begins, needed = iter(walk.begins), walk.adhesion_needed
    steps = [
        {
            "foot": step.foot,
            "from": step.places[0],
            "to": step.places[1],
            "before": step.before.stance.model_dump(mode="json"),
            "after": step.after.stance.model_dump(mode="json"),
            "moves": [_move(move, next(begins)) for move in step.moves],
        }
        for step in walk.steps
    ]
    last = None if walk.last is None else _move(walk.last, next(begins))
    peak = (
        None if needed is None else {name: getattr(needed, name) for name in ("peak", "mode", "time", "foot")}
    )
    return {
        "format": "cmbot-walk/1",
        "cmbot": __version__,
        "scene": plain(walk.scene, walk.scene.source),
        "goal": walk.goal.stance.model_dump(mode="json"),
        "seconds": walk.seconds,
        "max_foot_speed": walk.speed,
        "adhesion_needed": peak,
        "effort_used": walk.effort,
        "steps": steps,
        "last": last,
        "failures": list(walk.failures),
        "words": list(walk.in_words()),
    }


def _move(move: Move, begin: float) -> dict[str, Any]:
    segment, trajectory = move.segment, move.segment.trajectory
    checks = [
        {name: getattr(check, name) for name in ("quantity", "time", "value", "bound", "unit", "at_least")}
        for check in segment.certificate.checks
    ]
    return {
        "kind": move.kind,
        "begin": begin,
        "seconds": segment.duration,
        "holds": list(move.holds),
        "joints": list(move.robot.joints),
        "arm": move.arm.tolist(),
        "knots": {name: getattr(trajectory, name).tolist() for name in ("t", "q", "v", "a")},
        "checks": checks,
    }
