"""Any arm among the mounts of its scene: where it stands, how that bends, what is proven of the others."""

from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import CmbotError, SceneError
from cmbot.elastic.sag import Sag
from cmbot.planning import bending_arm, plan, robot_of
from cmbot.robot import Dynamics
from cmbot.scene import Scene
from cmbot.stances import (
    MountCandidate,
    Screener,
    StanceRanking,
    StandOptions,
    best_scene,
    in_words,
    in_world,
    put_away,
    scene_at,
    stances_csv,
    stand,
)
from cmbot.stances.arm import FIGURES
from cmbot.stances.candidates import mounts_of
from cmbot.views import stances_page

# So stiff that what is of second order in the turn of the base, which is far from W, does not count.
STIFFNESS = 1e4 * (np.diag([2e5, 1e5, 3e5, 2e4, 1e4, 3e4]) + 100.0 * np.ones((6, 6)))


def panda(**changes: Any) -> Scene:
    data = short_scene().as_data() | {
        "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
        "guardrail": {"bays": 0},
        "start": {"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
        "return": "start",
        "tool_path": {
            "from": {"xyz": [0.5, -0.1, 0.4], "rpy_deg": [180, 0, 0]},
            "legs": [{"by": [0, 0.2, 0], "speed_m_s": 0.1}],
            "speed_profile": {"kind": "trapezoidal"},
            "via_points": 11,
        },
        "planner": {"time_limit_s": 60, "baseline": "none"},
    }
    return cmbot.load_scene(data | changes)


@pytest.fixture(scope="module")
def mounted() -> Scene:
    rail = {"origin": [0.2, 0, 0], "along": [0.9, 0, 0], "count": 3}
    return panda(mounts=[{"name": "rail", "rail": rail}, {"name": "far", "xyz": [9, 9, 0]}])


@pytest.fixture(scope="module")
def ranking(mounted: Scene) -> StanceRanking:
    (found,) = stand(mounted, StandOptions(plans=1))
    return found


def test_processes_beside_each_other_find_the_same(mounted: Scene) -> None:
    """As many stances are judged, in the same order, with the same plans to the last digit."""
    path = {"legs": [{"by": [0, 0.1, 0], "speed_m_s": 0.1}], "via_points": 7}
    short = mounted.changed(tool_path=path).with_options(knots="fixed")
    one, two = (stand(short, StandOptions(plans=2, proofs=0, jobs=jobs))[0] for jobs in (1, 2))
    assert stances_csv([one]) == stances_csv([two])
    assert one.count("planned") >= 2
    for a, b in zip(one.ranked, two.ranked, strict=True):
        assert (a.plan is None) == (b.plan is None)
        if a.plan is not None and b.plan is not None:
            assert a.plan.robot is not b.plan.robot
            np.testing.assert_array_equal(a.plan.job.trajectory.q, b.plan.job.trajectory.q)
            assert a.plan.certificate.holds and b.plan.certificate.holds


def test_the_best_mount_is_planned_there(ranking: StanceRanking) -> None:
    best, (own,) = ranking.best, ranking.own
    assert best.value <= own.value
    scene = best_scene(ranking)
    # A plan that proves its bound has the time for it.
    assert scene.planner.time_limit_s > 2 * best.plan.seconds.total
    again = plan(scene)
    assert again.objective.planned_peak == pytest.approx(best.value, rel=1e-6)
    frame = again.robot.model.getFrameId("panda_link0")
    placement = again.robot.model.frames[frame].placement.homogeneous
    np.testing.assert_allclose(placement, best.candidate.base, atol=1e-12)
    # The torque is that about the base frame.
    force, torque = again.samples.guardrail_force, again.samples.guardrail_torque
    about = torque - np.cross(best.candidate.base[:3, 3], force)
    assert best.figures.torque == pytest.approx(np.linalg.norm(about, axis=1).max(), rel=1e-3)


def test_no_plan_of_another_mount_undercuts_what_is_proven(ranking: StanceRanking) -> None:
    others = [each for each in ranking.ranked if each.plan is None]
    proven = [each for each in others if each.proven >= 0.979 * ranking.best.value]
    assert len(proven) == ranking.proven > 1
    assert sum(f"others {len(proven)} are proven to ask" in line for line in in_words(ranking)) == 1
    scene = put_away(in_world(ranking.scene))
    for each in others:
        try:
            peak = plan(scene_at(scene, each.candidate, None)).objective.planned_peak
        except CmbotError:
            continue
        assert peak >= 0.999 * each.proven


def test_rows_that_a_wall_takes_are_left_out_where_the_scene_has_it() -> None:
    """As `plan` leaves them out."""
    raster = {"origin": [0.4, 0.05, 0.35], "u": [0, -0.1, 0], "v": [0.15, 0, 0], "spacing_m": 0.05}
    wall = {"name": "wall", "box": [0.02, 0.6, 0.6], "xyz": [0.58, 0, 0.5]}
    path = {"keep": "axis", "raster": raster | {"stand_off_m": 0.05}, "speed_m_s": 0.1, "via_points": 31}
    scene = panda(tool_path=path, obstacles=[wall], mounts=[{"name": "here", "xyz": [0, 0, 0]}])
    (found,) = stand(scene, StandOptions(plans=1, proofs=0))
    (own,) = found.own
    assert own.plan is not None and own.plan.rows_left_out


def test_what_is_far_away_is_out_of_reach(ranking: StanceRanking) -> None:
    (far,) = [each for each in ranking.ranked if each.place.startswith("far")]
    assert far.status == "out of reach"
    assert np.isinf(far.proven)
    page = stances_page([ranking])
    assert "where the base frame is" in page
    rows = stances_csv([ranking]).splitlines()
    assert len(rows) == 1 + len(ranking.ranked)
    assert {row.count(",") for row in rows} == {rows[0].count(",")}


def test_a_mount_bends_where_it_is() -> None:
    """The same arm in the same posture sags as much, wherever it is mounted on that stiffness."""
    matrix = STIFFNESS.tolist()
    scene = panda(
        mounts=[
            {"xyz": place, "rpy_deg": [0, 0, 0], "stiffness": matrix} for place in ([0, 0, 0.1], [2, -1, 0.5])
        ]
    )
    sags = list[np.ndarray]()
    for candidate in [*mounts_of(scene)][1:]:
        assert isinstance(candidate, MountCandidate)
        there = scene_at(scene, candidate, None)
        arm = bending_arm(there, robot_of(there))
        sags.append(Sag(arm).at(np.array([there.posture])).tool[0])
    assert np.linalg.norm(sags[0]) > 1e-8
    np.testing.assert_allclose(sags[0], sags[1], rtol=1e-4)


def test_a_mount_takes_the_place_of_the_tube_on_which_the_arm_stands() -> None:
    tube = {"start_m": [0, 0, -2], "outer_diameter_m": 0.1, "wall_m": 0.004}
    tube |= {"young_pa": 70e9, "shear_pa": 26e9, "density_kg_m3": 2700}
    scene = panda(
        base={"name": "mast", "tube": tube},
        guardrail={"bays": 0},
        mounts=[{"xyz": [0, 0, 0.7], "stiffness": [1e6] * 6}],
    )
    own, other = mounts_of(scene)
    assert own.stiffness is not None
    there = scene_at(scene, other, None)
    # Of the origin's motion that of the mount, 0.7 m above it.
    away = np.eye(6)
    away[:3, 3:] = [[0, 0.7, 0], [-0.7, 0, 0], [0, 0, 0]]
    np.testing.assert_allclose(there.elastic_guardrail.stiffness, 1e6 * away.T @ away)


def test_what_holds_a_mount_counts_as_it_does_in_a_plan_there() -> None:
    """On a floor, on a wall and leaning: the adhesion needed at rest is that of the robot mounted there."""
    hold = {"kind": "magnet", "plate_m": [0.2, 0.3], "adhesion_n": 9000, "xyz": [0, 0, 0.02]}
    places = [{"xyz": [2, -1, 0.5], "rpy_deg": turn} for turn in ([0, 0, 30], [0, 90, 0], [20, -40, 10])]
    scene = panda(base={"name": "floor", "hold": hold}, mounts=places)
    candidates, posture = [*mounts_of(scene)], np.array(scene.posture)[None]
    screener = Screener(scene, robot_of(scene), candidates)
    needed = list[float]()
    for number, candidate in enumerate(candidates):
        robot = robot_of(scene_at(scene, candidate, None))
        wrench = Dynamics(robot).static_efforts(posture).guardrail_wrench
        needed.append(float(robot.holding.each(wrench).max()))
        figures = screener.arm.figures(posture, np.array([number]), screener.loads)
        assert figures[FIGURES.index("adhesion"), 0] == pytest.approx(needed[-1], rel=1e-6, abs=1e-6)
    assert max(needed) > 1.0


def test_the_scenes_own_mount_comes_first_and_once() -> None:
    mount = {"xyz": [0.1, 0.2, 0.3], "rpy_deg": [0, 0, 90]}
    robot = panda().robot.model_dump(exclude_none=True) | {"mount": mount}
    own, *others = mounts_of(panda(robot=robot, mounts=[mount, {"xyz": [1, 1, 1]}]))
    np.testing.assert_allclose(own.base[:3, 3], mount["xyz"], atol=1e-12)
    assert own.place == "own at (0.10, 0.20, 0.30) m"
    assert [each.place for each in others] == ["mount at (1.00, 1.00, 1.00) m"]


def test_an_arm_without_mounts() -> None:
    with pytest.raises(SceneError, match="mounts: got none, expected where the base frame may be held"):
        stand(panda())
    rigid = panda(mounts=[{"xyz": [1, 1, 1]}])
    with pytest.raises(SceneError, match="nothing that bends, expected something that bends"):
        stand(rigid, StandOptions(objective="sag"))
