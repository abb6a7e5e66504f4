"""Earlier motions on paths that have moved: the tool misses them as it missed the earlier ones."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_scenes import short_scene

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan
from cmbot.planning.path.displaced_motion import displaced
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import Motion, StrokeRequest, build_request
from cmbot.robot import Kinematics
from cmbot.scene import Scene
from cmbot.trajectory import QuinticTrajectory

# So loose that it is used.
LOOSE = {"max_tool_deviation_m": 0.004, "smoothing_weight": 3.0}
LEG = np.array([0.0, -0.25, 0.05])


def moved_scene(keep: str, by: FloatArray, turn: Rotation) -> Scene:
    at = Kinematics(cmbot.load_robot()).tool_pose(np.array(short_scene().posture))
    pose = {"xyz": (at.translation + by).tolist()}
    rotation = turn * Rotation.from_matrix(at.rotation)
    if keep == "pose":
        pose["rpy_deg"] = rotation.as_euler("xyz", degrees=True).tolist()
    elif keep == "axis":
        pose["axis"] = rotation.as_matrix()[:, 2].tolist()
    legs = [{"by": turn.apply(LEG).tolist(), "seconds": 4}]
    return short_scene(tool_path={"from": pose, "legs": legs, "keep": keep, "via_points": 16}, planner=LOOSE)


def missed(request: StrokeRequest, trajectory: QuinticTrajectory, turn: Rotation) -> FloatArray:
    """From the path to the tool, (N, 3), m, in the frame that moved with the path."""
    t = np.linspace(0.0, trajectory.duration, 101)
    tool, goals = request.cell.postures.tool_at(trajectory.evaluate(t)), request.task.goals(t)
    return np.asarray(turn.inv().apply(tool.tool_point - goals.point))


@pytest.fixture(scope="module", params=["pose", "axis", "position"])
def earlier(request: pytest.FixtureRequest) -> Plan:
    return cmbot.plan(moved_scene(request.param, np.zeros(3), Rotation.identity()), progress=False)


@pytest.mark.parametrize("seed", range(4))
def test_the_tool_misses_the_path_as_it_missed_the_earlier_one(earlier: Plan, seed: int) -> None:
    direction, axis = (v / np.linalg.norm(v) for v in np.random.default_rng(seed).normal(size=(2, 3)))
    turn, by = Rotation.from_rotvec(np.radians(1.0) * axis), 0.02 * direction
    keep = earlier.task.keep
    scene = moved_scene(keep, by, turn)
    request, before = build_request(scene, scene.planner), build_request(earlier.scene, earlier.options)
    motion = earlier.job.strokes[0].trajectory
    goals = request.task.goals(request.times)
    placed, reached = project_onto_task(request.cell.postures, request.task, motion.q, goals)
    assert reached.all()
    found = displaced(request, Motion(task=before.task, trajectory=motion), placed)
    np.testing.assert_allclose(found.q, placed, rtol=0, atol=1e-12)
    off = missed(before, motion, Rotation.identity())
    assert np.abs(off).max() > 1e-4
    got = missed(request, found, turn)
    # At the ends, from rest, splines with these knots hardly can otherwise.
    share = np.clip((got * off).sum(axis=1) / np.maximum((off * off).sum(axis=1), 1e-20), 0.95, 1.0)
    np.testing.assert_allclose(got, share[:, None] * off, rtol=0, atol=0.02 * np.abs(off).max())
    assert np.median(share) < 0.96
