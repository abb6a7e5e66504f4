"""The second opinion: it agrees with the package on all arms, and notices a mistake in any of its parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from obstacle_entries import with_obstacles
from oracle_arms import body_of, shapes_and_pairs
from oracles import chang2021_arm
from oracles.convex_distance import smallest_distances
from rail_arms import rail_scene
from random_arms import random_arm
from small_scenes import short_scene, with_corners
from state_samples import StateSamples
from urdf_arms import arm_scene, endless_scene, six_joint_scene

import cmbot.toolpath.builder
from cmbot.collision import Box, Clearances, Obstacle
from cmbot.common.poses import pose
from cmbot.elastic.arm import ElasticOptions, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, QuinticTrajectory, plan, robot_of
from cmbot.planning.verification.bent_tool import bent_tool_points
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Dynamics, Kinematics, Robot, load_robot
from cmbot.scene import Scene, load_scene
from cmbot.toolpath import SpeedProfile, ToolPath

FloatArray = NDArray[np.float64]
SIX_JOINT_POSTURE = [10.0, -60, 60, 10, 20, 30]
LEGS = {"legs": [{"by": [0, 0.1, 0], "seconds": 4}], "via_points": 8}


def swing(robot: Robot, duration: float, seed: int = 1) -> QuinticTrajectory:
    """A trajectory through random postures."""
    rng = np.random.default_rng(seed)
    lower, upper = np.clip(robot.limits.lower, -3, None), np.clip(robot.limits.upper, None, 3)
    q = rng.uniform(lower, upper, (6, robot.dof))
    rates = rng.uniform(-3, 3, (2, *q.shape))
    return QuinticTrajectory(t=np.linspace(0, duration, len(q)), q=q, v=rates[0], a=rates[1])


def broken(planned: Plan, **changes: Any) -> set[str]:
    """Quantities of the checks of a plan that do not hold, after tampering."""
    given: dict[str, Any] = {
        "scene": planned.scene,
        "options": planned.options,
        "trajectory": planned.trajectory,
        "robot": planned.robot,
        "stroke": 0,
    }
    return {check.quantity for check in second_opinion(**(given | changes)) if not check.holds}


SCENES: dict[str, Callable[[Path], Scene]] = {
    "triangle": lambda _: load_scene("triangle"),
    "line": lambda _: load_scene("line"),
    "long_tool": lambda _: short_scene(robot={"tool_length_m": 0.45, "payload_kg": 3.0}),
    "short_tool": lambda _: short_scene(robot={"tool_length_m": 0.02}),
    "kinova": partial(arm_scene, arm="kinova"),
    "panda": partial(arm_scene, arm="panda"),
    "endless": endless_scene,
    "rail": rail_scene,
    "ur5": partial(six_joint_scene, arm="ur5", posture=SIX_JOINT_POSTURE, tool_path=LEGS),
    "random": partial(random_arm, seed=1),
    "random_without_srdf": partial(random_arm, seed=2, srdf=False),
    "random_with_another_tool": partial(random_arm, seed=3, tool_length_m=0.31, payload_kg=2.5),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_package_agrees(name: str, tmp_path: Path) -> None:
    scene = SCENES[name](tmp_path)
    robot = robot_of(scene)
    trajectory = swing(robot, sum(leg.seconds for leg in scene.strokes[0].legs))
    checks = second_opinion(scene, scene.planner, trajectory, robot=robot, stroke=0)
    compared = [check for check in checks if check.quantity.startswith(("difference", "joints that"))]
    assert len(compared) == 10 + len(scene.feet)
    assert not [check for check in compared if not check.holds]


@pytest.mark.parametrize("name", ["triangle", "short_tool", "panda", "ur5", "random", "random_without_srdf"])
def test_every_pair_is_as_far_apart_as_the_package_says(name: str, tmp_path: Path) -> None:
    scene = SCENES[name](tmp_path)
    robot, body = robot_of(scene), body_of(scene)
    clearances = Clearances(robot, scene.all_obstacles)
    theirs: dict[tuple[str, str], list[float]] = {}
    ours: dict[tuple[str, str], list[tuple[float, float]]] = {}
    q = swing(robot, 1.0).q[:2]
    shapes, pairs = shapes_and_pairs(scene, body)
    R_WJ, p_WJ = body.frames(q)
    R = np.stack([R_WJ[one.joint] @ one.X_JS[:3, :3] for one in shapes])
    p = np.stack([p_WJ[one.joint] + R_WJ[one.joint] @ one.X_JS[:3, 3] for one in shapes])
    for posture in q:
        for number, pair in enumerate(clearances.pairs):
            distance = clearances.nearest(posture, number).distance
            theirs.setdefault((pair.link, pair.other), []).append(distance)
    for first, second in pairs:
        proven = smallest_distances([one.shape for one in shapes], R, p, [(first, second)])
        link, other = shapes[first].link, shapes[second].link
        bounds = zip(proven.lower.tolist(), proven.upper.tolist(), strict=True)
        ours.setdefault((link, other), []).extend(bounds)
    assert ours.keys() == theirs.keys()
    apart = 0
    for key, distances in theirs.items():
        for distance, (lower, upper) in zip(sorted(distances), sorted(ours[key]), strict=True):
            if upper > 0:
                apart += 1
                assert lower - 1e-7 <= distance <= upper + 1e-7, key
            else:
                assert distance < 1e-7, key
    assert apart > 0.5 * len(clearances.pairs) * len(q)


def test_bodies_move_as_in_the_paper(cmbot_robot: Robot, random_states: StateSamples) -> None:
    """Equations and numbers of the oracle are typed from the paper's tables, not read from the URDF."""
    body = body_of(load_scene("triangle"))
    states = random_states(cmbot_robot, 50)
    tau, force, torque = body.efforts(*states)
    expected_tau, n_0, f_0 = chang2021_arm.efforts(*states)
    for got, expected in ((tau, expected_tau), (torque, -n_0), (force, -f_0)):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    for got, expected in zip(body.tool_poses(states[0]), chang2021_arm.tool_pose(states[0]), strict=True):
        np.testing.assert_allclose(got, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kind", ["trapezoidal", "jerk_limited", "quiet"])
@pytest.mark.parametrize("ramp", [0.03, 0.2, 0.5])
def test_the_timed_path_agrees(kind: Any, ramp: float) -> None:
    scene = load_scene("triangle").with_path(speed_profile=SpeedProfile(kind=kind, ramp=ramp), via_points=37)
    robot = robot_of(scene)
    checks = second_opinion(scene, scene.planner, swing(robot, 20), robot=robot, stroke=0)
    path = {check.quantity: check.holds for check in checks if "time" in check.quantity}
    assert path["difference of the timed tool path from a second computation"]
    assert path["difference of the via-points' times from a second computation"]


@pytest.mark.parametrize("name", ["short_plan", "triangle_plan", "fixed_line_plan"])
def test_plans_hold(name: str, request: pytest.FixtureRequest) -> None:
    planned: Plan = request.getfixturevalue(name)
    assert not broken(planned, sag=planned.sag)
    if planned.approach is not None:
        assert not broken(planned, trajectory=planned.approach.trajectory, stroke=None)


def test_a_bent_tool_is_not_judged(compensated_short: Any) -> None:
    planned, _ = compensated_short
    assert broken(planned) == {"distance of the tool from its timed via-point"} | (
        broken(planned) & {"turn of the tool at its via-point"}
    )
    assert not broken(planned, sag=planned.sag)


PARTS = [
    (Dynamics, "efforts", lambda found: replace(found, joint_torque=0.5 * found.joint_torque)),
    (Dynamics, "efforts", lambda found: replace(found, guardrail_torque=0.5 * found.guardrail_torque)),
    (Dynamics, "efforts", lambda found: replace(found, guardrail_force=0.5 * found.guardrail_force)),
    (Clearances, "query", lambda found: found._replace(distance=found.distance + 0.1)),
    (Kinematics, "tool_poses", lambda found: (found[0] + [0, 0, 1e-6], found[1])),
    (Kinematics, "tool_poses", lambda found: (found[0], found[1] @ pose([0] * 3, [0, 0, 1e-6])[:3, :3])),
    (ToolPath, "position", lambda found: found[:1] + 0.1 * (found - found[:1])),
    (ToolPath, "via_times", lambda found: found**2 / found[-1]),
]
NOTICED = [
    "difference of the joint torque from a second computation",
    "difference of the guardrail torque from a second computation",
    "difference of the guardrail force from a second computation",
    "difference of the clearance from a second computation",
    "difference of the tool point from a second computation",
    "difference of the tool's orientation from a second computation",
    "difference of the timed tool path from a second computation",
    "difference of the via-points' times from a second computation",
]


@pytest.mark.parametrize(("part", "quantity"), list(zip(PARTS, NOTICED, strict=True)))
def test_a_part_with_a_mistake(
    part: tuple[type, str, Callable[[Any], Any]],
    quantity: str,
    short_plan: Plan,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kind, name, mistake = part
    right = getattr(kind, name)
    monkeypatch.setattr(kind, name, lambda self, *given, **named: mistake(right(self, *given, **named)))
    assert broken(short_plan) == {quantity}


@pytest.mark.parametrize("name", ["lower", "velocity", "acceleration", "jerk", "torque"])
def test_limits_read_twice_as_wide(name: str, short_plan: Plan) -> None:
    limits = replace(short_plan.robot.limits, **{name: 2 * getattr(short_plan.robot.limits, name)})
    failed = broken(short_plan, robot=replace(short_plan.robot, limits=limits))
    assert failed == {"difference of a joint limit from the robot's files"}


@pytest.mark.parametrize(
    ("wrong", "quantities"),
    [
        ({"payload": 1.0}, {"joint torque", "guardrail force", "guardrail torque"}),
        ({"tool_length": 0.301}, {"tool point"}),
        ({"mount": pose([0, 0.5001, 0], [np.pi, 0, 0])}, {"tool point", "guardrail torque"}),
    ],
)
def test_another_robot_than_the_scene_asks_for(
    wrong: dict[str, Any], quantities: set[str], short_plan: Plan
) -> None:
    failed = broken(short_plan, robot=load_robot("cmbot", **wrong))
    differing = {quantity for quantity in failed if quantity.startswith("difference")}
    assert quantities <= {
        quantity.removeprefix("difference of the ").split(" from ")[0] for quantity in differing
    }


def test_an_arm_with_other_joints(short_plan: Plan, tmp_path: Path) -> None:
    other = robot_of(arm_scene(tmp_path, "panda"))
    assert broken(short_plan, robot=other) == {"joints that are not those of the robot's files"}


def test_a_planner_whose_legs_are_short(monkeypatch: pytest.MonkeyPatch) -> None:
    """The certificate of such a plan holds: planner and certificate share the path."""

    def short_path(**fields: Any) -> ToolPath:
        path = ToolPath(**fields)
        return with_corners(path, path.corners[0] + 0.1 * (path.corners - path.corners[0]))

    with monkeypatch.context() as patch:
        patch.setattr(cmbot.toolpath.builder, "ToolPath", short_path)
        planned = plan(short_scene())
    assert broken(planned) == {"distance of the tool from its timed via-point"}


def test_an_arm_that_stands_still(short_plan: Plan) -> None:
    x = short_plan.trajectory
    still = QuinticTrajectory(t=x.t, q=np.tile(x.q[0], (len(x.t), 1)), v=0 * x.v, a=0 * x.a)
    assert broken(short_plan, trajectory=still) == {"distance of the tool from its timed via-point"}


def test_a_path_that_is_run_backwards(short_plan: Plan) -> None:
    x = short_plan.trajectory
    back = QuinticTrajectory(t=x.t, q=x.q[::-1], v=-x.v[::-1], a=x.a[::-1])
    assert broken(short_plan, trajectory=back) == {"distance of the tool from its timed via-point"}


@pytest.mark.parametrize("speed", [0.9, 1.1])
def test_a_path_at_another_speed(speed: float, short_plan: Plan) -> None:
    x = short_plan.trajectory
    other = QuinticTrajectory(t=x.t / speed, q=x.q, v=x.v * speed, a=x.a * speed**2)
    assert "distance of the tool from its timed via-point" in broken(short_plan, trajectory=other)


@pytest.mark.parametrize(("keep", "noticed"), [("pose", True), ("axis", False), ("position", False)])
def test_a_tool_that_is_rolled(keep: Any, noticed: bool, short_plan: Plan) -> None:
    """The last joint turns the tool about its axis."""
    x = short_plan.trajectory
    q = x.q.copy()
    q[:, -1] += 0.01
    rolled = QuinticTrajectory(t=x.t, q=q, v=x.v, a=x.a)
    scene = short_plan.scene.with_path(keep=keep)
    turn = "turn of the tool at its via-point"
    assert broken(short_plan, trajectory=rolled, scene=scene) == ({turn} if noticed else set())
    # Half a turn of a wrist's joint lays the tool's axis down.
    q[:, -2] += 0.01
    bent = broken(short_plan, trajectory=QuinticTrajectory(t=x.t, q=q, v=x.v, a=x.a), scene=scene)
    assert (turn in bent) == (keep != "position")


def test_limits_are_judged(short_plan: Plan) -> None:
    """A hundred times as fast, every limit is passed."""
    x = short_plan.trajectory
    fast = QuinticTrajectory(t=x.t / 100, q=x.q, v=x.v * 100, a=x.a * 1e4)
    failed = {quantity.split(" of ")[0] for quantity in broken(short_plan, trajectory=fast)}
    assert {"velocity", "acceleration", "jerk", "torque"} <= failed


@pytest.mark.parametrize("order", [1, 2, 3])
def test_rounding_is_no_reason_in_a_long_segment(order: int, short_plan: Plan) -> None:
    """A knot after 1e-5 s makes the last digits of a position a jerk there, and nowhere else."""
    x = short_plan.trajectory
    t = np.insert(x.t, 1, 1e-5)
    split = QuinticTrajectory(t=t, **{name: x.evaluate(t, number) for number, name in enumerate("qva")})
    assert not broken(short_plan, trajectory=split)
    use = (x.extrema(order).largest()[0] / _bound(short_plan.robot, order)).max()
    speed = (1.01 / use) ** (1 / order)
    faster = QuinticTrajectory(t=t / speed, q=split.q, v=split.v * speed, a=split.a * speed**2)
    failed = {quantity.split(" of ")[0] for quantity in broken(short_plan, trajectory=faster)}
    assert ("velocity", "acceleration", "jerk")[order - 1] in failed


def _bound(robot: Robot, order: int) -> FloatArray:
    return (robot.limits.velocity, robot.limits.acceleration, robot.limits.jerk)[order - 1]


def test_ranges_are_judged(short_plan: Plan) -> None:
    x = short_plan.trajectory
    beyond = QuinticTrajectory(t=x.t, q=x.q + short_plan.robot.limits.upper, v=x.v, a=x.a)
    failed = broken(short_plan, trajectory=beyond)
    assert "way of a joint out of its range by a second computation" in failed


def test_a_wall_in_the_way(short_plan: Plan) -> None:
    scene = short_plan.scene
    wall = Obstacle(name="wall", shape=Box(size=(1.0, 0.01, 1.0)), X_WO=pose([1.8, 0.6, -2.0]))
    (failed,) = broken(short_plan, scene=with_obstacles(scene, wall))
    assert failed.startswith("clearance of ")
    assert failed.endswith(" from wall by a second computation")


def test_the_margin_is_the_one_that_was_promised(short_plan: Plan) -> None:
    (check,) = (
        check
        for check in second_opinion(
            short_plan.scene, short_plan.options, short_plan.trajectory, robot=short_plan.robot, stroke=0
        )
        if check.quantity.startswith("clearance")
    )
    for margin, holds in ((check.value - 1e-5, True), (check.value + 1e-5, False)):
        options = replace(short_plan.options, safety_margin_m=margin)
        assert (broken(short_plan, options=options) == set()) == holds


def test_nothing_to_hit(short_plan: Plan, tmp_path: Path) -> None:
    """An arm without shapes has all the room that there is."""
    scene = random_arm(tmp_path, 4)
    urdf = Path(scene.robot.model)
    text = urdf.read_text(encoding="utf-8")
    kept = [line for line in text.splitlines() if not line.startswith("<collision name")]
    urdf.write_text("\n".join(kept), encoding="utf-8")
    robot = robot_of(scene)
    checks = second_opinion(scene, scene.planner, swing(robot, 4), robot=robot, stroke=None)
    clearance = {check.quantity: check for check in checks if "clearance" in check.quantity}
    assert clearance["difference of the clearance from a second computation"].value == 0
    assert np.isposinf(clearance["clearance by a second computation"].value)


@pytest.fixture(scope="module")
def compensated_plan() -> Plan:
    """The bent tool is on the path, 12 mm below that of the rigid arm."""
    return plan(short_scene(planner={"compensate": True}))


def test_the_bent_tool_is_on_its_path(compensated_plan: Plan) -> None:
    assert not broken(compensated_plan, sag=compensated_plan.sag)
    # Without its sag it is not.
    assert broken(compensated_plan) == {"distance of the tool from its timed via-point"}


def test_a_bent_tool_beside_its_path(compensated_plan: Plan) -> None:
    x, at = compensated_plan.trajectory, Kinematics(compensated_plan.robot).tool_jacobian
    # Two millimetres up, as far as that leaves the orientation.
    q = x.q + np.stack([np.linalg.pinv(at(q)[1]) @ [0, 0, 0.002, 0, 0, 0] for q in x.q])
    failed = broken(compensated_plan, sag=compensated_plan.sag, trajectory=replace(x, q=q))
    assert "distance of the tool from its timed via-point" in failed


@pytest.mark.parametrize("wrong", [0.97, 1.03])
def test_a_mistake_in_the_sag(wrong: float, compensated_plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    right = Sag.following
    monkeypatch.setattr(Sag, "following", lambda self, q: wrong * right(self, q))
    failed = broken(compensated_plan, sag=compensated_plan.sag)
    assert failed == {"difference of the tool's sag from a second computation"}


@pytest.mark.parametrize("joints", ["rigid", "elastic"])
@pytest.mark.parametrize("push", [0.0, -80.0])
def test_the_sag_of_beams(joints: str, push: float) -> None:
    """With its tubes in ten pieces the package's own arm is as continuous as the other one."""
    changes = {"payload_kg": 3.0, "joints": joints}
    scene = short_scene(robot=changes, guardrail={"bays": 0}, tool={"process_force_n": [0, 0, push]})
    robot = robot_of(scene)
    q = np.array(scene.posture) + np.random.default_rng(3).uniform(-0.6, 0.6, (20, robot.dof))
    sag = bent_tool_points(robot, None, q) - Kinematics(robot).tool_poses(q)[0]
    theirs = Sag(elastic_arm(robot, None, ElasticOptions(segments=10))).at(q).tool
    np.testing.assert_allclose(sag, theirs, rtol=0, atol=1e-3 * np.abs(theirs).max())
