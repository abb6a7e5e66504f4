"""The lower bound: nothing admissible lies below it, by random restarts and descents without charts."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from admissible_postures import admissible, restarts, values
from scipy import optimize
from small_scenes import request_of, short_scene
from urdf_arms import endless_scene, panda_scene

from cmbot.common.arrays import FloatArray
from cmbot.planning import GlobalSearch, Plan, plan
from cmbot.planning.budget import Deadline
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.lower_bound import LowerBound, _BranchAndBound
from cmbot.scene import Scene

KINDS = ("pose", "axis", "position")
RESTARTS = 2000


def scene_of(kind: str) -> Scene:
    return short_scene(tool_path={"keep": kind}, planner={"knots": "sliding"})


@pytest.fixture(scope="module", params=KINDS)
def kind(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def asked(kind: str) -> StrokeRequest:
    return request_of(scene_of(kind))


@pytest.fixture(scope="module")
def planned(kind: str) -> Plan:
    return plan(scene_of(kind))


@pytest.fixture(scope="module")
def bound(planned: Plan) -> LowerBound:
    assert planned.lower_bound is not None
    return planned.lower_bound


def descended(asked: StrokeRequest, via_point: int, start: FloatArray) -> FloatArray:
    """Where SLSQP gets to from a posture: the task, joint ranges and torques kept, clearances not."""
    postures, task, limits = asked.cell.postures, asked.task, asked.cell.robot.limits
    goal = asked.goals[via_point]

    def off(q: FloatArray) -> FloatArray:
        at = postures.at(q[None])
        return np.asarray(task.errors(at.tool_point, at.tool_rotation, goal)[0])

    def room(q: FloatArray) -> FloatArray:
        share = postures.at(q[None]).joint_torque[0] / limits.torque
        return np.concatenate([1 - share, 1 + share])

    result = optimize.minimize(
        lambda q: values(asked, q[None])[0] / 100.0,
        start,
        method="SLSQP",
        bounds=list(zip(limits.lower, limits.upper, strict=True)),
        constraints=[{"type": "eq", "fun": off}, {"type": "ineq", "fun": room}],
        options={"maxiter": 60, "ftol": 1e-9},
    )
    placed, reached = project_onto_task(postures, task, result.x[None], goal)
    return placed[reached]


def test_no_random_posture_is_below_the_floor(
    asked: StrokeRequest, bound: LowerBound, rng: np.random.Generator
) -> None:
    q = restarts(asked, bound.via_point, rng, RESTARTS)
    value = values(asked, q)
    assert len(q) > 50
    assert value.min() >= bound.value - min(bound.error, 1e-3 * bound.value)
    for start in q[np.argsort(value)[:5]]:
        end = descended(asked, bound.via_point, start)
        end = end[admissible(asked, end)]
        assert (values(asked, end) >= bound.value * (1 - 1e-4)).all()


def test_at_every_via_point_some_posture_has_no_more(
    asked: StrokeRequest, bound: LowerBound, rng: np.random.Generator
) -> None:
    assert bound.value == bound.each[bound.via_point] == bound.each.max()
    last = len(bound.each) - 1
    # Elsewhere than where it is set, wide self-motions are known by coarse charts alone.
    assert bound.each[last] <= np.quantile(values(asked, restarts(asked, last, rng, RESTARTS)), 0.1)


def test_a_search_that_ends_early_bounds_from_below(asked: StrokeRequest, bound: LowerBound) -> None:
    now = [0.0]

    def pass_time(progress: Progress) -> None:
        now[0] = max(now[0], float(progress.step.startswith("finding")))

    deadline = Deadline(0.5, lambda: now[0])
    timed = replace(asked, reporter=ProgressReporter(pass_time), deadline=deadline)
    early = GlobalSearch(timed).lower_bound
    assert deadline.expired()
    assert early.value - early.error <= bound.value
    assert early.value >= bound.each[early.via_point] - bound.error


def test_the_error_is_small_where_the_self_motion_is_narrow(kind: str, bound: LowerBound) -> None:
    if kind != "position":
        assert 0 < bound.error < 1e-4 * bound.value


@pytest.fixture(scope="module")
def pose() -> LowerBound:
    return GlobalSearch(request_of(scene_of("pose"))).lower_bound


def test_where_all_is_negligible_nothing_is_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound is then what was found, and nothing is known of what lies below."""
    asked = request_of(scene_of("position"))
    off = asked.tool_off
    at_rest = off.cell.objective.at_rest(off.cell.postures.at(asked.state.posture[None]))[0]
    assert asked.negligible == pytest.approx(0.01 * at_rest)
    monkeypatch.setattr(_BranchAndBound, "minimise", None)
    found = GlobalSearch(replace(asked, state=replace(asked.state, reached=1e6))).lower_bound
    assert 0 < found.value == found.error == found.each.max() < 1e4


def test_more_freedom_has_a_lower_floor(kind: str, bound: LowerBound, pose: LowerBound) -> None:
    assert bound.value <= pose.value + pose.error
    assert (bound.value < pose.value - 5.0) == (kind == "position")


def test_a_plan_comes_near_it(planned: Plan, asked: StrokeRequest, bound: LowerBound) -> None:
    assert planned.certificate.holds
    assert planned.gap_to_floor < 2e-3 + planned.options.least_peak_tolerance
    static = values(asked, planned.trajectory.q)
    assert static.max() >= bound.value - min(bound.error, 1e-4 * bound.value)


# In 4 s in place of 6 the motion itself costs 2.1e-3.
_SLOW = {"legs": [{"by": [0.0, 0.1, 0.05], "seconds": 6}]}


@pytest.mark.parametrize(("make", "path"), [(panda_scene, {"keep": "axis"}), (endless_scene, _SLOW)])
def test_other_arms(
    make: Callable[..., Scene], path: dict[str, Any], tmp_path: Path, rng: np.random.Generator
) -> None:
    scene = make(tmp_path, via_points=5, **path)
    # Splines that hardly cost anything come near what rest asks.
    planned = plan(scene, options=replace(scene.planner, smoothing_weight=0.1, min_gain=0.0))
    asked, bound = request_of(scene), planned.lower_bound
    q = restarts(asked, bound.via_point, rng, RESTARTS)
    assert len(q) > 50
    assert values(asked, q).min() >= bound.value - bound.error
    assert planned.certificate.holds
    assert -1e-3 < planned.gap_to_floor < 2e-3 + planned.options.least_peak_tolerance
