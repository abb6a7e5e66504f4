"""``robot.range_margin_deg``: joints keep from the ends of their ranges, planned and verified."""

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.limit import Limit
from cmbot.planning import robot_of
from cmbot.robot import JointLimits


def test_joints_keep_from_the_ends_of_their_ranges() -> None:
    scene = short_scene()
    limits = robot_of(scene).limits

    def distance(q: np.ndarray) -> float:
        """How near joints come to an end, rad."""
        return float(np.minimum(q - limits.lower, limits.upper - q).min())

    margin = 0.99 * distance(scene.posture)
    made = cmbot.plan(short_scene(robot={"range_margin_deg": np.degrees(margin)}), progress=False)
    assert min(distance(samples.q) for samples in made.segment_samples.values()) >= margin - 1e-9
    positions = [check for check in made.certificate.checks if check.limit is Limit.POSITION]
    assert positions
    assert all(check.holds for check in positions)


def test_a_plan_with_it_is_verified(tmp_path) -> None:
    scene = short_scene(robot={"range_margin_deg": 3})
    folder = cmbot.save(cmbot.plan(scene, progress=False), tmp_path / "plan")
    assert cmbot.load_plan(folder, verify=True, scene=scene).certificate.holds
    with pytest.raises(cmbot.ArchiveError):
        cmbot.load_plan(folder, verify=True, scene=short_scene())


def test_turning_and_sliding_joints_have_margins_of_their_own() -> None:
    each = {name: np.ones(2) for name in ("velocity", "acceleration", "jerk", "torque")}
    limits = JointLimits(
        lower=np.array([-1.0, 0.0]), upper=np.array([1.0, 0.5]), prismatic=np.array([False, True]), **each
    )
    narrow = limits.narrowed(0.25, 0.1)
    np.testing.assert_allclose([narrow.lower, narrow.upper], [[-0.75, 0.1], [0.75, 0.4]])
    with pytest.raises(cmbot.InputError, match=r"more than half the range of joint 2, 0 to 0.5 m"):
        limits.narrowed(0.0, 0.3)


def test_a_margin_that_leaves_nothing_is_refused() -> None:
    with pytest.raises(
        cmbot.SceneError, match=r"robot\.range_margin_deg: got more than half the range of joint "
    ):
        robot_of(short_scene(robot={"range_margin_deg": 180}))
