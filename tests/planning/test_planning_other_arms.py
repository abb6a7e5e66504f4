"""Arms that are not ours: planned from their URDFs, and scenes drawn at random that were hard to plan."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_arms import arm_scene, six_joint_scene

from cmbot import plan
from cmbot.common.errors import OptimisationFailed, PathNotFound
from cmbot.optimization.exchange import ExchangeReport
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import sliding_guess
from cmbot.planning.torque.decomposition import optimise


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
    times = sliding.task.path.via_times(sliding.scene.via_points)
    through = [made.trajectory.evaluate(times) for made in (sliding, fixed)]
    np.testing.assert_allclose(through[0], through[1], rtol=0, atol=1e-6)
    peaks = [made.certificate.figures.peak_guardrail_torque for made in (sliding, fixed)]
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-4)


def test_links_that_are_always_near_each_other_are_named_with_what_to_do(tmp_path: Path) -> None:
    """Links that are no neighbours may be near each other in all postures; an SRDF says that they may."""
    with pytest.raises(PathNotFound, match=r"of panda_link\d, .* robot\.srdf disable the pair") as caught:
        plan(arm_scene(tmp_path, "panda", safety_margin_m=0.08))
    assert caught.value.pair is not None


def test_what_lies_out_of_reach_is_refused_with_what_to_do(tmp_path: Path) -> None:
    scene = arm_scene(tmp_path, "kinova", knots="fixed")
    far = replace(scene, legs=(replace(scene.legs[0], by=(0.0, 3.0, 0.0)),))
    with pytest.raises(PathNotFound, match=r"out of reach .*shorten the leg .* take another posture_deg"):
        plan(far)


PINNED = {"start": "pinned", "solver": "sqp"}


def path_of(keep: str, via_points: int, *legs: tuple[list[float], float]) -> dict[str, object]:
    each = [{"by": by, "seconds": seconds} for by, seconds in legs]
    return {"legs": each, "via_points": via_points, "keep": keep}


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


def test_a_way_that_no_trajectory_follows_is_given_up_soon(tmp_path: Path) -> None:
    """Steps that turn round break accelerations, and no step of the solver does much about it."""
    scene = six_joint_scene(tmp_path, "ur5", *TURNING, **PINNED)
    context = build_context(scene, scene.planner)
    reports: list[ExchangeReport] = []
    with pytest.raises(OptimisationFailed, match="cannot all be met") as caught:
        optimise(sliding_guess(context).problem, reports.append)
    assert "acceleration" in caught.value.constraint
    assert caught.value.violation > 1
    assert len(reports) <= 1
    made = plan(scene)
    assert made.certificate.holds
    assert made.options.step_share < scene.planner.step_share
