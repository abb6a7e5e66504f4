"""The floor: nothing admissible lies below it, by random restarts and by descents that know no charts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize
from seven_joint_arms import endless_scene, panda_scene
from small_scenes import short_scene

from cmbot.planning import GlobalSearch, plan
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.path.projection import project_onto_task
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.robot import Postures
from cmbot.scene import Scene

FloatArray = NDArray[np.float64]
KINDS = ("pose", "axis", "position")
RESTARTS = 2000


def scene_of(kind: str) -> Scene:
    return short_scene(tool_path={"keep": kind}, planner={"knots": "sliding"})


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def context(kind: str) -> PlanningContext:
    scene = scene_of(kind)
    return build_context(scene, scene.planner)


@pytest.fixture(scope="module")
def floor(context: PlanningContext) -> LowerBound:
    return GlobalSearch(context).lower_bound


def admissible(context: PlanningContext, q: FloatArray) -> NDArray[np.bool_]:
    limits, at = context.robot.limits, Postures(context.robot).at(q)
    holds = ((q >= limits.lower) & (q <= limits.upper)).all(axis=1)
    holds &= (np.abs(at.joint_torque) <= limits.torque).all(axis=1)
    holds[holds] = ~context.clearances.check_collision(q[holds], context.options.safety_margin_m)
    return holds


def restarts(context: PlanningContext, via_point: int, rng: np.random.Generator) -> FloatArray:
    """Random postures with the tool where it is at a via-point, admissible or not."""
    limits = context.robot.limits
    q = rng.uniform(np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi), (RESTARTS, 7))
    point = context.task.path.position(context.times)[via_point]
    placed, reached = project_onto_task(Postures(context.robot), context.task, q, point, steps=40)
    return placed[reached]


def values(context: PlanningContext, q: FloatArray) -> FloatArray:
    return context.objective.at_rest(Postures(context.robot).at(q))


def descended(context: PlanningContext, via_point: int, start: FloatArray) -> FloatArray:
    """Where SLSQP gets to from a posture: the task, joint ranges and torques kept, clearances not."""
    postures, task, limits = Postures(context.robot), context.task, context.robot.limits
    point = task.path.position(context.times)[via_point]

    def off(q: FloatArray) -> FloatArray:
        at = postures.at(q[None])
        return np.asarray(task.errors(at.tool_point, at.tool_rotation, point)[0])

    def room(q: FloatArray) -> FloatArray:
        share = postures.at(q[None]).joint_torque[0] / limits.torque
        return np.concatenate([1 - share, 1 + share])

    result = optimize.minimize(
        lambda q: values(context, q[None])[0] / 100.0,
        start,
        method="SLSQP",
        bounds=list(zip(limits.lower, limits.upper, strict=True)),
        constraints=[{"type": "eq", "fun": off}, {"type": "ineq", "fun": room}],
        options={"maxiter": 60, "ftol": 1e-9},
    )
    placed, reached = project_onto_task(postures, task, result.x[None], point)
    return placed[reached]


def test_no_random_posture_is_below_the_floor(
    context: PlanningContext, floor: LowerBound, rng: np.random.Generator
) -> None:
    """Nor does descending from the best of them lead below it, wherever it ends with everything kept."""
    q = restarts(context, floor.via_point, rng)
    q = q[admissible(context, q)]
    value = values(context, q)
    assert len(q) > 50
    assert value.min() >= floor.value - min(floor.error, 1e-3 * floor.value)
    for start in q[np.argsort(value)[:5]]:
        end = descended(context, floor.via_point, start)
        end = end[admissible(context, end)]
        assert (values(context, end) >= floor.value * (1 - 1e-4)).all()


def test_at_every_via_point_some_posture_has_no_more(
    context: PlanningContext, floor: LowerBound, rng: np.random.Generator
) -> None:
    """What is said of a via-point is no more than a dense random search finds there, or hardly."""
    assert floor.value == floor.each[floor.via_point] == floor.each.max()
    last = len(floor.each) - 1
    q = restarts(context, last, rng)
    assert floor.each[last] <= values(context, q[admissible(context, q)]).min() * 1.02


def test_the_error_is_small_where_the_self_motion_is_narrow(kind: str, floor: LowerBound) -> None:
    if kind != "position":
        assert 0 < floor.error < 1e-4 * floor.value


def test_more_freedom_has_a_lower_floor(kind: str, floor: LowerBound) -> None:
    scene = scene_of("pose")
    pose = GlobalSearch(build_context(scene, scene.planner)).lower_bound
    assert floor.value <= pose.value + pose.error
    assert (floor.value < pose.value - 5.0) == (kind == "position")


def test_a_plan_comes_near_it(kind: str, floor: LowerBound) -> None:
    planned = plan(scene_of(kind))
    assert planned.certificate.holds
    assert planned.gap_to_floor is not None
    assert planned.gap_to_floor < planned.options.gap_target + 1e-3
    static = values(build_context(planned.scene, planned.options), planned.trajectory.q)
    assert static.max() >= floor.value - min(floor.error, 1e-4 * floor.value)


@pytest.mark.parametrize("make", [panda_scene, endless_scene])
@pytest.mark.parametrize("keep", ["pose", "axis"])
def test_other_arms(make: Callable[..., Scene], keep: str, tmp_path: Path, rng: np.random.Generator) -> None:
    scene = make(tmp_path, keep=keep)
    context = build_context(scene, scene.planner)
    floor = GlobalSearch(context).lower_bound
    q = restarts(context, floor.via_point, rng)
    q = q[admissible(context, q)]
    assert len(q) > 50
    assert values(context, q).min() >= floor.value - floor.error
    planned = plan(scene)
    assert planned.certificate.holds
    assert planned.gap_to_floor is not None
    assert -1e-3 < planned.gap_to_floor < planned.options.gap_target + 1e-3
