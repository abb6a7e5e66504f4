"""The same bodies, joints and springs in MuJoCo on the same shaken base: the tool sways alike."""

from __future__ import annotations

import numpy as np
from elastic_in_mujoco import Twin
from small_motions import arm_on_its_guardrail, swing, tool_points

from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Robot
from cmbot.simulation.accelerated_base import on_accelerated_base

STEP, EVERY, SECONDS = 4e-4, 50, 4.0


def record(t: np.ndarray) -> np.ndarray:
    """A record with the arm's slow modes in it, m/s2."""
    frequencies = np.array([1.1, 2.7, 3.4, 4.1, 5.9, 11.0])
    phases = np.arange(6)[:, None] * np.array([1.0, 2.0, 3.0])
    waves = np.sin(2 * np.pi * t[:, None, None] * frequencies[:, None] + phases)
    return np.asarray(0.15 * waves.sum(axis=1))


def test_mujoco_shakes_the_tool_alike(cmbot_robot: Robot) -> None:
    """The joints swinging on a shaken base, undamped: RMS within 2 %, and the tool within a share of it."""
    arm, driven = arm_on_its_guardrail(cmbot_robot), swing(SECONDS)
    still = np.zeros(len(arm.elastic))
    start = Sag(arm).at(driven.states([0.0])[0]).u[0]
    system = ElasticSystem.of(arm, arm.damping)
    ours = {}
    for name, ground in (("shaken", record), ("at rest", lambda t: np.zeros((len(t), 3)))):
        on_base, motions, _ = on_accelerated_base(system, [driven], [], ground)
        motion = GeneralizedAlpha(on_base, step=STEP, rho_inf=0.8, corrections=2, tolerance=1e-8).run(
            motions, start, still
        )
        ours[name] = tool_points(arm, motion.joints[::EVERY, 3:], motion.u[::EVERY])

    twin = Twin(arm, timestep=STEP / 2)
    steps = round(2 * SECONDS / STEP)
    theirs = twin.drive(driven.states, start, steps=steps, every=2 * EVERY, ground=record)

    rigid = Kinematics(cmbot_robot).tool_poses(driven.states(STEP * EVERY * np.arange(len(theirs)))[0])[0]
    swayed = ours["shaken"] - ours["at rest"]
    rms = np.sqrt(np.mean(np.sum(swayed**2, axis=1)))
    assert rms > 3e-3
    assert np.abs(ours["shaken"] - theirs).max() < 0.02 * rms
    sizes = [np.sqrt(np.mean((points - rigid) ** 2)) for points in (ours["shaken"], theirs)]
    assert abs(sizes[0] / sizes[1] - 1) < 0.02


def test_a_base_at_rest_changes_nothing(cmbot_robot: Robot) -> None:
    arm, driven = arm_on_its_guardrail(cmbot_robot), swing(1.0)
    still = np.zeros(len(arm.elastic))
    system = ElasticSystem.of(arm, arm.damping)
    on_base, motions, _ = on_accelerated_base(system, [driven], [], lambda t: np.zeros((len(t), 3)))
    options = {"step": 2e-3, "rho_inf": 0.8, "corrections": 2}
    alone = GeneralizedAlpha(system, **options).run([driven], still, still)
    shaken = GeneralizedAlpha(on_base, **options).run(motions, still, still)
    assert np.abs(alone.u - shaken.u).max() < 1e-12
