"""Where the objective has next to nothing to gain the joints travel least."""

from dataclasses import replace

import numpy as np
import pytest

import cmbot
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.request import build_request
from cmbot.scene import Scene, load_scene

PANDA = {
    "format": "cmbot-scene/2",
    "name": "little_to_gain",
    "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
    "start": {"posture_deg": [0.1007, -10.7281, -0.0938, -119.9369, -0.0185, 109.2089, 45.0147]},
    "tool_path": {
        "keep": "pose",
        "legs": [{"by": [0, 0.2, 0], "seconds": 4}, {"by": [0, 0, -0.15], "seconds": 3}],
        "speed_profile": {"kind": "jerk_limited", "ramp": 0.3},
        "via_points": 9,
    },
    "guardrail": {"bays": 0},
    "planner": {"baseline": "none"},
}


def scene_with(**planner: object) -> Scene:
    return load_scene({**PANDA, "planner": PANDA["planner"] | planner})


def travel(plan: cmbot.Plan) -> float:
    q = plan.job.strokes[0].trajectory.evaluate(np.linspace(0, 7, 500))
    return float(np.abs(np.diff(q, axis=0)).sum())


def test_joints_travel_least_where_nothing_is_gained() -> None:
    """A Panda's torque has 1.2 % to gain by joints that travel three times as far."""
    least = cmbot.plan(scene_with(), progress=False)
    lowest = cmbot.plan(scene_with(min_gain=0.0, start="pinned"), progress=False)
    assert least.figures.peak_guardrail_torque <= 1.02 * lowest.figures.peak_guardrail_torque
    assert lowest.figures.peak_guardrail_torque < least.figures.peak_guardrail_torque
    assert travel(least) < 0.5 * travel(lowest)
    # The bound is told of both, and why one does not go down to it.
    bounds = [each.strokes[0].lower_bound.value for each in (least, lowest)]
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-6)
    said = "less than 2 % to gain"
    assert any(said in fallback for fallback in least.fallbacks)
    assert not any(said in fallback for fallback in lowest.fallbacks)
    assert least.options.objective == lowest.options.objective == "torque"


@pytest.mark.parametrize("planner", [{"objective": "travel"}, {"knots": "fixed"}, {"min_gain": 0.0}])
def test_elsewhere_an_attempt_stays_as_it_is(planner: dict[str, object]) -> None:
    scene = scene_with(**planner)
    attempt = Attempt.of(build_request(scene, scene.planner, None))
    assert attempt.of_least_travel() is attempt


def test_the_next_stroke_has_its_own_objective() -> None:
    scene = scene_with()
    request = replace(build_request(scene, scene.planner, None), least_travel=True)
    assert request.objective.name == "travel"
    assert request.at_stroke(0).objective is request.cell.objective
