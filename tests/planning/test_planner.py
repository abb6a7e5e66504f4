"""Plans from scene to certificate: the paper's two, variants of a short one, another arm."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene
from urdf_arms import PANDA_JOINTS, arm_scene, path_of, scene_data, six_joint_scene

from cmbot.common.errors import InputError, LimitViolation, OptimisationFailed, PathNotFound, SceneError
from cmbot.optimization.exchange import ExchangeReport
from cmbot.planning import Plan, plan
from cmbot.planning.attempts import motion
from cmbot.planning.torque.decomposition import Optimised
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.robot import Kinematics
from cmbot.scene import load_scene


def check_promises(planned: Plan) -> None:
    assert planned.certificate.holds
    use = planned.figures.limit_use
    assert max(use.velocity, use.acceleration, use.jerk, use.torque) <= 1
    assert planned.figures.min_clearance >= planned.options.safety_margin_m
    assert planned.figures.max_tool_deviation <= planned.options.max_tool_deviation_m
    trajectory, task, kinematics = planned.trajectory, planned.task, Kinematics(planned.robot)
    assert len(trajectory.t) == planned.scene.strokes[0].via_points
    assert trajectory.duration == pytest.approx(sum(leg.seconds for leg in planned.scene.strokes[0].legs))
    # Where sag is compensated the bent arm's tool is at its place, to a share of what it may deviate.
    on_place = 1e-9 if planned.sag is None else 0.05 * planned.options.max_tool_deviation_m
    for q, goal in zip(trajectory.q, task.path.poses(trajectory.t), strict=True):
        tool = kinematics.tool_pose(q)
        if planned.sag is not None:
            tool.translation = tool.translation + planned.sag.at(q[None]).tool[0]
        assert np.abs(task.error(tool, goal)).max() < on_place
    # Sampled again at other times, apart from the certificate.
    samples = planned.samples
    assert samples.t[-1] == pytest.approx(trajectory.duration)
    limits = planned.robot.limits
    for value, bound in (
        (samples.v, limits.velocity),
        (samples.a, limits.acceleration),
        (samples.j, limits.jerk),
        (samples.joint_torque, limits.torque),
    ):
        assert (np.abs(value) <= bound).all()
    assert (samples.q >= limits.lower).all()
    assert (samples.q <= limits.upper).all()


def test_what_is_no_scene_is_refused() -> None:
    with pytest.raises(InputError, match=r"cmbot\.load_scene"):
        plan("triangle")  # type: ignore[arg-type]


def test_triangle_with_fixed_knots(fixed_triangle_plan: Plan) -> None:
    """They gain nothing: the peak is the weight in the posture at the start, where every motion rests."""
    check_promises(fixed_triangle_plan)
    baseline, planned = fixed_triangle_plan.baseline.figures, fixed_triangle_plan.figures
    assert baseline.peak_static_guardrail_torque == pytest.approx(486.41, abs=0.01)
    assert planned.peak_static_guardrail_torque == pytest.approx(486.41, abs=0.01)
    assert planned.peak_guardrail_torque == pytest.approx(486.41, abs=0.01)
    assert fixed_triangle_plan.peak_static_reduction == pytest.approx(0, abs=1e-5)
    assert baseline.mean_guardrail_torque == pytest.approx(407, abs=2)
    assert fixed_triangle_plan.start.moved == 0
    assert fixed_triangle_plan.baseline.drift < 1e-4
    assert 0.1 < fixed_triangle_plan.baseline.smallest_singular_value < 1
    seconds = fixed_triangle_plan.seconds
    laps = (seconds.path, seconds.optimise, seconds.certify)
    assert min(laps) > 0
    assert sum(laps) == pytest.approx(seconds.total, rel=0.05)


def test_line_with_fixed_knots(fixed_line_plan: Plan) -> None:
    """It has to start elsewhere, which also lowers the torque."""
    check_promises(fixed_line_plan)
    assert fixed_line_plan.baseline.figures.peak_static_guardrail_torque == pytest.approx(577.6, abs=0.1)
    assert fixed_line_plan.peak_static_reduction > 0.1
    assert fixed_line_plan.start.moved > 0


def test_the_papers_scenes_are_quiet(triangle_plan: Plan, line_plan: Plan) -> None:
    """In the paper's seconds, whatever the stiffness within 30 %."""
    for planned, most in ((triangle_plan, 0.021), (line_plan, 0.001)):
        assert planned.sway is not None and planned.sway.stiffness_share == 0.3
        assert planned.sway.swing_mm <= most


def test_triangle_with_sliding_knots(triangle_plan: Plan) -> None:
    """The gain is the posture's; gravity's part hardly undercuts the floor."""
    check_promises(triangle_plan)
    assert triangle_plan.options.knots == "sliding"
    baseline, planned = triangle_plan.baseline.figures, triangle_plan.figures
    assert baseline.peak_static_guardrail_torque == pytest.approx(486.41, abs=0.01)
    assert planned.peak_static_guardrail_torque == pytest.approx(383.8, rel=0.01)
    assert triangle_plan.peak_static_reduction == pytest.approx(0.211, abs=0.01)


def test_two_runs_are_one(short_plan: Plan) -> None:
    """Not a bit of difference, although the second run finds warm memories."""
    first, second = short_plan, plan(short_plan.scene)
    for name in "tqva":
        np.testing.assert_array_equal(getattr(first.trajectory, name), getattr(second.trajectory, name))
    assert first.certificate == second.certificate
    assert first.passes == second.passes
    for name in ("q", "v", "guardrail_torque", "clearance"):
        np.testing.assert_array_equal(
            getattr(first.baseline.samples, name), getattr(second.baseline.samples, name)
        )


def test_options_in_place_of_the_scenes() -> None:
    scene = short_scene()
    wide = plan(scene, options=replace(scene.planner, max_tool_deviation_m=0.004))
    assert wide.options.max_tool_deviation_m == 0.004
    assert scene.planner.max_tool_deviation_m == 0.0002
    assert {c.quantity: c.bound for c in wide.certificate.checks}["tool deviation"] == 0.004


UP_AND_ASIDE = [{"by": [0, -0.2, 0], "seconds": 3}, {"by": [-0.15, 0, 0.05], "seconds": 3}]
VARIANTS: dict[str, dict[str, Any]] = {
    "keep axis": {"tool_path": {"keep": "axis"}},
    "keep position": {"tool_path": {"keep": "position"}},
    "jerk limited": {"tool_path": {"speed_profile": {"kind": "jerk_limited", "ramp": 0.4}}},
    "tool length": {"robot": {"tool_length_m": 0.4}},
    "fewest via-points": {"tool_path": {"via_points": 5, "legs": [{"by": [0, -0.1, 0], "seconds": 4}]}},
    "many via-points": {"tool_path": {"via_points": 31, "legs": [{"by": [0, -0.3, 0], "seconds": 9}]}},
    "two legs": {"tool_path": {"legs": UP_AND_ASIDE, "via_points": 14}},
    "switch": {"planner": {"avoidance": "switch"}},
    "centre of gravity": {"planner": {"centre_of_gravity_weight": 0.1}},
    "no guardrail to hit": {"guardrail": {"bays": 0}},
    "little smoothing": {"planner": {"smoothing_weight": 1e-5}},
    "coarse samples": {"planner": {"samples_per_segment": 20}},
    "sliding knots": {"planner": {"knots": "sliding"}},
    "sliding knots, pinned start": {"planner": {"knots": "sliding", "start": "pinned"}},
    "an obstacle near by": {
        "obstacles": [{"name": "plate", "box": [0.5, 0.02, 0.5], "xyz": [2.3, 0.5, -2.06]}]
    },
}


@pytest.mark.parametrize("changes", VARIANTS.values(), ids=VARIANTS.keys())
def test_variants(changes: dict[str, Any]) -> None:
    check_promises(plan(short_scene(**changes)))


def test_payload_adds_its_weight(short_plan: Plan) -> None:
    loaded, q = plan(short_scene(robot={"payload_kg": 2.0})), short_plan.trajectory.q[0]
    check_promises(loaded)
    np.testing.assert_array_equal(loaded.trajectory.q[0], q)
    point = Kinematics(short_plan.robot).tool_pose(q).translation
    more = loaded.samples.guardrail_torque[0] - short_plan.samples.guardrail_torque[0]
    np.testing.assert_allclose(more, np.cross(point, [0, 0, -2 * 9.81]), rtol=0, atol=1e-6)


def test_what_does_not_hold_is_no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    """The certificate has the last word: an optimiser that cheats is caught."""
    honest = motion.optimise

    def cheating(*arguments: Any, **more: Any) -> Any:
        optimised = honest(*arguments, **more)
        a = optimised.trajectory.a.copy()
        a[3] += 1e-3
        return replace(optimised, trajectory=replace(optimised.trajectory, a=a))

    monkeypatch.setattr(motion, "optimise", cheating)
    with pytest.raises(LimitViolation, match="jump of a joint's"):
        plan(short_scene())


@pytest.mark.parametrize(
    ("posture", "message"),
    [
        ([0, 0, 0], r"start.posture_deg: got 3 numbers, expected 7 finite joint angles"),
        (
            [-10, -90, 170, 0, 10, 50, 0],
            r"start.posture_deg\[2\]: got 170 deg, expected joint_3 within its range",
        ),
    ],
)
def test_posture_that_does_not_fit(posture: list[float], message: str) -> None:
    with pytest.raises(SceneError, match=message):
        plan(short_scene(posture_deg=posture))


@pytest.fixture
def panda(tmp_path: Path) -> dict[str, Any]:
    """A Panda upside down below the walkway, on a slanted mount."""
    path = {"legs": [{"by": [0.05, 0.1, 0.1], "seconds": 4}], "via_points": 8}
    mount = {"xyz": [0.2, 0.4, -0.3], "rpy_deg": [170, 10, 30]}
    posture = [0, -45, 0, -135, 0, 90, 45]
    data = scene_data(tmp_path, "panda", posture, path, mount, knots="fixed", path_step_s=0.02)
    return data | {"guardrail": {"bays": 0}}


def test_another_arm(panda: dict[str, Any]) -> None:
    planned = plan(load_scene(panda))
    check_promises(planned)
    assert planned.robot.joints == PANDA_JOINTS
    assert planned.start.moved == 0
    step = planned.samples.tool_point[-1] - planned.samples.tool_point[0]
    np.testing.assert_allclose(step, [0.05, 0.1, 0.1], rtol=0, atol=1e-9)


def test_another_arm_with_a_wrong_frame(panda: dict[str, Any]) -> None:
    panda["robot"]["tool_frame"] = "panda_thumb"
    with pytest.raises(SceneError, match=r"robot\.tool_frame: got 'panda_thumb', expected a link"):
        plan(load_scene(panda))


@pytest.mark.parametrize(
    ("arm", "keep"), [("kinova", "pose"), ("kinova", "axis"), ("panda", "pose")], ids=str
)
def test_planned_with_sliding_knots(tmp_path: Path, arm: str, keep: str) -> None:
    made = plan(arm_scene(tmp_path, arm, keep))
    assert made.certificate.holds
    assert 0 <= made.lower_bound.error <= made.lower_bound.value
    at_rest = made.certificate.figures.peak_static_guardrail_torque
    assert made.lower_bound.value - made.lower_bound.error <= at_rest * (1 + 1e-3)


def test_six_joints_that_hold_a_pose_have_one_way_to_go(tmp_path: Path) -> None:
    """From the scene's posture the tool's poses prescribe the via-points, whether they could slide or not."""
    sliding, fixed = (
        plan(arm_scene(tmp_path, "kinova", knots=knots, start="pinned")) for knots in ("sliding", "fixed")
    )
    times = sliding.task.path.via_times(sliding.scene.strokes[0].via_points)
    through = [made.trajectory.evaluate(times) for made in (sliding, fixed)]
    np.testing.assert_allclose(through[0], through[1], rtol=0, atol=1e-6)
    peaks = [made.certificate.figures.peak_guardrail_torque for made in (sliding, fixed)]
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-4)


def test_links_that_are_always_near_each_other_are_named_with_what_to_do(tmp_path: Path) -> None:
    """Links that are no neighbours may be near each other in all postures; an SRDF says that they may."""
    # The arm's own SRDF, which lies beside its URDF, disables such pairs.
    bare = tmp_path / "bare.srdf"
    bare.write_text('<robot name="panda"/>', encoding="utf-8")
    scene = arm_scene(tmp_path, "panda", safety_margin_m=0.08)
    scene = scene.changed(robot=scene.robot.changed(srdf=bare))
    with pytest.raises(PathNotFound, match=r"of panda_link\d, .* robot\.srdf can disable the pair") as caught:
        plan(scene)
    assert caught.value.pair is not None


def test_what_lies_out_of_reach_is_refused_with_by_how_much(tmp_path: Path) -> None:
    scene = arm_scene(tmp_path, "kinova", knots="fixed")
    far = scene.with_path(legs=(replace(scene.strokes[0].legs[0], by=(0.0, 3.0, 0.0)),))
    with pytest.raises(PathNotFound, match=r"m out of reach \(the arm with its tool .* m long, in metres\)$"):
        plan(far)


PINNED = {"start": "pinned", "solver": "sqp"}


SETTING_OFF = (
    [-15, -22, 27, 51, 29, -16],
    path_of("axis", 15, ([-0.132, -0.057, 0.065], 5.3), ([0.012, -0.057, 0.125], 5.8)),
)
TURNING = (
    [-104, 45, 111, 26, 8, 119],
    path_of("axis", 25, ([-0.11, 0.14, 0.046], 4.7), ([-0.092, 0.109, 0.108], 5.4)),
)


def test_an_arm_that_cannot_set_off_without_more_torque_than_at_rest(tmp_path: Path) -> None:
    """The peak at rest is that of the start, which stays; to get away from there the arm asks more."""
    made = plan(six_joint_scene(tmp_path, "ur5", *SETTING_OFF, **PINNED))
    assert made.certificate.holds
    assert made.start.moved == 0
    assert made.options.step_share == made.scene.planner.step_share
    at_rest = made.certificate.figures.peak_static_guardrail_torque
    assert at_rest < made.certificate.figures.peak_guardrail_torque < 1.01 * at_rest
    assert {"peak", "mean square"} == {report.stage for report in made.passes}


def test_a_way_that_no_trajectory_follows_is_given_up_soon(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps that turn round break accelerations and jerks, and no step of the solver does much about it."""
    scene = six_joint_scene(tmp_path, "ur5", *TURNING, **PINNED)
    failures, reports = list[OptimisationFailed](), list[ExchangeReport]()
    whole = motion.optimise

    def optimise(problem: TorqueProblem, told: object, **more: bool) -> Optimised:
        try:
            return whole(problem, None if failures else reports.append, **more)
        except OptimisationFailed as failure:
            failures.append(failure)
            raise

    monkeypatch.setattr(motion, "optimise", optimise)
    made = plan(scene)
    # By the rounding of some processors (an AMD EPYC's) the first one misses by the tool's rotation, and more
    # follow before fewer via-points lead on from the scene's posture.
    later = failures[1:]
    assert all("cannot all be met" in str(each) and each.violation > 0.01 for each in failures)
    assert {each.constraint.split()[0] for each in later or failures} <= {"acceleration", "jerk"}
    # By the rounding of some processors (OPENBLAS_CORETYPE=Haswell) the first solver run uses up its 60
    # iterations before that is seen, which the second sees at once.
    assert len(reports) <= 2
    assert sum(report.iterations for report in reports) <= 120
    assert made.certificate.holds
    # From another start: near the scene's posture the wrist turns round too fast.
    fewer = made.scene.strokes[0].via_points < scene.strokes[0].via_points
    assert fewer if later else made.start.moved > 0
    assert made.start.failures
