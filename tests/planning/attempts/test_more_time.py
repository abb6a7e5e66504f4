"""What more seconds would give on short legs: told where it is much, and true."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from quiet import quiet_scene
from small_scenes import SHORT
from state_samples import FloatArray

from cmbot import OptimisationFailed, Plan, load_scene, plan
from cmbot.elastic.modes import arm_modes
from cmbot.planning import bending_arm
from cmbot.planning.attempts.agenda import Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import NoWay
from cmbot.planning.attempts.stroke import plan_stroke
from cmbot.planning.initial_guess import InitialGuess
from cmbot.planning.request import StrokeRequest, build_request
from cmbot.planning.timing.quiet_laws import quiet_laws
from cmbot.planning.timing.timing import is_coarse, with_enough_via_points
from cmbot.planning.torque import Optimised
from cmbot.toolpath import LegLaw

SOFT = (2e4, 2e4, 1e5, 4e3, 4e3, 4e3)


def mast(seconds: float, stiffness: float = 1.0, via_points: int = 21, knots: str = "fixed") -> Any:
    legs = [{"by": [0, 0.1, 0], "seconds": seconds}]
    return {
        "format": "cmbot-scene/2",
        "name": "mast",
        "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
        "start": {"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
        "planner": {"knots": knots},
        "guardrail": {"bays": 0, "stiffness": np.diag(stiffness * np.array(SOFT)).tolist()},
        "tool_path": {"keep": "pose", "legs": legs, "via_points": via_points},
    }


def planned(seconds: float, **own: Any) -> Plan:
    return plan(load_scene(mast(seconds, **own)), progress=False)


def moved(made: Plan) -> float:
    assert made.sway is not None
    return made.sway.sway_mm + made.sway.swing_mm


def test_what_more_seconds_give_on_a_short_leg_is_told_and_true() -> None:
    short = planned(1.2)
    (told,) = (each for each in short.fallbacks if "periods of the slowest mode" in each)
    found = re.match(
        r"Leg 1 takes 1\.2 s, (.*) periods .* in (.*) s the tool .* by (.*) mm in place of (.*) mm", told
    )
    assert found is not None
    periods, longer, less, sway = (float(number) for number in found.groups())
    assert periods < 6 and longer > 1.2 and less <= 0.5 * sway
    assert moved(planned(longer)) < 0.6 * moved(short)
    # The same leg on a stiff mast has more periods.
    assert not any("periods" in each for each in planned(1.2, stiffness=50.0).fallbacks)


def test_quiet_strokes_have_as_many_via_points_as_their_law_needs() -> None:
    made = planned(3.0, via_points=8, knots="sliding")
    (told,) = (each for each in made.fallbacks if "via-points in place of 8" in each)
    number = len(made.trajectory.t)
    assert told.startswith(f"{number} via-points") and made.scene.strokes[0].via_points == number
    arm = bending_arm(made.scene, made.robot)
    assert arm is not None
    frequency = float(arm_modes(arm, made.trajectory.q[0]).frequencies[0])
    assert number - 1 == pytest.approx(4 * frequency * 3.0, abs=1.5)
    # On a stiffer mast a leg has more periods, and the most are taken; on a stiff one what is asked for.
    for stiffness, expected in ((50.0, 100), (400.0, 8)):
        scene = load_scene(mast(1.2, stiffness=stiffness, via_points=8, knots="sliding"))
        assert len(with_enough_via_points(build_request(scene, scene.planner, None)).times) == expected


def test_where_via_points_are_few_the_laws_of_each_leg_are_those_that_sway_least_as_simulated() -> None:
    data = mast(1.2, stiffness=400.0, via_points=8)
    data["tool_path"]["legs"] = [{"by": [0, way, 0], "seconds": 1.2} for way in (0.1, -0.1)]
    scene = load_scene(data)
    request = build_request(scene, scene.planner, None)
    assert is_coarse(request) and not is_coarse(replace(request, times=request.task.path.via_times(2000)))
    guess = Attempt.of(request).guess
    assert isinstance(guess, InitialGuess)
    tried: list[tuple[LegLaw, ...]] = []

    def simulated(laws: tuple[LegLaw, ...]) -> Any:
        tried.append(laws)
        return np.array([abs(len(tried) - 3), abs(len(tried) - 1)], dtype=float)

    laws, _ = quiet_laws(request, guess.problem.parametrization.trajectory, simulated)
    # Those predicted, then ever longer ramps.
    assert len(tried) > 3 and all(len(each) == 2 for each in tried)
    accelerations = [np.abs(each[0].law.rate(np.linspace(0, 1, 999), 2)).max() for each in tried[1:]]
    assert (np.diff(accelerations) <= 0).all() and accelerations[-1] < 0.8 * accelerations[0]
    for law, expected in zip(laws, (tried[2][0], tried[0][1]), strict=True):
        np.testing.assert_array_equal(law.jerk, expected.jerk)


def test_few_via_points_sway_less_by_laws_along_their_splines(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    file = tmp_path / "scene.json"
    data = quiet_scene(65223595, 1, str(tmp_path))
    data["tool_path"]["speed_profile"] = {"kind": "quiet"}
    file.write_text(json.dumps(data), encoding="utf-8")
    by_splines = plan(load_scene(file), progress=False)
    monkeypatch.setattr("cmbot.planning.attempts.attempt.is_coarse", lambda request: False)
    assert moved(by_splines) < 0.95 * moved(plan(load_scene(file), progress=False))


def test_where_no_path_is_optimised_laws_are_chosen_along_the_guess(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = Mock(side_effect=OptimisationFailed("nothing was found", constraint="jerk", violation=1.0))
    monkeypatch.setattr("cmbot.planning.attempts.attempt.optimise", refused)
    scene = load_scene(mast(2.0, knots="sliding"))
    attempt = Attempt.of(build_request(scene, scene.planner, None)).quiet()
    assert attempt.timing is not None and len(attempt.timing.laws) == 1


@pytest.mark.parametrize("leads", [True, False])
def test_no_laws_are_chosen_along_a_path_to_whose_start_nothing_leads(
    leads: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Then along one that starts where the arm is."""

    def fails(asked: StrokeRequest, *_: object, **__: object) -> None:
        raise asked.path_not_found("no collision-free approach was found", asked.state.posture)

    if not leads:
        monkeypatch.setattr("cmbot.planning.attempts.motion.approach_way", fails)
    refused = Mock(side_effect=OptimisationFailed("nothing was found", constraint="jerk", violation=1.0))
    monkeypatch.setattr("cmbot.planning.attempts.attempt.optimise", refused)
    monkeypatch.setattr(
        "cmbot.planning.attempts.stroke.searched_motion",
        lambda first, *_: Trial(attempt=first, outcome=first.guess),
    )
    scene = load_scene(
        SHORT
        | {
            "tool_path": SHORT["tool_path"] | {"speed_profile": {"kind": "quiet"}},
            "planner": {"knots": "sliding"},
        }
    )
    request = build_request(scene, scene.planner, None)
    plan_stroke(request)
    (call,) = refused.call_args_list
    start = call.args[0].parametrization.via_points[0]
    assert (np.abs(start - request.state.posture).max() > 0.01) == leads


def test_no_way_is_sought_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where nothing leads to the work by the laws of the guess, nothing does by laws that are chosen."""
    ends = list[tuple[float, ...]]()

    def fails(asked: StrokeRequest, end: FloatArray, *_: object, **__: object) -> None:
        ends.append(tuple(end))
        raise asked.path_not_found("no collision-free approach was found", asked.state.posture)

    monkeypatch.setattr("cmbot.planning.attempts.motion.approach_way", fails)
    monkeypatch.setattr("cmbot.planning.attempts.remedies.joined_starts", lambda *_: iter(()))
    path = SHORT["tool_path"] | {"speed_profile": {"kind": "quiet"}}
    scene = load_scene(SHORT | {"tool_path": path, "start": {"stow": True}, "planner": {"knots": "sliding"}})
    planned = plan_stroke(build_request(scene, scene.planner, None))
    assert isinstance(planned.trial.outcome, NoWay)
    assert len(ends) == len(set(ends)) > 0


def test_what_laws_are_chosen_along_is_what_is_planned_on_from(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cmbot.planning.attempts.attempt.optimise", Optimised.start)
    scene = load_scene(mast(2.0, knots="sliding"))
    attempt = Attempt.of(build_request(scene, scene.planner, None))
    assert isinstance(attempt.guess, InitialGuess) and not attempt.guess.optimised
    path = attempt.guess.problem.parametrization.trajectory
    timed = attempt.quiet()
    monkeypatch.setattr("cmbot.planning.timing.quiet_laws.quiet_laws", lambda *_: ((), None))
    plain = attempt.quiet()
    for each in (timed, plain):
        assert isinstance(each.guess, InitialGuess) and each.guess.optimised
        problem = each.guess.problem
        # No peak below what the path has at rest is sought.
        assert problem.lower_bound * problem.scale >= problem.at_via_points.max()
        np.testing.assert_allclose(problem.parametrization.via_points[-1], path.q[-1], atol=1e-6)
    assert timed.timing is not None and plain.timing is None
