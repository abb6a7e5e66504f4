"""The shipped job on a pipe: rows over a cylinder, without a stop, from the stowed arm and back to it."""

import numpy as np
import pytest
from shared_plans import planned
from told import require_told

from cmbot import load_scene
from cmbot.planning import Plan
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics
from cmbot.toolpath import Coverage


@pytest.fixture(scope="module")
def job() -> Plan:
    return planned(load_scene("pipe"))


def test_the_tool_covers_the_pipe_square_to_it(job: Plan) -> None:
    raster, path = job.scene.strokes[0].raster, job.task.path
    pipe = raster.cylinder
    t = np.linspace(0, path.duration, 2001)
    q = job.trajectory.evaluate(t)
    p, R = Kinematics(job.robot).tool_poses(q)
    # The tool that is held to the path is the bent arm's.
    p += job.sag.along(t, q)
    from_axis = (p - job.scene.frame_poses["pipe"][:3, 3]) * [1, 0, 1]
    away = np.linalg.norm(from_axis, axis=1)
    np.testing.assert_allclose(away, pipe.radius + raster.stand_off_m, atol=1e-3)
    towards = -np.einsum("nd,nd->n", R[:, :, 2], from_axis / away[:, None])
    assert np.degrees(np.arccos(np.clip(towards, -1, 1))).max() < 1.0
    # No place of it, unrolled, is further from a row than half their distance.
    angle = np.degrees(np.arctan2(from_axis[:, 0], from_axis[:, 2]))
    y = p[:, 1] - job.scene.frame_poses["pipe"][1, 3]
    grid = np.stack(np.meshgrid(np.linspace(-125, -55, 16), np.linspace(-0.2, 0.2, 16)), axis=-1).reshape(
        -1, 2
    )
    unrolled = np.stack([np.radians(angle) * pipe.radius, y], axis=1)
    places = grid * [np.radians(1.0) * pipe.radius, 1.0]
    nearest = np.linalg.norm(places[:, None] - unrolled[None, ::4], axis=2).min(axis=1)
    assert nearest.max() <= raster.spacing_m / 2 + 2e-3
    assert [segment.name for segment in job.job.segments] == ["approach", "work", "return"]
    area = np.radians(pipe.to_deg - pipe.from_deg) * pipe.radius * pipe.length
    assert job.coverage["work"] == Coverage(area=pytest.approx(abs(area)))
    assert f"{abs(area):.4f}" in {row[0][:12]: row[-1] for row in job.rows()}["area covered"]
    assert not [row for row in job.rows() if row[0].startswith(("area beyond", "area that is not"))]


def test_a_second_opinion_agrees(job: Plan) -> None:
    checks = second_opinion(job.scene, job.options, job.trajectory, robot=job.robot, stroke=0, sag=job.sag)
    assert all(check.holds for check in checks)
    assert job.certificate.holds


def test_what_is_said_of_it_is_in_certificates_and_figures(job: Plan) -> None:
    require_told(job)
