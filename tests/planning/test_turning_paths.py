"""Tool paths that turn, curve and begin elsewhere: planned, certified, and refused where not kept."""

import copy
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from small_scenes import SHORT, off_task, request_of, with_corners

from cmbot import load_plan, load_scene, plan, save
from cmbot.common.errors import LimitViolation, PathNotFound
from cmbot.planning import Plan, remarks
from cmbot.planning.certification.certificate import certify
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.postures.projection import TangentPredictor, project_onto_task
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics
from cmbot.scene import Scene
from cmbot.trajectory import QuinticTrajectory

ABOUT_THE_TOOL = {"centre": [0, 0, 0.15], "axis": [0, 0, 1], "angle_deg": 12, "frame": "tool"}
FOLDED = [26, -146, 43, 161, -84, -112, -55]
PATHS: dict[str, dict[str, Any]] = {
    "turning": {
        "legs": [{"to": {"frame": "tool", "xyz": [0, 0.1, 0], "rpy_deg": [0, 10, 20]}, "seconds": 3}]
    },
    "arc": {
        "legs": [
            {"arc": {**ABOUT_THE_TOOL, "centre": [0, 0.2, 0], "turns": True}, "seconds": 3},
            {"pause": 0.5},
            {"by": [0, -0.05, 0], "seconds": 1.5},
        ]
    },
    "blended": {
        "legs": [{"by": [0, -0.1, 0], "speed_m_s": 0.06}, {"by": [0, 0, 0.1], "speed_m_s": 0.06}],
        "blend_radius_m": 0.04,
    },
}


def scene_of(kind: str, posture: list[float] | None = None, keep: str = "pose", **planner: Any) -> Scene:
    data: dict[str, Any] = {key: copy.deepcopy(SHORT[key]) for key in ("robot", "planner")}
    data["tool_path"] = {"via_points": 16, "keep": keep, **PATHS[kind]}
    data["tool_path"]["speed_profile"] = {"kind": "jerk_limited", "ramp": 0.3}
    data["planner"] |= planner
    start = {"posture_deg": posture} if posture else SHORT["start"]
    return load_scene({"format": "cmbot-scene/2", "name": kind, "start": start, **data})


def broken(scene: Scene, of: Plan, trajectory: QuinticTrajectory | None = None) -> set[str]:
    """Checks of a second opinion that fail."""
    checks = second_opinion(scene, of.options, trajectory or of.trajectory, robot=of.robot, stroke=0)
    return {check.quantity for check in checks if not check.holds}


@pytest.fixture(scope="module", params=PATHS)
def planned(request: pytest.FixtureRequest) -> Plan:
    return plan(scene_of(request.param))


def test_the_tool_is_at_its_timed_poses(planned: Plan) -> None:
    """Between the via-points within the bounds, by the kinematics alone."""
    path, options = planned.task.path, planned.options
    t = np.linspace(0, path.duration, 801)
    p, R = Kinematics(planned.robot).tool_poses(planned.trajectory.evaluate(t))
    goals = path.poses(t)
    away, along = p - goals.point, path.leg_directions(t)
    lag = np.einsum("nd,nd->n", away, along)
    assert np.abs(lag).max() <= options.max_tool_lag_m
    assert np.linalg.norm(away - lag[:, None] * along, axis=1).max() <= options.max_tool_deviation_m + 1e-6
    assert planned.task.rotation(R, goals).max() <= np.radians(options.max_tool_rotation_deg)
    certified = planned.certificate.figures
    assert planned.task.rotation(R, goals).max() <= certified.max_tool_rotation + 1e-9
    assert not broken(planned.scene, planned)


def test_it_is_verified_from_its_directory(planned: Plan, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("turning") / "plan"
    save(planned, folder)
    again = load_plan(folder, verify=True)
    np.testing.assert_array_equal(again.trajectory.q, planned.trajectory.q)
    assert again.scene.content_hash == planned.scene.content_hash


@pytest.mark.parametrize(
    ("kind", "other"),
    [
        ("turning", {"legs": [{"by": [0, 0.1, 0], "seconds": 3}]}),
        ("arc", {"legs": [{"arc": {**ABOUT_THE_TOOL, "centre": [0, 0.2, 0]}, "seconds": 3}]}),
        ("blended", {"legs": PATHS["blended"]["legs"]}),
    ],
)
def test_a_motion_along_another_path_is_refused(
    kind: str, other: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a tool that keeps its orientation, does not turn with the arc, or goes round the corner."""
    whole = scene_of(kind)
    monkeypatch.setitem(
        PATHS, kind, {**other, "legs": [*other["legs"], *PATHS[kind]["legs"][len(other["legs"]) :]]}
    )
    made = plan(scene_of(kind))
    asked = request_of(whole)
    with pytest.raises(LimitViolation):
        certify(
            asked.cell.robot,
            asked.task,
            made.trajectory,
            asked.cell.clearances,
            asked.cell.options,
            via_points=16,
        ).require()
    assert broken(whole, made)


def test_gradient_projection_turns_the_tool() -> None:
    asked = request_of(scene_of("turning"))
    path = follow_path(asked)
    goals = asked.task.path.poses(path.t)
    assert off_task(asked.cell.robot, asked.task, path.q, goals) < 1e-3
    assert path.drift.max() < 1e-4


@pytest.mark.parametrize("keep", ["pose", "axis", "position"])
def test_predictions_follow_a_turning_tool(keep: str) -> None:
    """The error falls with the square of the step."""
    asked = request_of(scene_of("turning", keep=keep))
    postures, task, path = asked.cell.postures, asked.task, asked.task.path
    q, reached = project_onto_task(postures, task, asked.state.posture[None], path.poses([1.0]), steps=50)
    assert reached.all()
    predictor = TangentPredictor.of(postures, task, q, path.poses([1.0]))

    def error(step: float) -> float:
        goals = path.poses([1.0 + step])
        return off_task(asked.cell.robot, task, predictor.towards(goals), goals)

    assert error(0.02) < 0.3 * error(0.04)
    assert error(0.02) < 1e-3


def elsewhere(begin: dict[str, Any], **planner: Any) -> Scene:
    scene = scene_of("blended", FOLDED, **planner)
    data = scene.as_data()
    data["tool_path"]["from"] = begin
    return load_scene(data)


BEGIN = {"xyz": [1.75, 0.7, -2.0], "axis": [0.8, 0, -0.6]}


@cache
def begun_elsewhere(knots: str) -> Plan:
    return plan(elsewhere(BEGIN, knots=knots))


@pytest.mark.parametrize("knots", ["sliding", "fixed"])
def test_a_path_that_begins_elsewhere_has_an_approach(knots: str, tmp_path_factory: Any) -> None:
    made = begun_elsewhere(knots)
    assert made.approach is not None
    np.testing.assert_allclose(made.approach.trajectory.q[0], np.radians(FOLDED), atol=1e-12)
    np.testing.assert_allclose(made.approach.trajectory.q[-1], made.trajectory.q[0], atol=1e-12)
    p, R = (x[0] for x in Kinematics(made.robot).tool_poses(made.trajectory.q[:1]))
    np.testing.assert_allclose(p, BEGIN["xyz"], atol=1e-6)
    np.testing.assert_allclose(R[:, 2], BEGIN["axis"], atol=1e-6)
    assert "Starts where the tool path begins" in " ".join(remarks(made))
    folder = tmp_path_factory.mktemp("elsewhere") / "plan"
    save(made, folder)
    assert load_plan(folder, verify=True).certificate.holds
    assert not broken(elsewhere(BEGIN, knots=knots), made)


def test_a_beginning_out_of_reach_is_no_path() -> None:
    with pytest.raises(PathNotFound, match=r"tool_path.from lies .* out of reach \(the arm"):
        plan(elsewhere({"xyz": [9, 0, 0]}))
    asked = request_of(scene_of("turning"))
    far = with_corners(asked.task.path, asked.task.path.corners + np.array([9.0, 0, 0]))
    with pytest.raises(
        PathNotFound, match=r"the path begins out of reach at \(.*\) m: no posture .* mm and .* deg off"
    ):
        starting_at_path(replace(asked, task=replace(asked.task, path=far)))


def test_a_stored_plan_of_another_beginning_is_refused(tmp_path_factory: pytest.TempPathFactory) -> None:
    made = begun_elsewhere("fixed")
    moved = elsewhere({**BEGIN, "xyz": [1.75, 0.71, -2.0]}, knots="fixed")
    folder = tmp_path_factory.mktemp("forged") / "plan"
    save(replace(made, scene=moved), folder)
    with pytest.raises(LimitViolation, match=r"of the tool from its place at a via-point is 0\.01 m"):
        load_plan(folder, verify=True)
