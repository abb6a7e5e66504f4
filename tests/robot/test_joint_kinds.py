"""Joints that slide: units, limits, distances between postures, and the equations of motion."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from oracles import chang2021_arm
from rail_arms import RAIL_JOINTS, rail_data, rail_scene, shipped_arm_on_rail
from robot_files import replace
from small_motions import wild
from state_samples import StateSamples

from cmbot.collision import Clearances
from cmbot.common.errors import InputError, ModelError
from cmbot.common.installation import model_folder
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning import robot_of
from cmbot.planning.certification.norm_bounds import norm_bounds
from cmbot.robot import Dynamics, Kinematics, Postures, Robot, joint_units, load_robot, postures_in_words
from cmbot.scene import load_scene
from cmbot.trajectory import Pieces
from cmbot.trajectory.enclosure import _ELLIPSE_SUMS

FIRST, DRAW = RAIL_JOINTS.index("rail"), RAIL_JOINTS.index("draw")


@pytest.fixture(scope="module")
def rail(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    return robot_of(rail_scene(tmp_path_factory.mktemp("rail")))


@pytest.fixture
def railed(urdf_folder: Path) -> Robot:
    return shipped_arm_on_rail(urdf_folder)


def test_which_joints_slide_and_their_units(rail: Robot) -> None:
    assert np.flatnonzero(rail.limits.prismatic).tolist() == [FIRST, DRAW]
    assert not rail.limits.winding[[FIRST, DRAW]].any()
    assert rail.limits.winding[-1]
    units = joint_units(True)
    assert (units.position, units.jerk, units.torque, units.factor) == ("m", "m/s3", "N", 1.0)
    assert rail.limits.units(1, shown=True).acceleration == "deg/s²"
    assert rail.limits.range_in_words(DRAW) == "0 to 0.35 m"
    assert postures_in_words([True, False], np.array([0.25, 0.5])) == "(0.250 m, 28.6 deg)"
    assert postures_in_words([False], np.array([0.5])) == "(28.6) deg"


def test_limits_of_joints_that_slide_are_in_metres(rail: Robot) -> None:
    limits = rail.limits
    # Of its own entry; the entry of all has no acceleration in metres, so that is assumed.
    assert (limits.acceleration[DRAW], limits.jerk[DRAW]) == (0.5, 5.0)
    assert (limits.acceleration[FIRST], limits.jerk[FIRST]) == (2 * 0.4, 8.0)
    assert (limits.lower[FIRST], limits.upper[FIRST], limits.torque[FIRST]) == (-0.5, 0.7, 900)
    np.testing.assert_allclose(limits.jerk[1], np.deg2rad(1000))
    assert rail.remarks[0].startswith("Acceleration limits of 1 joint of 7 are assumed, 2 /s times")
    with pytest.raises(InputError, match=r"q\[0\]: got 0.8 m, expected rail within its range -0.5 to 0.7 m"):
        rail.posture([0.8, 0, 0, 0.1, 0, 0, 0])
    with pytest.raises(InputError, match="7 finite joint positions"):
        rail.posture([0.8])


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        (
            "limits.yaml",
            "jerk_m_s3: 5",
            "jerk_deg: 5",
            r"joints.draw.jerk_deg: .* jerk_m_s3: this joint slid",
        ),
        (
            "limits.yaml",
            "draw:",
            "pan:",
            r"joints.pan.acceleration_m_s2: got that key, expected acceleration_",
        ),
        ("limits.yaml", "acceleration_m_s2: 0.5", "acceleration_m_s2: 0", "acceleration_m_s2: got 0"),
        (
            "rail.urdf",
            'upper="0.35"',
            'upper="1e9"',
            r"joint\[draw\].limit.upper: got 1e.09, .* at most 1000 m",
        ),
    ],
)
def test_what_does_not_fit_a_joint_that_slides(
    tmp_path: Path, name: str, old: str, new: str, words: str
) -> None:
    scene = rail_scene(tmp_path)
    replace(tmp_path / name, old, new)
    with pytest.raises(ModelError, match=words):
        robot_of(scene)


def test_distances_between_postures(rail: Robot) -> None:
    metric = rail.metric
    # 0.15 m, 0.2 m, 0.3 m, 0.28 m, 0.12 m, 0.1 m and 0.1 m from each to the next, the slides at zero.
    assert metric.length == pytest.approx(1.25)
    q = np.zeros(7)
    q[[FIRST, 1]] = 0.5, -0.3
    assert metric.lengths(q) == pytest.approx(np.hypot(0.4, 0.3))
    np.testing.assert_allclose(metric.positions(metric.coordinates(q)), q, rtol=0, atol=1e-15)
    turned = metric.on_one_turn(np.stack([q, -1e-18 * np.ones(7)]))
    np.testing.assert_allclose(turned[0, :2], [0.4, 2 * np.pi - 0.3])
    assert (turned[1, ~rail.limits.prismatic] == 0.0).all()
    np.testing.assert_array_equal(metric.period > 0, ~rail.limits.prismatic)
    np.testing.assert_array_equal(rail.limits.turned_to_middle(q[None] + 7.0)[0, [FIRST, DRAW]], [7.5, 7.0])


def test_the_shipped_arm_on_a_rail_moves_as_in_the_paper(
    railed: Robot, random_states: StateSamples, rng: np.random.Generator
) -> None:
    """The oracle's arm, accelerated with its base: the rail's axis is x of W."""
    q, v, a = random_states(railed, 40)
    got = Dynamics(railed).efforts(q, v, a)
    along = a[:, :1] * [1.0, 0, 0]
    tau, n_0, f_0 = chang2021_arm.efforts(q[:, 1:], v[:, 1:], a[:, 1:], along)
    # What the rail moves besides the arm: the base's own mass.
    base, X = railed.model.inertias[1], railed.model.jointPlacements[1]
    slid = q[:, :1] * [1.0, 0, 0]
    inertial = base.mass * (along - chang2021_arm.GRAVITY)
    force = f_0 + inertial
    moment = n_0 + np.cross(slid, f_0) + np.cross(X.act(base.lever) + slid, inertial)
    for ours, theirs in (
        (got.joint_torque[:, 1:], tau),
        (got.joint_torque[:, 0], force[:, 0]),
        (got.guardrail_force, -force),
        (got.guardrail_torque, -moment),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9 * np.abs(theirs).max())
    p, R = Kinematics(railed).tool_poses(q)
    expected, R_expected = chang2021_arm.tool_pose(q[:, 1:])
    np.testing.assert_allclose(p, expected + slid, rtol=0, atol=1e-12)
    np.testing.assert_allclose(R, R_expected, rtol=0, atol=1e-12)


def test_an_arm_on_a_rail_bends_as_where_it_is_fixed(urdf_folder: Path, cmbot_robot: Robot) -> None:
    shutil.copy(model_folder() / "urdf" / "cmbot.elasticity.yaml", urdf_folder)
    sag = Sag(elastic_arm(shipped_arm_on_rail(urdf_folder), None))
    q = np.concatenate([[0.3], np.radians([-10, -90, 90, 0, 10, 50, 0])])
    at, fixed = sag.at(q[None]), Sag(elastic_arm(cmbot_robot, None)).at(q[None, 1:])
    np.testing.assert_allclose(at.tool, fixed.tool, rtol=0, atol=1e-12)
    np.testing.assert_allclose(at.d_tool[0, :, 0], 0.0, rtol=0, atol=1e-12)
    np.testing.assert_allclose(at.d_tool[0, :, 1:], fixed.d_tool[0], rtol=0, atol=1e-10)


def test_statics_in_batches(rail: Robot, random_states: StateSamples) -> None:
    q = random_states(rail, 100)[0]
    at, static = Postures(rail).at(q), Dynamics(rail).static_efforts(q)
    for name in ("joint_torque", "guardrail_force", "guardrail_torque"):
        ours, theirs = getattr(at, name), getattr(static, name)
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-11 * np.abs(theirs).max())


def test_the_tool_is_within_reach_of_the_drawn_out_arm(rail: Robot, rng: np.random.Generator) -> None:
    q = rng.uniform(np.maximum(rail.limits.lower, -3), np.minimum(rail.limits.upper, 3), (20_000, 7))
    away = np.linalg.norm(Kinematics(rail).tool_poses(q)[0] - rail.base_point, axis=1)
    assert 0.75 * rail.reach < away.max() <= rail.reach
    assert rail.inner_reach == 0.0


def test_a_long_slide_keeps_the_tool_away(tmp_path: Path, rng: np.random.Generator) -> None:
    """Drawn out by 2 m at least, what comes after the slide cannot bring the tool back."""
    scene = rail_scene(tmp_path)
    replace(tmp_path / "rail.urdf", 'lower="0.0" upper="0.35"', 'lower="2" upper="2.2"')
    rail = robot_of(scene)
    q = rng.uniform(np.maximum(rail.limits.lower, -3), np.minimum(rail.limits.upper, 3), (20_000, 7))
    away = np.linalg.norm(Kinematics(rail).tool_poses(q)[0] - rail.base_point, axis=1)
    assert 0.3 < rail.inner_reach <= away.min()
    assert away.max() <= rail.reach


def test_no_distance_changes_faster_than_reach(tmp_path: Path, rng: np.random.Generator) -> None:
    scene = rail_scene(tmp_path)
    rail = robot_of(scene)
    clearances = Clearances(rail, scene.all_obstacles)
    lower, upper = np.maximum(rail.limits.lower, -3), np.minimum(rail.limits.upper, 3)
    numbers = np.arange(len(clearances.pairs))
    for size in (1e-2, 0.1, 1.0):
        q = rng.uniform(lower, upper, (15, 7))
        moved = np.clip(q + size * rng.uniform(-1, 1, q.shape), lower, upper)
        each = [
            clearances.distances(some, np.repeat(np.arange(15), len(numbers)), np.tile(numbers, 15))
            for some in (q, moved)
        ]
        change = np.abs(each[1] - each[0]).reshape(15, -1)
        assert (change <= np.abs(moved - q) @ clearances.pair_reach.T + 2e-5).all()
        # One after the other, also beyond the ranges, they are what they are at once.
        beyond = q + 2.0 * rail.limits.prismatic
        alone = [clearances.query(q_k[None]).distance[0] for q_k in beyond]
        np.testing.assert_allclose(clearances.query(beyond).distance, alone, rtol=0, atol=2e-5)


def test_nothing_is_larger_on_the_ellipses(railed: Robot) -> None:
    x = wild(3, joints=8, knots=3)
    pieces = Pieces.between(x, np.empty(0))
    for _ in range(3):
        pieces = pieces.halved(np.ones(len(pieces.start), dtype=np.bool_))
    of = norm_bounds(railed, pieces.ellipses)
    base, X = railed.model.inertias[1], railed.model.jointPlacements[1]
    angle = np.exp(1j * np.linspace(0, 2 * np.pi, 24, endpoint=False))
    segment = np.searchsorted(x.t, pieces.middle, side="right") - 1
    for k, r in zip(*np.nonzero(pieces.ellipses.turn[..., 1:].max(axis=2) < 12.0), strict=True):
        rho = _ELLIPSE_SUMS[r] * angle
        t = pieces.middle[k] + 0.25 * (rho + 1 / rho) * (pieces.end[k] - pieces.start[k])
        c, h = x.coefficients[segment[k]].T, np.diff(x.t)[segment[k]]
        u = (t - x.t[segment[k]]) / h
        q, v, a = (
            np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(c, order)).T / h**order
            for order in range(3)
        )
        along, slid = a[:, :1] * [1.0, 0, 0], q[:, :1] * [1.0, 0, 0]
        tau, n_0, f_0 = chang2021_arm.efforts(q[:, 1:], v[:, 1:], a[:, 1:], along)
        inertial = base.mass * (along - chang2021_arm.GRAVITY)
        moment = n_0 + np.cross(slid, f_0) + np.cross(X.act(base.lever) + slid, inertial)
        slack = 1 + 1e-9
        assert (np.abs(tau) <= of.joint_torque[k, r, 1:] * slack).all()
        assert (np.abs(f_0 + inertial)[:, 0] <= of.joint_torque[k, r, 0] * slack).all()
        assert (np.linalg.norm(moment, axis=1) <= of.guardrail_torque[k, r] * slack).all()
        p = chang2021_arm.tool_pose(q[:, 1:])[0] + slid
        assert (np.linalg.norm(p, axis=1) <= of.tool_point[k, r] * slack).all()


def test_an_arm_that_only_slides(tmp_path: Path) -> None:
    """Its base frame is the pan's link: what is left of the arm before the wrist is one slide."""
    urdf = rail_data(tmp_path)["robot"]["model"]
    slide = load_robot(urdf, base_frame="tilt_link", tool_frame="draw_link")
    assert slide.joints == ("draw",)
    J = Kinematics(slide).tool_jacobian(np.array([0.1]))[1]
    assert np.linalg.norm(J[:3]) == pytest.approx(1.0)
    assert not J[3:].any()


def test_a_scene_gives_postures_in_radians_and_metres(tmp_path: Path) -> None:
    scene = rail_scene(tmp_path)
    assert scene.posture_key == "start.posture"
    np.testing.assert_array_equal(scene.posture, rail_data(tmp_path)["start"]["posture"])
    assert load_scene(scene.as_data()).content_hash == scene.content_hash
