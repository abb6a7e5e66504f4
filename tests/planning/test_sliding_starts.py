"""Where sliding knots start: in the scene's posture as long as that leads on, or is as good as another."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_scenes import parts, request_of, short_scene

from cmbot.common.errors import PathNotFound
from cmbot.planning import GlobalSearch, Plan, Segment, SplineSpace, plan, planner, remarks
from cmbot.planning.attempts import motion
from cmbot.planning.free_motion.approach import plan_approach
from cmbot.robot import Dynamics

# Beside the elbow: from the scene's posture the arm cannot get past it, from another it can.
BALL = {"name": "ball", "sphere": 0.0555, "xyz": [0.95, 0.52, -1.0]}
PINNED = {"knots": "sliding", "start": "pinned"}


def test_a_pinned_start_that_leads_nowhere_is_left_for_the_nearest_that_does() -> None:
    # Towards the foot, so that the locked joints hold what is near.
    legs = [{"by": [-0.08, -0.3, 0.08], "seconds": 4}]
    scene = short_scene(obstacles=[BALL], planner=PINNED, tool_path={"legs": legs})
    planned = plan(scene)
    assert planned.certificate.holds
    first = planned.start.failures[0]
    assert "no way was found through via-point" in first.reason
    assert 0 < first.progress < 1
    assert 0.01 < planned.start.moved < 0.3
    np.testing.assert_allclose(planned.trajectory.q[0], planned.start.posture, rtol=0, atol=1e-9)
    assert planned.choice.pinned is None
    # It gets there by a certified approach, and says so.
    np.testing.assert_allclose(planned.approach.trajectory.q[0], scene.posture, rtol=0, atol=1e-12)
    said = " ".join(remarks(planned))
    assert "Starts elsewhere" in said
    assert first.reason in said


@pytest.mark.parametrize(("tries", "words"), [(0, ""), (1, "; 1 other starting posture fails as well")])
def test_a_pinned_start_with_few_others_to_try(
    monkeypatch: pytest.MonkeyPatch, tries: int, words: str
) -> None:
    # Slower legs would do, which takes a while to find out.
    monkeypatch.setattr(planner, "advice", lambda trial: "")
    monkeypatch.setattr(planner, "slower_legs", lambda *_: None)
    scene = short_scene(obstacles=[{**BALL, "sphere": 0.0666}], planner={**PINNED, "other_starts": tries})
    with pytest.raises(PathNotFound) as caught:
        plan(scene)
    assert "no way was found through via-point" in str(caught.value)
    assert words in str(caught.value)
    assert ("other starting" in str(caught.value)) == (tries > 0)


@pytest.mark.parametrize("start", ["free", "pinned"])
@pytest.mark.parametrize(
    ("gap", "words"),
    [(-0.01, "tool reaches 0.0100 m into block"), (0.01, "tool comes within 0.0100 m of block")],
)
def test_a_scenes_posture_that_is_not_clear_is_named(start: str, gap: float, words: str) -> None:
    """The tool is a cylinder of radius 0.04 m."""
    at = parts(short_scene())[1].path.corners[0] + np.array([0, 0.05 + 0.04 + gap, 0])
    block = {"name": "block", "box": [0.1, 0.1, 0.1], "xyz": at.tolist()}
    with pytest.raises(
        PathNotFound, match=rf"in the scene's posture {words}, the safety margin is"
    ) as caught:
        plan(short_scene(obstacles=[block], planner={"knots": "sliding", "start": start}))
    assert caught.value.pair == ("tool", "block")
    assert caught.value.progress == 0


def test_a_free_start_stays_where_nothing_is_gained_by_leaving() -> None:
    scene = short_scene(planner={"knots": "sliding"})
    moved = plan(scene)
    assert moved.start.moved > 0
    gain = moved.choice.pinned / moved.choice.free - 1
    stays = plan(scene, options=replace(scene.planner, min_gain=1.01 * gain))
    assert stays.start.moved == 0
    assert stays.approach is None
    leaves = plan(scene, options=replace(scene.planner, min_gain=0.99 * gain))
    assert leaves.start.moved > 0


def test_a_pinned_start_that_is_not_admissible_is_what_is_named() -> None:
    scene = short_scene(obstacles=[{**BALL, "sphere": 0.1}], planner=PINNED)
    stage = GlobalSearch(request_of(scene))
    assert stage.solve(pinned=False).peak > 0
    expected = r"via-point 1 of 8 is blocked: in the posture to start in \S+ and \S+ come within the safety"
    with pytest.raises(PathNotFound, match=expected) as caught:
        stage.solve(pinned=True)
    assert caught.value.progress == 0


def outward(segment: Segment, degrees: float) -> Segment:
    """An approach that stretches the arm out on its way."""
    x = segment.trajectory
    q = x.q.copy()
    q[:, 1] += np.radians(degrees) * np.sin(np.pi * x.t / x.t[-1]) ** 2
    space = SplineSpace(x.t)
    return replace(segment, trajectory=space.trajectory(space.least_jerk(q)))


def planned_with_approach(degrees: float, monkeypatch: pytest.MonkeyPatch) -> tuple[Plan, float]:
    """A plan whose approach, if it has one, stretches the arm out, and the peak that this asks, Nm."""
    found: list[Segment] = []

    def heavy(*given: Any, **named: Any) -> Segment:
        found.append(outward(plan_approach(*given, **named), degrees))
        return found[-1]

    monkeypatch.setattr(motion, "plan_approach", heavy)
    planned = plan(short_scene(planner={"knots": "sliding"}))
    (approach,) = found
    times = np.linspace(0, approach.duration, 400)
    efforts = Dynamics(planned.robot).efforts(*approach.trajectory.states(times))
    return planned, float(np.linalg.norm(efforts.guardrail_torque, axis=1).max())


def test_a_better_start_whose_approach_asks_more_than_the_whole_other_job_is_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Less torque at work is no gain where the way there asks more than the job from the scene's posture."""
    planned, asked = planned_with_approach(25.0, monkeypatch)
    assert planned.choice is not None
    assert planned.choice.free < 1.01 * planned.choice.pinned < asked
    assert (planned.start.moved, planned.approach) == (0.0, None)
    assert planned.runs == 2
    said = "A start that is better at work is not used: the approach to it would have a peak of "
    assert any(line.startswith(said) for line in planned.fallbacks)
    assert planned.job.figures.peak_guardrail_torque < asked


def test_an_approach_that_asks_hardly_more_is_no_reason_for_another_plan(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planned, asked = planned_with_approach(3.0, monkeypatch)
    assert planned.choice is not None
    assert 1.002 * planned.choice.pinned < asked < 1.01 * planned.choice.pinned
    assert planned.approach is not None
    assert planned.fallbacks == ()
