"""Opposite faces of the shipped job of three faces of a bracket, the nozzle within ten degrees of square."""

import numpy as np
import pytest
from shared_plans import planned
from told import require_told

from cmbot import load_scene
from cmbot.planning import Plan
from cmbot.robot import Dynamics, Kinematics

# Outward normals of the faces.
NORMALS = {"left": (0, 1, 0), "right": (0, -1, 0)}


@pytest.fixture(scope="module")
def job() -> Plan:
    scene = load_scene("bracket_faces")
    faces = [stroke for stroke in scene.strokes if stroke.name in NORMALS]
    # As near to its path as is tested; nearer, each stroke is planned twice.
    return planned(scene.with_strokes(faces).with_options(max_tool_deviation_m=5e-4))


def test_the_nozzle_is_within_its_cone_over_each_face(job: Plan) -> None:
    tilts = []
    for stroke, segment in zip(job.scene.strokes, job.job.strokes, strict=True):
        t = np.linspace(0, segment.duration, 2001)
        q = segment.trajectory.evaluate(t)
        p, R = Kinematics(job.robot).tool_poses(q)
        # The tool that is held to the path is the bent arm's.
        p += job.sag.along(t, q)
        normal, raster = np.array(NORMALS[stroke.name]), stroke.raster
        corner = job.scene.frame_poses["bracket"][:3, 3] + raster.origin
        np.testing.assert_allclose((p - corner) @ normal, raster.stand_off_m, atol=1e-3)
        tilts.append(np.degrees(np.arccos(np.clip(-R[:, :, 2] @ normal, -1, 1))).max())
        # Every place of the face is passed at half the rows' distance at most, but where the tool turns.
        u, v = (np.array(edge) for edge in (raster.u, raster.v))
        shares = np.linspace(0.4, 0.6, 9)
        face = corner + shares[:, None, None] * u + np.linspace(0, 1, 17)[None, :, None] * v
        along = p - ((p - corner) @ normal)[:, None] * normal
        away = np.linalg.norm(face.reshape(-1, 1, 3) - along[None], axis=2).min(axis=1)
        assert away.max() <= raster.spacing_m / 2 + 1e-3
    # It leans as far as it may somewhere, and never further.
    assert 5 < max(tilts) <= 10 + 1e-6


def test_the_job_asks_no_more_than_its_hardest_posture(job: Plan) -> None:
    ends = [segment.trajectory.q[[0, -1]] for segment in job.job.segments]
    off = Dynamics(job.robot.tool_off).static_efforts(np.concatenate(ends)).guardrail_torque
    at_rest = np.linalg.norm(off, axis=1).max()
    assert job.torque_floor is not None
    assert job.job.figures.peak_guardrail_torque <= 1.02 * max(job.torque_floor, at_rest)
    for q, end in ((job.scene.posture, 0), (job.robot.group_states["stow"], -1)):
        np.testing.assert_allclose(job.job.trajectory.q[end], q, atol=1e-9)


def test_what_is_said_of_it_is_in_certificates_and_figures(job: Plan) -> None:
    require_told(job)
