"""The shipped job: one face of a plate in rows, from the stowed arm and back to it."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from shared_plans import planned
from told import require_told

from cmbot import load_plan, load_scene, save
from cmbot.planning import Plan
from cmbot.robot import Kinematics


@pytest.fixture(scope="module")
def job() -> Plan:
    # Beside the motion that the README compares it with: one plan for both.
    return planned(load_scene("gusset_plate").with_options(baseline="straight"))


def test_the_tool_covers_the_plate_square_to_it(job: Plan) -> None:
    raster, path = job.scene.strokes[0].raster, job.task.path
    t = np.linspace(0, path.duration, 4001)
    q = job.trajectory.evaluate(t)
    p, R = Kinematics(job.robot).tool_poses(q)
    # The tool that is held to the path is the bent arm's.
    p += job.sag.along(t, q)
    # The face is in a plane across x, which the nozzle looks along.
    face = job.scene.frame_poses["plate"][0, 3]
    np.testing.assert_allclose(p[:, 0], face - raster.stand_off_m, atol=1e-3)
    assert np.arccos(np.clip(R[:, 0, 2], -1, 1)).max() < np.radians(1.0)
    # No place of it is further from a row than half their distance, but where the tool turns.
    y, z = np.meshgrid(np.linspace(0.25, 0.55, 16), np.linspace(-2.2, -1.9, 16))
    grid = np.stack([y.ravel(), z.ravel()], axis=1)
    away = np.linalg.norm(grid[:, None] - p[None, ::4, 1:], axis=2).min(axis=1)
    assert away.max() <= raster.spacing_m / 2 + 1e-3
    speed = np.linalg.norm(np.gradient(p, t, axis=0), axis=1)
    assert speed.max() <= 1.05 * job.scene.tool.max_speed_m_s


def test_the_job_begins_and_ends_stowed(job: Plan) -> None:
    segments = job.job.segments
    assert [segment.name for segment in segments] == ["approach", "work", "return"]
    stow = job.scene.posture
    np.testing.assert_allclose(segments[0].trajectory.q[0], stow, atol=1e-12)
    np.testing.assert_allclose(segments[-1].trajectory.q[-1], stow, atol=1e-12)
    for before, after in pairwise(segments):
        np.testing.assert_allclose(before.trajectory.q[-1], after.trajectory.q[0], atol=1e-12)
    # The free moves ask no more than the work.
    work = job.certificate.figures.peak_guardrail_torque
    assert max(each.certificate.figures.peak_guardrail_torque for each in segments) <= work * (1 + 1e-3)


def test_it_is_verified_from_its_directory(job: Plan, tmp_path: Path) -> None:
    save(job, tmp_path / "plan")
    assert load_plan(tmp_path / "plan", verify=True).certificate.holds


def test_what_is_said_of_it_is_in_certificates_and_figures(job: Plan) -> None:
    require_told(job)
