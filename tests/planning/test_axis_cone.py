"""A cone for the tool's axis: it is worth torque, is kept at all times, and is judged apart from the plan."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from forgeries import certified, changed_scene
from plan_folders import edit
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from small_scenes import request_of, short_scene

from cmbot import LimitViolation, load_plan, plan, save
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning import Plan, QuinticTrajectory, initial_guess as guess
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.global_search import GlobalSearch
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Kinematics, ToolBatch
from cmbot.scene import AxisCone, Scene

CONE = np.radians(10)


def scene_of(keep: Any, **planner: Any) -> Scene:
    options = {"knots": "sliding"} | planner
    return short_scene(tool_path={"keep": keep, "via_points": 6}, planner=options)


@pytest.fixture(scope="module")
def leaning() -> Plan:
    return plan(scene_of({"axis_within_deg": 10}))


def tilts(planned: Plan, x: QuinticTrajectory) -> FloatArray:
    """Angles (N,), rad, between the tool's axis and that of the path, by their sine and cosine."""
    R = Kinematics(planned.robot).tool_poses(x.evaluate(np.linspace(x.t[0], x.t[-1], 5001)))[1]
    z, axis = R[:, :, 2], planned.task.path.orientation[:, 2]
    return np.arctan2(np.linalg.norm(np.cross(z, axis), axis=1), z @ axis)


def least_at_rest(planned: Plan, *, leans: bool) -> float:
    """The least torque at rest at the via-point of the lower bound, by SLSQP from postures of the plan."""
    asked, k = request_of(planned.scene), planned.lower_bound.via_point
    goal, limits = asked.goals[[k]], asked.cell.robot.limits

    def at(q: FloatArray) -> ToolBatch:
        return asked.cell.postures.tool_at(q[None])

    def off_task(q: FloatArray) -> FloatArray:
        across = at(q).tool_rotation[0, :, 2] @ goal.rotation[0, :, :2]
        return np.concatenate([at(q).tool_point[0] - goal.point[0], across[: 0 if leans else 2]])

    def inside(q: FloatArray) -> float:
        return float(at(q).tool_rotation[0, :, 2] @ goal.rotation[0, :, 2] - np.cos(CONE))

    found = [
        minimize(
            lambda q: asked.cell.objective.at_rest(asked.cell.postures.at(q[None]))[0] / 100,
            q,
            method="SLSQP",
            bounds=list(zip(limits.lower, limits.upper, strict=True)),
            constraints=[{"type": "eq", "fun": off_task}, {"type": "ineq", "fun": inside}],
        )
        for q in planned.trajectory.q[::2]
    ]
    return min(100 * each.fun for each in found if each.success)


def test_leaning_is_worth_torque(leaning: Plan) -> None:
    assert leaning.figures.peak_guardrail_torque < 0.99 * least_at_rest(leaning, leans=False)
    held = follow_path(request_of(scene_of("axis")), stop_at_obstacles=False)
    np.testing.assert_allclose(leaning.baseline.samples.q, held.q, rtol=0, atol=1e-12)


def test_the_axis_stays_within_the_cone(leaning: Plan) -> None:
    largest = tilts(leaning, leaning.trajectory).max()
    assert 0.9 * CONE < largest <= CONE
    (check,) = (each for each in leaning.certificate.checks if "tilt" in each.quantity)
    assert (check.quantity, check.unit, check.bound) == ("tool tilt", "rad", pytest.approx(CONE))
    assert largest - 1e-9 <= check.value <= largest + 1e-5
    assert leaning.figures.max_tool_rotation == pytest.approx(largest, abs=1e-6)
    assert not any("rotation" in each.quantity for each in leaning.certificate.checks)
    off = Kinematics(leaning.robot).tool_poses(leaning.trajectory.q)[0] - leaning.task.path.position(
        leaning.trajectory.t
    )
    assert np.abs(off).max() < 1e-9


def test_the_lower_bound_is_that_of_the_cone(leaning: Plan) -> None:
    bound, asked = leaning.lower_bound, request_of(leaning.scene)
    assert bound.kind == "estimated"
    rests = asked.cell.objective.at_rest(asked.cell.postures.at(leaning.trajectory.evaluate(asked.times)))
    assert bound.value == bound.each[bound.via_point] <= rests[bound.via_point] * (1 + 1e-9)
    assert abs(leaning.gap_to_floor) < 1e-3
    assert least_at_rest(leaning, leans=True) >= bound.value * (1 - 1e-4)


def test_a_plan_that_rests_lower_lowers_an_estimate(leaning: Plan) -> None:
    bound = leaning.lower_bound
    found = np.full(len(bound.each), 0.9 * bound.value)
    lowered = bound.met(found)
    assert lowered.value == lowered.each[bound.via_point] == 0.9 * bound.value
    assert lowered.value - lowered.error <= bound.value - bound.error + 1e-9
    assert bound.met(2 * found) is bound
    proven = replace(bound, kind="proven")
    assert proven.met(found) is proven


def test_charts_that_lean(leaning: Plan) -> None:
    """They hold the axis at one angle all along the path; their lower bound is of the same cone."""
    asked, angle = request_of(leaning.scene), np.radians(7)
    search = GlobalSearch(asked, Rotation.from_rotvec([0, angle, 0]).as_matrix())
    q = search.first_chart.q[: len(search.first_chart.q) // 2]
    R = asked.cell.postures.tool_at(q).tool_rotation
    assert (asked.task.rotation(R, asked.goals[0]) <= CONE + 1e-9).all()
    assert np.median(asked.task.rotation(R, asked.goals[0])) == pytest.approx(angle, abs=1e-6)
    found, bound = leaning.lower_bound, search.lower_bound
    assert bound.value - bound.error <= found.value <= bound.value * (1 + 1e-3)
    assert found.value - found.error <= bound.value
    solution = search.solve(pinned=False)
    assert solution.peak == pytest.approx(bound.value, rel=1e-3)
    assert (
        asked.task.rotation(asked.cell.postures.tool_at(solution.q).tool_rotation, asked.goals) <= CONE
    ).all()


def test_where_the_middle_of_the_cone_is_blocked_the_axis_leans(monkeypatch: pytest.MonkeyPatch) -> None:
    """In four directions, until a way is found; without a cone there is nothing else to try."""
    tried = list[FloatArray | None]()

    def search(asked: StrokeRequest, lean: FloatArray | None = None, bounded_as: Any = None) -> Any:
        tried.append(lean)
        if len(tried) < found:
            raise asked.path_not_found(f"blocked {len(tried)}", asked.first)
        return SimpleNamespace(solve=lambda *, pinned: "sequence")

    monkeypatch.setattr(guess, "GlobalSearch", search)
    asked, found = request_of(scene_of({"axis_within_deg": 10})), 4
    assert guess.searched(asked)[1] == "sequence"
    assert tried[0] is None
    axes = np.array([lean[:, 2] for lean in tried[1:]])
    np.testing.assert_allclose(np.arccos(axes[:, 2]), 0.7 * CONE, atol=1e-9)
    np.testing.assert_allclose(axes[0, :2] + axes[2, :2], 0, atol=1e-12)
    assert abs(axes[0, :2] @ axes[1, :2]) < 1e-12
    for keep, number in (({"axis_within_deg": 10}, 5), ("axis", 1)):
        tried.clear()
        found = 9
        with pytest.raises(PathNotFound, match="blocked 1"):
            guess.searched(request_of(scene_of(keep)))
        assert len(tried) == number


def test_leaning_postures_beyond_those_near_the_middle_are_found() -> None:
    """The peak is that of a sequence that a sampled programme found: `benchmarks/cones.py`."""
    asked = request_of(
        short_scene(
            robot={"payload_kg": 2.5},
            posture_deg=[159.6, 46.8, 109.8, 44.8, 86.8, 35.0, -99.7],
            tool_path={
                "keep": {"axis_within_deg": 35.3},
                "legs": [{"by": [0.231, -0.048, -0.171], "seconds": 5.1}],
                "via_points": 5,
            },
            planner={"knots": "sliding"},
        )
    )
    known = np.radians(
        [
            [152.75, 128.54, 2.62, -5.95, -131.58, -74.46, -59.34],
            [153.35, 129.41, 3.43, -10.02, -140.84, -77.57, -63.51],
            [152.94, 131.24, 4.51, -15.05, -151.56, -80.89, -67.29],
            [152.82, 132.97, 5.56, -19.25, -161.37, -84.26, -70.93],
            [152.84, 133.67, 6.63, -21.59, -166.98, -87.01, -73.62],
        ]
    )
    point, R = Kinematics(asked.cell.robot).tool_poses(known)[:2]
    np.testing.assert_allclose(point, asked.goals.point, rtol=0, atol=2e-3)
    assert (R[:, :, 2] @ asked.goals.rotation[0, :, 2] >= np.cos(np.radians(35.4))).all()
    # Hundredths of a degree are up to 0.1 mm, and the first posture is at the safety margin.
    margin = asked.cell.options.safety_margin_m - 1e-4
    assert asked.cell.clearances.query(known).distance.min() >= margin
    assert asked.cell.robot.limits.contain(known).all()
    assert asked.cell.strong(asked.cell.postures.at(known)).all()
    least = asked.cell.objective.at_rest(asked.cell.postures.at(known)).max()
    search = guess.searched(asked)[0]
    assert search.solve(pinned=False).peak <= 1.01 * least
    assert search.lower_bound.value <= 1.01 * least


def test_it_is_verified_from_its_directory(leaning: Plan, tmp_path: Path) -> None:
    save(leaning, tmp_path / "plan")
    read = load_plan(tmp_path / "plan", verify=True)
    assert read.scene.strokes[0].keep == AxisCone(axis_within_deg=10)
    assert read.task.cone == pytest.approx(CONE)
    assert any(each.quantity.startswith("tool tilt by a second") for each in read.certificate.checks)


def test_a_forged_plan_that_leaves_the_cone_is_refused(leaning: Plan, tmp_path: Path) -> None:
    """The tool point stays on its path; the hashes are right."""
    save(leaning, tmp_path / "plan")

    def narrowed(scene: dict[str, Any]) -> None:
        scene["tool_path"]["keep"]["axis_within_deg"] = 9.9

    edit(tmp_path / "plan", lambda data: changed_scene(data, narrowed, tmp_path / "plan"))
    assert load_plan(tmp_path / "plan").task.cone == pytest.approx(np.radians(9.9))
    with pytest.raises(LimitViolation, match=r"^tool tilt is 0\.174"):
        load_plan(tmp_path / "plan", verify=True)


def test_a_motion_out_of_the_cone_is_not_certified(leaning: Plan) -> None:
    """Self-motion, with the tool point held, takes the axis out of its cone between two via-points."""
    x, asked = leaning.trajectory, request_of(leaning.scene)
    t = np.sort(np.append(x.t, 0.5 * (x.t[3] + x.t[4])))
    q, v, a = (np.array(each) for each in x.states(t))
    at = asked.cell.postures.tool_at(q[4:5])
    J, axis = at.jacobian[0], asked.task.path.orientation[:, 2]
    turn = np.cross(axis, at.tool_rotation[0, :, 2])
    lean = np.linalg.pinv(J) @ np.concatenate([np.zeros(3), turn / np.linalg.norm(turn)])
    moved, _ = project_onto_task(
        asked.cell.postures, asked.task, q[4:5] + 0.2 * lean, asked.task.path.poses(t[4:5])
    )
    q[4] = moved[0]
    forged = certified(leaning.scene, leaning, QuinticTrajectory(t=t, q=q, v=v, a=a))
    tilt = next(check for check in forged.checks if check.quantity == "tool tilt")
    assert not tilt.holds
    assert tilt.value >= tilts(leaning, QuinticTrajectory(t=t, q=q, v=v, a=a)).max() - 1e-9


def test_the_second_opinion_judges_the_cone_by_itself(leaning: Plan) -> None:
    given: dict[str, Any] = {
        "options": leaning.options,
        "trajectory": leaning.trajectory,
        "robot": leaning.robot,
        "stroke": 0,
    }
    for degrees, expected in ((10, set()), (9, {"tool tilt by a second computation"})):
        scene = leaning.scene.with_path(keep=AxisCone(axis_within_deg=degrees))
        checks = second_opinion(scene, **given)
        assert {check.quantity for check in checks if not check.holds} == expected


def test_fixed_via_points_hold_the_axis() -> None:
    fixed = plan(scene_of({"axis_within_deg": 2}, knots="fixed"))
    assert fixed.lower_bound is None
    at = fixed.trajectory.evaluate(fixed.task.path.via_times(fixed.scene.strokes[0].via_points))
    R = Kinematics(fixed.robot).tool_poses(at)[1]
    assert np.abs(R[:, :, 2] - fixed.task.path.orientation[:, 2]).max() < 1e-9
    assert tilts(fixed, fixed.trajectory).max() <= np.radians(2)
