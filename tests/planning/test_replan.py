"""Plans near earlier plans: a frame that moved, a load, and what is no such scene."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from small_scenes import strokes_scene

import cmbot
from cmbot.common.errors import InputError
from cmbot.planning import Plan
from cmbot.robot import Kinematics
from cmbot.scene import Scene

_TRIANGLE = Path(cmbot.__file__).parents[1] / "scenes" / "triangle.yaml"
# Where the tool is in the triangle's posture.
_A, _TOOL_RPY_DEG = np.array([1.81535382, 0.77957357, -2.06283628]), [180.0, -50.0, 0.0]
_AXIS = np.ones(3) / np.sqrt(3)


def triangle(moved: float = 0.0, turned_deg: float = 0.0, **more: Any) -> Scene:
    """The triangle, by corners in a frame that is moved along a diagonal, m, and turned about it."""
    data = yaml.safe_load(_TRIANGLE.read_text())
    turn = Rotation.from_rotvec(np.deg2rad(turned_deg) * _AXIS)
    rpy = turn.as_euler("xyz", degrees=True).tolist()
    data["frames"] = {"bracket": {"xyz": (_A + moved * _AXIS).tolist(), "rpy_deg": rpy}}
    path = data["tool_path"]
    corners = np.cumsum([leg["by"] for leg in path["legs"]], axis=0).tolist()
    path["from"] = {"frame": "bracket", "xyz": [0.0, 0.0, 0.0], "rpy_deg": _TOOL_RPY_DEG}
    path["legs"] = [
        {"to": {"frame": "bracket", "xyz": corner}, "seconds": leg["seconds"]}
        for corner, leg in zip(corners, path["legs"], strict=True)
    ]
    data["planner"] = {"baseline": "none"}
    return cmbot.load_scene(data | more)


@pytest.fixture(scope="module")
def earlier() -> Plan:
    return cmbot.plan(triangle(), progress=False)


def test_a_moved_frame_is_followed_and_certified(earlier: Plan, tmp_path: Path) -> None:
    scene = triangle(0.02, 1.0)
    plan = cmbot.replan(earlier, scene, progress=False)
    assert plan.certificate.holds and plan.job.certificate.holds
    assert "Planned near an earlier plan" in plan.fallbacks[0]
    # The motion is the earlier one, moved: nothing is optimised, and the tool is as quiet.
    assert plan.passes == () and plan.runs == 1
    assert plan.sway.swing_mm < 1.2 * earlier.sway.swing_mm
    # So is the approach: at the same knots, as they are displaced.
    begun, before = plan.job.segments[0].trajectory, earlier.job.segments[0].trajectory
    assert begun.q.shape == before.q.shape and np.abs(begun.q - before.q).max() < 0.1
    # Nothing is said of a least peak that nothing was sought of.
    assert (plan.lower_bound, plan.choice, plan.torque_floor, plan.torque_floor_kind) == (None,) * 4
    folder = cmbot.save(plan, tmp_path / "plan")
    read = cmbot.load_plan(folder, verify=True, scene=scene)
    # The corners as the scene has them, not as the planner's path does.
    turn = Rotation.from_rotvec(np.deg2rad(1.0) * _AXIS)
    corners = np.array([[0, 0, 0], [0, -1.0, 0], [0, -0.8244, 0.0958], [0, 0, 0]])
    q = read.trajectory.evaluate(np.array([0.0, 10, 12, 20]))
    tool, turned = Kinematics(read.robot).tool_poses(q)
    # The tool that is held to the path is the bent arm's.
    tool += read.sag.at(q).tool
    np.testing.assert_allclose(tool, _A + 0.02 * _AXIS + turn.apply(corners), atol=2e-5)
    asked = turn * Rotation.from_euler("xyz", _TOOL_RPY_DEG, degrees=True)
    off = (asked.inv() * Rotation.from_matrix(turned)).magnitude()
    assert float(off.max()) < 1e-4
    # It stays near the earlier postures: no other branch of the self-motion.
    times = np.linspace(0.0, 20.0, 101)
    assert np.abs(read.trajectory.evaluate(times) - earlier.trajectory.evaluate(times)).max() < 0.2


def test_the_same_scene_is_planned_as_well_again(earlier: Plan) -> None:
    plan = cmbot.replan(earlier, earlier.scene, progress=False)
    assert earlier.lower_bound is not None
    peak = plan.figures.peak_guardrail_torque
    assert peak <= earlier.figures.peak_guardrail_torque * (1 + earlier.options.least_peak_tolerance)
    assert peak >= earlier.lower_bound.value * (1 - 1e-3)


def test_what_is_not_certified_as_it_is_moved_is_changed_until_it_is(earlier: Plan) -> None:
    scene = triangle(0.02, 1.0).with_options(max_tool_deviation_m=1.5e-4)
    plan = cmbot.replan(earlier, scene, progress=False)
    assert "Planned near an earlier plan" in plan.fallbacks[0]
    assert plan.runs == 2 and plan.passes
    assert plan.certificate.holds and plan.figures.max_tool_deviation <= 1.5e-4


def test_another_payload_and_several_strokes(strokes_plan: Plan) -> None:
    scene = strokes_plan.scene
    heavier = scene.with_payload(scene.robot.payload_kg + 0.3)
    plan = cmbot.replan(strokes_plan, heavier, progress=False)
    assert "Planned near an earlier plan" in plan.fallbacks[0]
    assert plan.job.certificate.holds and plan.scene.robot.payload_kg == heavier.robot.payload_kg
    assert [part.name for part in plan.job.strokes] == [stroke.name for stroke in scene.strokes]


def test_where_nothing_leads_on_from_the_earlier_postures_it_is_planned_anew(earlier: Plan) -> None:
    # It began after an approach; now it has to begin in the scene's posture, far from there.
    scene = earlier.scene.with_options(start="pinned")
    plan = cmbot.replan(earlier, scene, progress=False)
    # The scene's posture, but for the sag that is compensated.
    assert plan.start.moved < np.deg2rad(1) < earlier.start.moved
    assert plan.fallbacks[0].startswith("Planned anew, as near the earlier plan none was found: ")
    assert plan.job.certificate.holds and plan.lower_bound is not None


def test_another_arm_or_other_strokes_are_refused(earlier: Plan) -> None:
    with pytest.raises(InputError, match=r"scene\.robot"):
        cmbot.replan(earlier, cmbot.load_scene("panda_sanding"), progress=False)
    with pytest.raises(InputError, match=r"scene\.tool_path"):
        cmbot.replan(earlier, strokes_scene(), progress=False)


def test_arguments_of_another_kind_are_refused(earlier: Plan) -> None:
    scene: Any = _TRIANGLE
    with pytest.raises(InputError, match="scene"):
        cmbot.replan(earlier, scene, progress=False)
    with pytest.raises(InputError, match="plan"):
        cmbot.replan(scene, earlier.scene, progress=False)
