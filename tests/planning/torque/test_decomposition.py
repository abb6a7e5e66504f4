"""Long paths: parted where legs meet, each part a problem of its own, together one smooth trajectory."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from small_scenes import problem_of, short_scene, torque_along

from cmbot.archive import load_plan, save
from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.exchange import ExchangeReport
from cmbot.planning import plan, remarks
from cmbot.planning.certification.certificate import certify
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.timing.timing import in_time
from cmbot.planning.torque import decomposition
from cmbot.planning.torque.decomposition import optimise, segments
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.scene import Scene
from cmbot.toolpath import LegLaw

LEGS = [{"by": [0, side * 0.1, 0], "seconds": 3.0} for side in (-1, 1, -1, 1)]


def to_and_fro(knots: str, **planner: object) -> Scene:
    return short_scene(
        tool_path={"legs": LEGS, "via_points": 33},
        planner={"solver": "sqp", "knots": knots, **planner},
    )


@pytest.fixture(autouse=True)
def short_ones_are_long(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(decomposition, "LONGEST_WHOLE", 20)
    monkeypatch.setattr(decomposition, "_MIN_PART_VIA_POINTS", 6)
    monkeypatch.setattr(decomposition, "_MAX_PART_VIA_POINTS", 12)
    yield


@pytest.fixture(scope="module", params=["sliding", "fixed"])
def problem(request: pytest.FixtureRequest) -> TorqueProblem:
    return problem_of(to_and_fro(request.param))


def test_segments_end_where_legs_meet(problem: TorqueProblem) -> None:
    asked = problem.request
    parts = segments(problem)
    assert parts[0][0] == 0 and parts[-1][1] == 32
    assert all(end == start for (_, end), (start, _) in pairwise(parts))
    assert len(parts) == 4
    inner = [asked.times[end] for _, end in parts[:-1]]
    assert np.isin(np.round(inner, 9), np.round(asked.task.path.leg_times, 9)).all()


def test_short_paths_are_one_segment(problem: TorqueProblem, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decomposition, "LONGEST_WHOLE", 33)
    assert segments(problem) == [(0, 32)]


def test_of_the_corners_in_reach_the_one_with_the_least_objective_is_an_end(
    problem: TorqueProblem, monkeypatch: pytest.MonkeyPatch
) -> None:
    corners = [end for _, end in segments(problem)[:2]]
    monkeypatch.setattr(decomposition, "_MAX_PART_VIA_POINTS", 18)
    assert corners[1] <= 18
    for best in corners:
        monkeypatch.setattr(problem, "at_via_points", np.where(np.arange(33) == best, 1.0, 2.0))
        assert segments(problem)[0] == (0, best)


def test_what_slsqp_solves_and_a_leg_without_corners_are_one_segment() -> None:
    leg = {"legs": [{"by": [0, -0.2, 0], "seconds": 12.0}], "via_points": 33}
    straight = problem_of(short_scene(tool_path=leg, planner={"solver": "sqp", "knots": "fixed"}))
    for problem in (straight, problem_of(to_and_fro("fixed", solver="slsqp"))):
        assert segments(problem) == [(0, 32)]


def test_what_is_joined_is_smooth_certified_and_counted_through(problem: TorqueProblem) -> None:
    asked = problem.request
    told: list[ExchangeReport] = []
    found = optimise(problem, told.append)
    assert [report.number for report in told] == list(range(1, len(told) + 1))
    assert found.passes == tuple(told)
    np.testing.assert_array_equal(found.trajectory.t, problem.space.t)
    np.testing.assert_allclose(found.trajectory.q, found.via_points, rtol=0, atol=1e-12)
    ends = [end for _, end in segments(problem)[:-1]]
    assert not found.trajectory.v[ends].any() and not found.trajectory.a[ends].any()
    # Position, velocity, acceleration and jerk are continuous at every inner knot.
    jerk = found.trajectory.evaluate(problem.space.t[1:-1], 3)
    before = found.trajectory.evaluate(problem.space.t[1:-1] - 1e-9, 3)
    np.testing.assert_allclose(before, jerk, rtol=0, atol=1e-6 * asked.cell.robot.limits.jerk.max())
    certificate = certify(
        asked.cell.robot,
        asked.task,
        found.trajectory,
        asked.cell.clearances,
        asked.cell.options,
        via_points=len(asked.times),
    )
    certificate.require()


def test_the_peak_is_that_of_the_path_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of(to_and_fro("sliding"))
    parted = optimise(problem)
    monkeypatch.setattr(decomposition, "LONGEST_WHOLE", 33)
    whole = optimise(problem)
    peaks = [torque_along(problem, each.trajectory, problem.grid).max() for each in (parted, whole)]
    assert peaks[0] <= peaks[1] * (1 + 1e-3)


def test_where_a_segment_fails_the_path_is_solved_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The plan says so, also when it is read again."""
    monkeypatch.setattr(decomposition, "LONGEST_WHOLE", 10)
    planner = {"solver": "sqp", "knots": "sliding", "start": "pinned"}
    scene = short_scene(tool_path={"legs": LEGS[:2], "via_points": 17}, planner=planner)
    assert plan(scene).fallbacks == ()
    asked: list[int] = []

    def failing(problem: TorqueProblem, first: int, last: int) -> TorqueProblem:
        asked.append(first)
        raise OptimisationFailed("nothing to be done", constraint="any", violation=1.0)

    monkeypatch.setattr(TorqueProblem, "segment", failing)
    made = plan(scene)
    assert asked == [0]
    assert len(made.trajectory.t) == 17
    (said,) = made.fallbacks
    assert said.startswith("The path was optimised as a whole, as a segment failed (nothing to be done")
    assert said in list(remarks(made))
    assert load_plan(save(made, tmp_path / "plan")).fallbacks == (said,)


@pytest.mark.parametrize(("near", "timed"), [(False, False), (True, False), (True, True)])
def test_a_segment_that_fails_far_from_its_ends_fails_on_the_whole_path(
    monkeypatch: pytest.MonkeyPatch, near: bool, timed: bool
) -> None:
    """So does one where all legs have laws along a joint path, which rests at all ends anyway."""
    problem = problem_of(to_and_fro("sliding"))
    if timed:
        laws = [LegLaw(leg=k, seconds=(1.5, 1.5), jerk=(0.0, 1.0, 0.0)) for k in range(len(LEGS))]
        problem = initial_guess(in_time(problem.request, laws)).problem
    monkeypatch.setattr(decomposition, "_RESTING", 2)
    (_, end), *_ = segments(problem)
    time = float(problem.space.t[end - (1 if near else 4)])

    def failing(problem: TorqueProblem, first: int, last: int) -> TorqueProblem:
        raise OptimisationFailed("nothing to be done", constraint="any", violation=1.0, time=time)

    monkeypatch.setattr(TorqueProblem, "segment", failing)
    if near and not timed:
        assert optimise(problem).whole_because == "nothing to be done"
    else:
        with pytest.raises(OptimisationFailed, match="nothing to be done"):
            optimise(problem)
