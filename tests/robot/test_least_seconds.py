"""In less time than that no motion from rest to rest moves the tool so far."""

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import PathNotFound
from cmbot.planning import plan, precheck_scene, robot_of
from cmbot.robot import Kinematics


@pytest.mark.parametrize("name", ["triangle", "panda_sanding"])
def test_the_fastest_moves_of_all_joints_lead_no_further(name: str) -> None:
    """Bang-bang jerks of each joint, in phase, scaled to the acceleration and velocity limits."""
    robot = robot_of(cmbot.load_scene(name))
    limits, rng = robot.limits, np.random.default_rng(5)
    s = np.linspace(0, 1, 801)
    jerk = np.where((s < 0.25) | (s >= 0.75), 1.0, -1.0)
    for seconds in (0.3, 0.8, 2.0):
        t = seconds * s
        a, v, way = jerk, jerk, jerk
        a = np.concatenate([[0.0], np.cumsum(jerk[:-1] * np.diff(t))])
        v = np.concatenate([[0.0], np.cumsum(0.5 * (a[1:] + a[:-1]) * np.diff(t))])
        way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
        scale = np.min([limits.jerk, limits.acceleration / a.max(), limits.velocity / v.max()], axis=0)
        for _ in range(10):
            q = rng.uniform(limits.lower, limits.upper) + np.outer(
                way, scale * rng.choice([-1, 1], robot.dof)
            )
            points = np.array([Kinematics(robot).tool_pose(each).translation for each in q])
            moved = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
            assert robot.least_seconds(moved) <= 1.001 * seconds
    lengths = np.geomspace(0.01, 5.0, 9)
    assert np.all(np.diff([robot.least_seconds(length) for length in lengths]) > 0)


def test_seconds_that_no_motion_keeps_are_refused_before_any_search() -> None:
    legs = [{"by": [0, -0.9, 0], "seconds": 0.4}]
    hasty = short_scene(tool_path={"legs": legs})
    least = robot_of(hasty).least_seconds(0.9)
    said = rf"legs\[0\].seconds: got 0.9 m in 0.4 s, expected seconds: auto; in less than {least:.3f} s "
    with pytest.raises(PathNotFound, match=said):
        plan(hasty)
    (found,) = (each for each in precheck_scene(hasty).warnings if each.key.endswith("seconds"))
    assert found.got == "0.9 m in 0.4 s"


@pytest.mark.parametrize(
    ("path", "key"),
    [
        (
            {
                "legs": [
                    {"by": [0, -0.4, 0], "speed_m_s": 9},
                    {"pause": 0.01},
                    {"by": [0, 0.5, 0], "speed_m_s": 90},
                ]
            },
            "tool_path.legs[2].speed_m_s",
        ),
        ({"legs": [{"by": [0, -0.9, 0], "seconds": 0.4}], "blend_radius_m": 0.01}, "tool_path.legs"),
    ],
)
def test_the_fastest_leg_is_named_by_a_key_that_is_in_the_file(path: dict[str, object], key: str) -> None:
    (found,) = (
        each for each in precheck_scene(short_scene(tool_path=path)).warnings if "no arm of" in each.expected
    )
    assert found.key == key
