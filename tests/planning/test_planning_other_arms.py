"""Arms that are not ours are planned from their URDFs, with sliding knots and without self-motion, too."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from urdf_arms import arm_scene

from cmbot import plan
from cmbot.common.errors import PathNotFound


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
