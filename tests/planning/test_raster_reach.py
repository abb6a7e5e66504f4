"""What of rasters is reached: rows cut at obstacles and at the arm's reach, and the plan of the rest."""

import copy
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbot import load_plan, load_scene, plan, save
from cmbot.common.errors import PathNotFound
from cmbot.planning import precheck_scene, remarks, robot_of, strokes_of, verdict
from cmbot.planning.budget import Deadline
from cmbot.planning.path.raster_reach import reached_scene
from cmbot.scene import Scene, coverage_of

# In the middle of two rows, 0.08 m wide: the nozzle of 0.3 m does not come near.
BOLT = {"name": "bolt", "box": [0.3, 0.08, 0.08], "xyz": [1.75, 0.4, -2.05]}


def rows(*obstacles: dict[str, Any], **raster: Any) -> Scene:
    data = copy.deepcopy(load_scene("gusset_plate").as_data())
    data["tool_path"]["raster"] |= {"origin": [0, 0, 0.2], "v": [0, 0, -0.1], **raster}
    data["tool_path"]["via_points"] = "auto"
    data["obstacles"] += obstacles
    data["planner"] |= {"knots": "fixed"}
    # Near the first row.
    data["start"] = {"posture_deg": [12, -120, 62, 124, -27, 28, 6]}
    return load_scene({**data, "return": "none"})


def reached(scene: Scene) -> Scene:
    return reached_scene(scene, scene.planner)


def test_what_is_reached_as_a_whole_stays_as_it_is() -> None:
    scene = rows()
    assert reached(scene) is scene


def test_rows_end_where_the_arm_does() -> None:
    far = reached(rows(u=[0, 2.6, 0], v=[0, 0, -0.2], spacing_m=0.2))
    (stroke,) = strokes_of(far, robot_of(far))
    (found,) = coverage_of([stroke]).values()
    assert found.area == pytest.approx(0.52)
    # Torques of joints and of locked ones end it before the arm is stretched.
    robot = robot_of(far)
    away = np.linalg.norm(stroke.path.corners - robot.base_point, axis=1)
    assert 0.6 * robot.reach < away.max() < robot.reach
    assert 0.1 * found.area < found.unreached < 0.4 * found.area


def test_all_or_nothing_is_asked_for() -> None:
    scene = rows(BOLT, cover="all")
    assert reached(scene) is scene
    wall = {"name": "wall", "box": [0.05, 3, 3], "xyz": [1.5, 0.4, -2.05]}
    words = r"no place of tool_path.raster is reached: blocked at .*, at best .* wall, the safety margin"
    with pytest.raises(PathNotFound, match=words):
        reached(rows(wall))


def test_what_the_feet_would_need_is_said_where_nothing_is_reached() -> None:
    """As `cmbot check` says it: a magnet of 500 N holds no arm of 80 kg."""
    scene = load_scene(rows().as_data() | {"guardrail": {"hold": {"kind": "magnet", "adhesion_n": 500}}})
    with pytest.raises(
        PathNotFound,
        match=r"reached: blocked at .*, at best a foot uses \d{3,}% of its hold .*; no magnet",
    ) as caught:
        plan(scene, progress=False)
    used = re.findall(r"a foot uses \d+%", str(caught.value))
    assert used == re.findall(
        r"a foot uses \d+%", " ".join(each.got for each in precheck_scene(scene).warnings)
    )


def test_where_the_time_is_over_that_is_said() -> None:
    scene = rows(spacing_m=0.001)
    out_of_time = Deadline(0.0)
    words = "over before a posture at the first place of the rows was found; cmbot check says why$"
    with pytest.raises(PathNotFound, match=words):
        reached_scene(scene, scene.planner, out_of_time)


def test_a_raster_round_an_obstacle_is_planned_in_two_parts(tmp_path: Path) -> None:
    made = plan(rows(BOLT))
    assert [segment.name for segment in made.job.segments] == ["approach", "work_1", "free_1", "work_2"]
    found = made.coverage["work"]
    # The nozzle's radius and the margin are added to the bolt at both sides.
    assert found.area == pytest.approx(0.04)
    assert 0.1 * 0.08 < found.unreached == pytest.approx(found.left_out)
    assert f"{found.unreached:.3g} of {found.area:.3g} m2 are not reached" in verdict(made)
    assert any("m2 are not reached: where no posture goes on" in line for line in remarks(made))
    # What the check warns of may be why.
    assert "First see" not in verdict(made)
    pulled = replace(made, scene=made.scene.with_values({"tool.process_force_n": [0, 0, 20]}))
    assert "First see tool.process_force_n: [0, 0, 20], which pulls the tool forward" in verdict(pulled)
    assert "area that is not reached, m2" in made.summary()
    # What is left out is drawn: rows about the bolt, at the stand-off.
    lines = np.array(made.rows_left_out)
    np.testing.assert_allclose(lines[..., 0], 1.9 - 0.12, atol=1e-9)
    np.testing.assert_allclose(lines[..., 1].mean(), 0.4, atol=0.05)
    save(made, tmp_path / "plan")
    again = load_plan(tmp_path / "plan", verify=True, scene=rows(BOLT))
    assert again.coverage == made.coverage
