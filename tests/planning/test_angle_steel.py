"""The shipped job on angle steel: two strokes with the tool off between them."""

import numpy as np
import pytest
from shared_plans import planned
from told import require_told

from cmbot import load_scene
from cmbot.planning import Plan
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics


@pytest.fixture(scope="module")
def job() -> Plan:
    return planned(load_scene("angle_steel"))


def test_the_tool_goes_up_one_flange_and_down_the_other(job: Plan) -> None:
    assert [each.name for each in job.job.segments] == ["approach", "up", "free_1", "down", "return"]
    X = job.scene.frame_poses["steel"]
    # The outer face of one flange is across x of the steel's frame, that of the other across y.
    for name, across, heights in (("up", 0, [0.1, 0.5]), ("down", 1, [0.5, 0.1])):
        (segment,) = (each for each in job.job.segments if each.name == name)
        trajectory = segment.trajectory
        times = np.linspace(trajectory.t[0], trajectory.t[-1], 401)
        q = trajectory.evaluate(times)
        p, R = Kinematics(job.robot).tool_poses(q)
        # The tool that is held to the path is the bent arm's.
        local = (p + job.sag.at(q).tool - X[:3, 3]) @ X[:3, :3]
        np.testing.assert_allclose(local[:, across], -0.12, atol=1e-3)
        np.testing.assert_allclose(local[:, 1 - across], 0.0375, atol=1e-3)
        np.testing.assert_allclose(local[[0, -1], 2], heights, atol=1e-3)
        z = R[:, :, 2] @ X[:3, across]
        assert np.degrees(np.arccos(np.clip(z, -1, 1))).max() < 1.0


@pytest.mark.parametrize("stroke", [0, 1])
def test_a_second_opinion_agrees(job: Plan, stroke: int) -> None:
    segments = [each for each in job.job.segments if each.name in ("up", "down")]
    trajectory = segments[stroke].trajectory
    checks = second_opinion(job.scene, job.options, trajectory, robot=job.robot, stroke=stroke, sag=job.sag)
    assert all(check.holds for check in checks)
    assert job.certificate.holds


def test_what_is_said_of_it_is_in_certificates_and_figures(job: Plan) -> None:
    require_told(job)
