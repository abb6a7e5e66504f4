"""Forged plans fail certification: from `certify`, and from a plan directory whose hashes are all right."""

from __future__ import annotations

import copy
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from forgeries import FORGERIES, PLACE, Forgery, certified, changed_scene, forge, put_job
from plan_folders import edit, rewrite, without_approach
from small_scenes import SHORT, short_scene

from cmbot.archive import load_plan
from cmbot.collision import Box, Clearances, Obstacle
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.common.poses import pose
from cmbot.planning import Plan, QuinticTrajectory, certify_move, plan
from cmbot.robot import Robot
from cmbot.scene import load_scene
from cmbot.toolpath import SpeedProfile
from cmbot.trajectory import SplineSpace


def failed(forgery: Forgery, planned: Plan) -> list[str]:
    """The checks that a forgery of the plan of the short scene fails."""
    scene: dict[str, Any] = copy.deepcopy(SHORT)
    if forgery.scene is not None:
        forgery.scene(scene)
    certificate = certified(load_scene(scene), planned, forgery.motion(planned.trajectory))
    return [check.quantity for check in certificate.checks if not check.holds]


@pytest.mark.parametrize("forgery", FORGERIES, ids=str)
def test_forgeries_are_caught(forgery: Forgery, short_plan: Plan, short_folder: Path) -> None:
    got = failed(forgery, short_plan)
    assert any(quantity.startswith(forgery.caught_by) for quantity in got), got
    forge(short_folder, forgery)
    with pytest.raises((LimitViolation, ArchiveError)) as caught:
        load_plan(short_folder, verify=True)
    if isinstance(caught.value, LimitViolation):
        # A plan has to start where the arm stands, too.
        assert caught.value.quantity in (got[0], "distance of the start from the posture required there")
    else:
        # Other times, another posture at first, and a path that is too quick need no certificate.
        assert caught.value.key in ("t", "q", "scene.tool_path.legs[0].seconds")


def test_what_is_not_forged_holds(short_plan: Plan, short_folder: Path) -> None:
    assert not failed(Forgery(name="", caught_by=""), short_plan)
    load_plan(short_folder, verify=True)


def test_a_bar_between_samples_is_seen(short_plan: Plan) -> None:
    """Two millimetres thin, where the tool passes at full speed between two of a few samples."""
    place = short_plan.task.path.position([2.013])[0]
    bar = {"name": "bar", "box": [0.5, 0.002, 0.002], "xyz": place.tolist()}
    coarse = replace(short_plan, options=replace(short_plan.options, samples_per_segment=4))
    certificate = certified(short_scene(obstacles=[bar]), coarse, short_plan.trajectory)
    (check,) = (check for check in certificate.checks if not check.holds)
    assert check.quantity.startswith("clearance of ")
    assert check.quantity.endswith(" from bar")
    assert check.time == pytest.approx(2.013, abs=0.1)
    assert certificate.clearance_bound < 0


def test_a_tool_of_another_length() -> None:
    """Where the orientation is free a longer tool is elsewhere, though it starts where its path does."""
    scene = short_scene(tool_path={"keep": "position"})
    planned = plan(scene)
    assert certified(scene, planned, planned.trajectory).holds
    longer = short_scene(tool_path={"keep": "position"}, robot={"tool_length_m": 0.5})
    got = [
        check.quantity for check in certified(longer, planned, planned.trajectory).checks if not check.holds
    ]
    assert PLACE in got


def test_a_path_whose_orientation_was_free(short_plan: Plan) -> None:
    """A motion that keeps the tool's point alone does not pass where the pose is asked for."""
    free = plan(short_scene(tool_path={"keep": "position"}, planner={"knots": "sliding"}))
    certificate = certified(short_scene(), free, free.trajectory)
    assert "rotation of the tool from its orientation at a via-point" in [
        check.quantity for check in certificate.checks if not check.holds
    ]


def test_sag_that_was_not_compensated(short_plan: Plan) -> None:
    """A rigid plan, certified as one that compensates."""
    soft = short_scene(guardrail={"stiffness": np.diag([1e6, 1e6, 1e6, 2e4, 2e4, 2e4]).tolist()})
    compensating = plan(soft, options=replace(soft.planner, compensate=True))
    assert certified(soft, compensating, compensating.trajectory).holds
    rigid = plan(soft)
    got = [
        check.quantity for check in certified(soft, compensating, rigid.trajectory).checks if not check.holds
    ]
    assert "expected tool deviation" in got


@pytest.mark.parametrize(("order", "legs"), [("permuted", (1, 0, 2)), ("left out", (0, 1))])
def test_legs_in_another_order(triangle_plan: Plan, order: str, legs: tuple[int, ...]) -> None:
    scene = triangle_plan.scene
    other = scene.with_path(legs=tuple(scene.strokes[0].legs[k] for k in legs), time_laws=())
    got = [
        check.quantity
        for check in certified(other, triangle_plan, triangle_plan.trajectory).checks
        if not check.holds
    ]
    assert f"expected {PLACE}" in got


def straight(start: Any, end: Any, seconds: float) -> QuinticTrajectory:
    """A straight line in joint space, from rest to rest."""
    u = np.linspace(0, 1, 20)
    space = SplineSpace(u * seconds)
    share = SpeedProfile(kind="jerk_limited", ramp=0.5).law.share(u)[:, None]
    return space.trajectory(space.least_jerk(start + share * (end - start)))


def elbow(robot: Robot, x: QuinticTrajectory) -> Any:
    """Where the fourth joint is half-way."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, x.evaluate([0.5 * x.t[-1]])[0])
    return data.oMi[4].translation.copy()


def test_an_approach_that_is_not_free(triangle_plan: Plan, triangle_folder: Path) -> None:
    """Through a post that stands where the arm's elbow passes on the way, or to other ends."""
    approach = triangle_plan.approach
    assert approach is not None
    x, scene, held = approach.trajectory, triangle_plan.scene, approach.task
    robot, options = triangle_plan.robot, triangle_plan.options
    ends = (scene.posture, triangle_plan.trajectory.q[0])
    post = Obstacle(name="post", shape=Box(size=(0.01, 0.01, 0.01)), X_WO=pose(elbow(robot, x)))
    for obstacles, way, caught_by in (
        (scene.all_obstacles, x, None),
        ((*scene.all_obstacles, post), x, "clearance"),
        (scene.all_obstacles, straight(*ends, 100.0), None),
        (scene.all_obstacles, straight(ends[0], ends[1] + 0.01, 100.0), "distance of the end"),
        (scene.all_obstacles, straight(ends[0] + 0.01, ends[1], 100.0), "distance of the start"),
    ):
        clearances = Clearances(robot, obstacles)
        got = certify_move(robot, held, way, clearances, options, *ends)
        failed = [check.quantity for check in got.checks if not check.holds]
        assert [caught_by] == [next(iter(failed), None) and caught_by], failed
        assert not failed or failed[0].startswith(str(caught_by))


def from_elsewhere(x: QuinticTrajectory) -> QuinticTrajectory:
    q = x.q.copy()
    q[0] += 0.01
    return replace(x, q=q)


def leaping(x: QuinticTrajectory) -> QuinticTrajectory:
    """Not at rest where the work begins."""
    v = x.v.copy()
    v[-1] += 0.01
    return replace(x, v=v)


@pytest.mark.parametrize(
    ("forged", "words"),
    [
        (from_elsewhere, "the scene's posture at first"),
        (leaping, "jump of a joint's position"),
        (lambda x: replace(x, q=x.q * np.linspace(1, 1.01, len(x.q))[:, None]), "start.posture_deg"),
    ],
)
def test_a_forged_approach_in_a_plan_directory(
    triangle_plan: Plan, triangle_folder: Path, forged: Any, words: str
) -> None:
    """From another posture, with a jump of the velocity or of the posture where the work begins."""
    approach = triangle_plan.approach
    assert approach is not None
    put_job(triangle_folder, triangle_plan.job.changed("approach", trajectory=forged(approach.trajectory)))
    with pytest.raises((ArchiveError, LimitViolation), match=words):
        load_plan(triangle_folder, verify=True)


def test_a_scene_with_a_post_in_the_approachs_way(triangle_plan: Plan, triangle_folder: Path) -> None:
    assert triangle_plan.approach is not None
    place = elbow(triangle_plan.robot, triangle_plan.approach.trajectory)
    post = {"name": "post", "box": [0.01, 0.01, 0.01], "xyz": place.tolist()}
    add = partial(changed_scene, change=lambda data: data["obstacles"].append(post), folder=triangle_folder)
    edit(triangle_folder, add)
    with pytest.raises(LimitViolation, match=r"clearance of \S+ from post"):
        load_plan(triangle_folder, verify=True)


def test_a_start_that_nothing_leads_to(triangle_plan: Plan, triangle_folder: Path) -> None:
    """A directory that claims that the work starts in the scene's posture, and has no approach."""

    def claim(data: dict[str, Any]) -> None:
        data["start"]["moved_deg"] = 0.0
        (work,) = data["segments"] = data["segments"][1:]
        work["begin"] = 0.0
        own = {key: value for key, value in data["planned"].items() if key not in ("job", "free")}
        data["planned"] |= {"job": own, "free": None}

    edit(triangle_folder, claim)
    put_job(triangle_folder, without_approach(triangle_plan).job)
    rewrite(triangle_folder, "job.csv", b"")
    with pytest.raises(ArchiveError, match="the scene's posture at first"):
        load_plan(triangle_folder, verify=True)
