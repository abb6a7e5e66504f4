"""`cmbot.locate`: poses from touched places, against displacements that are known."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from locating import FRAME, WITHIN, drawn, features, measured, squares
from scipy.spatial.transform import Rotation
from small_scenes import short_scene

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.sag import Sag
from cmbot.identification import (
    Feature,
    features_to_touch,
    located,
    location_remarks,
    read_touches,
)
from cmbot.identification.location import expected_covariance
from cmbot.planning import bending_arm, robot_of
from cmbot.robot import Kinematics
from cmbot.scene import Scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return short_scene(frames=FRAME)


@pytest.mark.parametrize(("kind", "count"), [("point", 3), ("plane", 18), ("edge", 6), ("cylinder", 9)])
def test_exact_touches_give_the_pose(scene: Scene, kind: str, count: int) -> None:
    rng = np.random.default_rng(count)
    xi = drawn(rng)
    found = located(measured(scene, features(kind, rng, count), xi, rng, noise=0.0))
    np.testing.assert_allclose(found.moved[:3], xi[:3], atol=2e-5)
    np.testing.assert_allclose(found.moved[3:], xi[3:], atol=2e-4)
    X, touched = scene.frame_poses["bracket"], features(kind, np.random.default_rng(0), count)
    np.testing.assert_allclose(found.X_WF[:3, :3], pin.exp3(found.moved[3:]) @ X[:3, :3], atol=1e-12)
    # The frame carries what was touched to where it is.
    if kind == "point":
        middle = np.mean([feature.point for feature in touched], axis=0)
        now, was = (pose[:3, 3] + pose[:3, :3] @ middle for pose in (found.X_WF, X))
        np.testing.assert_allclose(now - was, xi[:3], atol=2e-5)
    assert found.left_out == ()


@pytest.mark.parametrize(("kind", "count"), [("point", 4), ("plane", 7)])
def test_the_truth_is_in_its_region_as_often_as_is_said(scene: Scene, kind: str, count: int) -> None:
    """12.59 is the 95 % quantile of chi square with 6 degrees of freedom; 100 draws have 2 % of scatter."""
    inside = np.mean([square < WITHIN for square, _ in squares(scene, kind, count, 100)])
    assert 0.90 <= inside <= 0.99


@pytest.mark.parametrize("seed", [7, 21])
def test_the_covariance_is_that_of_the_posterior(scene: Scene, seed: int) -> None:
    """By a random walk (Metropolis, 1953), one touch on each face of a box: linearised it is too small."""
    rng = np.random.default_rng(seed)
    touches = measured(scene, features("plane", rng, 6), drawn(rng), rng)
    found, X = located(touches), scene.frame_poses["bracket"]
    on, normal = (np.array([getattr(each, name) for each in touches.features]) for name in ("point", "axis"))
    on, normal = on @ X[:3, :3].T + X[:3, 3], normal @ X[:3, :3].T
    middle = on.mean(axis=0)

    def log_density(xi: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(-xi[:, 3:]).as_matrix() @ (touches.places - middle - xi[:, None, :3]).mT
        off = ((turned.mT + middle - on) * normal).sum(axis=2)
        prior = np.square(xi[:, :3] / 0.02).sum(axis=1) + np.square(xi[:, 3:] / np.radians(2)).sum(axis=1)
        return -0.5 * (np.square(off / 3e-4).sum(axis=1) + prior)

    step = np.linalg.cholesky(found.covariance).T
    xi = found.moved + rng.normal(size=(200, 6)) @ step
    density, visited = log_density(xi), list[FloatArray]()
    for _ in range(2000):
        other = xi + 0.8 * rng.normal(size=xi.shape) @ step
        there = log_density(other)
        moves = np.log(rng.uniform(size=len(xi))) < there - density
        xi[moves], density[moves] = other[moves], there[moves]
        visited.append(xi - found.moved)
    each = np.concatenate(visited[500:]) @ np.linalg.inv(step)
    np.testing.assert_allclose(each.T @ each / len(each), np.eye(6), atol=0.15)


def test_a_touch_of_another_corner_is_left_out(scene: Scene) -> None:
    rng = np.random.default_rng(5)
    xi, each = drawn(rng), features("point", rng, 8)
    touches = measured(scene, each, xi, rng)
    touches.places[3] += [0.0, 0.03, 0.0]
    found = located(touches)
    assert found.left_out == (3,)
    np.testing.assert_allclose(found.moved[:3], xi[:3], atol=2e-3)
    assert any(line.startswith("touches[3] is ") for line in location_remarks(found, touches))


@pytest.mark.parametrize(("wrong", "axis", "by"), [(0, 2, 0.6), (1, 1, 0.6), (2, 1, -0.6), (3, 0, 1.2)])
def test_a_gross_mistake_is_left_out_alone(scene: Scene, wrong: int, axis: int, by: float) -> None:
    """Four corners of a plate, one with a wrong coordinate, which draws the linear fit to it."""
    rng = np.random.default_rng(9)
    corners = [np.array([0.0, y, z]) for y in (0.0, 0.4) for z in (0.0, 0.3)]
    each = [Feature(kind="point", point=corner, axis=np.zeros(3)) for corner in corners]
    xi = drawn(rng)
    touches = measured(scene, each, xi, rng)
    touches.places[wrong, axis] += by
    found = located(touches)
    assert found.left_out == (wrong,)
    np.testing.assert_allclose(found.moved[:3], xi[:3], atol=2e-3)


def test_where_half_of_them_do_not_fit_nothing_is_said(scene: Scene) -> None:
    rng = np.random.default_rng(6)
    touches = measured(scene, features("point", rng, 6), drawn(rng), rng)
    touches.places[:] += 0.2 * rng.normal(size=(6, 3))
    with pytest.raises(InputError, match=r"[3-6] of 6 do not, more than a third"):
        located(touches)


def test_directions_that_touches_do_not_fix_are_named_and_keep_their_prior(scene: Scene) -> None:
    """Three places on one plane: neither a shift along it nor a turn about its normal is seen."""
    level = short_scene(frames={"bracket": {"xyz": [1.8, 0.3, -2.0], "rpy_deg": [0, 0, 0]}})
    rng = np.random.default_rng(8)
    plane = Feature(kind="plane", point=np.zeros(3), axis=np.array([0.0, 0.0, 1.0]))
    touches = measured(level, 5 * [plane], np.zeros(6), rng)
    found = located(touches)
    assert set(found.not_fixed) <= {"along x", "along y", "along x and along y", "about z"}
    assert any("about z" in name for name in found.not_fixed)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(0.02, rel=0.05)
    assert np.sqrt(found.covariance[2, 2]) < 1e-3
    assert any(line.startswith("Not fixed by these touches: ") for line in location_remarks(found, touches))


def test_postures_are_those_of_the_bent_arm(scene: Scene) -> None:
    posture = [-10, -90, 90, 0, 10, 50, 0]
    file = {
        "format": "cmbot-touches/1",
        "scene": "triangle",
        "touches": [{"posture_deg": posture, "point": [0, 0, 0]}],
    }
    touches = read_touches(file, scene)
    assert touches.frame == "bracket"
    robot = robot_of(scene)
    arm, q = bending_arm(scene, robot), np.radians([posture])
    assert arm is not None
    bent = Kinematics(robot).tool_poses(q)[0] + Sag(arm).at(q).tool
    np.testing.assert_allclose(touches.places, bent, atol=1e-9)


def test_csv_is_known_by_its_columns(scene: Scene, tmp_path: Path) -> None:
    rng = np.random.default_rng(9)
    xi, each = drawn(rng), [*features("point", rng, 3), *features("plane", rng, 6)]
    touches = measured(scene, each, xi, rng)
    lines = ["x,y,z,px,py,pz,nx,ny,nz"]
    for place, feature in zip(touches.places, each, strict=True):
        normal = feature.axis if feature.kind == "plane" else ["", "", ""]
        lines.append(",".join(map(str, [*place, *feature.point, *normal])))
    file = tmp_path / "points.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = cmbot.locate(file, scene)
    np.testing.assert_allclose(found.moved, located(touches).moved, atol=1e-6)
    with pytest.raises(InputError, match="names none"):
        cmbot.locate(file)
    # What is the matter with a row is told by its line.
    touches = read_touches(file, scene)
    touches.places[3] += [0.0, 0.0, 0.5]
    (left_out,) = (
        line for line in location_remarks(located(touches), touches) if "unlike the others" in line
    )
    assert left_out.startswith("line 5 is ")
    lines[2] = ",".join(map(str, [1e6, 0, 0, *each[1].point, "", "", ""]))
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"line 3, place\[0\]: got "):
        cmbot.locate(file, scene)


@pytest.mark.parametrize(
    ("touch", "said"),
    [
        ({"place": [0, 0, 0]}, "exactly one of point, plane, edge, cylinder"),
        ({"point": [0, 0, 0]}, "exactly one of posture_deg, posture, place"),
        ({"posture_deg": [1, 2], "point": [0, 0, 0]}, "7, one for each joint"),
        (
            {"posture": [-10, -90, 90, 0, 10, 50, 0], "point": [0, 0, 0]},
            r"touches\[0\]\.posture: got joint_1 at -10 rad, expected the joint's range, .*; degrees\?",
        ),
        (
            {"posture_deg": [-10, -90, 290, 0, 10, 50, 0], "point": [0, 0, 0]},
            r"touches\[0\]\.posture_deg: got joint_3 at 290 deg, expected the joint's range, -1[^;]*$",
        ),
        ({"place": [0, 0, 0], "plane": {"point": [0, 0, 0], "normal": [0, 0, 0]}}, "length 0"),
        (
            {"place": [1912, 191, -1894], "point": [0, 0, 0]},
            r"touches\[0\]\.place: got .*, expected metres: millimetres\? then \[1\.912, 0\.191, -1\.894\]",
        ),
        (
            {"place": [0, 0, 0], "plane": {"point": [0, 0, 300], "normal": [0, 0, 1]}},
            r"touches\[0\]\.plane\.point: got .*, expected metres: millimetres\? then \[0, 0, 0\.3\]",
        ),
        ({"place": [0, 0, 0], "corner": [0, 0, 0]}, "corner"),
    ],
)
def test_wrong_touches_are_named(scene: Scene, touch: dict[str, Any], said: str) -> None:
    file = {"format": "cmbot-touches/1", "scene": "triangle", "touches": [touch]}
    with pytest.raises(InputError, match=said):
        cmbot.locate(file, scene)


def test_a_frame_that_the_scene_lacks_is_named(scene: Scene) -> None:
    touch = {"place": [0, 0, 0], "point": [0, 0, 0]}
    file = {"format": "cmbot-touches/1", "scene": "triangle", "locates": "braket", "touches": [touch]}
    with pytest.raises(
        InputError, match=r"locates: got braket, expected a frame of the scene, or world \(one"
    ):
        cmbot.locate(file, scene)


def test_corners_that_are_proposed_tell_more_than_those_that_are_not() -> None:
    scene = cmbot.load_scene("triangle")
    proposed, expected = features_to_touch(scene, 3)
    assert len(proposed) == 3
    corners, _ = features_to_touch(scene, 100)
    worst = [feature.point for feature in corners[-3:]]
    middle = np.mean([feature.point for feature in corners], axis=0)

    def turn(covariance: FloatArray) -> float:
        return float(np.trace(covariance[3:, 3:]))

    assert turn(expected) <= turn(expected_covariance(worst, middle))
    with pytest.raises(InputError, match="workpiece: true"):
        features_to_touch(short_scene(), 3)
    # A bed that is sanded from above is touched there.
    bed, _ = features_to_touch(cmbot.load_scene("panda_sanding"), 8)
    assert [corner.point[2] for corner in bed] == pytest.approx([0.23] * 4)
