"""What the planner tells while it plans: shares that never fall, and no figure that is below zero."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import PathNotFound
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import ExchangeReport, Progress
from cmbot.planning.flexibility.sag_compensation import MOST_ROUNDS
from cmbot.planning.progress import ProgressReporter


class Clock:
    """Time that goes on when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def told() -> list[Progress]:
    return []


@pytest.fixture
def reporter(clock: Clock, told: list[Progress]) -> ProgressReporter:
    return ProgressReporter(told.append, clock)


def a_pass(number: int) -> ExchangeReport:
    worst = Violation("jerk of joint_1", 0.5)
    return ExchangeReport(
        stage="peak", number=number, iterations=3, constraints=9, peak_torque=380.0, worst=worst
    )


def planned(**options: object) -> list[Progress]:
    """What is told while the short scene is planned."""
    told: list[Progress] = []
    cmbot.plan(short_scene(planner=options), progress=told.append)
    return told


@pytest.mark.parametrize(
    "options",
    [{}, {"knots": "sliding"}, {"knots": "sliding", "compensate": True}],
    ids=["fixed", "sliding", "compensated"],
)
def test_while_a_scene_is_planned(options: dict[str, object]) -> None:
    told = planned(**options)
    for before, after in pairwise(told):
        if (before.stage, before.step) == (after.stage, after.step) and None not in (
            before.share,
            after.share,
        ):
            assert before.share <= after.share  # type: ignore[operator]
    for progress in told:
        assert progress.share is None or 0.0 <= progress.share <= 1.0
        assert progress.left is None or progress.left.seconds >= 0.0
        assert progress.left is None or progress.share != 0.0
    stages = [progress.stage for progress in told]
    assert stages == sorted(stages, key=["path", "optimise", "certify"].index)
    timed = {progress.step for progress in told if progress.share and progress.left}
    assert "following the tool path as the baseline does" in timed
    if "knots" in options:
        charted = [progress.share for progress in told if "charting" in progress.step]
        assert charted[0] == pytest.approx(1 / 8)
        assert charted[-1] == 1.0
        assert "finding the least torque at rest" in {progress.step for progress in told}
    else:
        assert "following the tool path" in timed
    rounds = [progress for progress in told if progress.rounds]
    assert bool(rounds) == ("compensate" in options)
    for progress in rounds:
        assert progress.left.most == MOST_ROUNDS - progress.rounds + 1


def test_a_wide_self_motion_is_charted_twice() -> None:
    told: list[Progress] = []
    scene = short_scene(tool_path={"keep": "axis"}, planner={"knots": "sliding"})
    cmbot.plan(scene, progress=told.append)
    steps = [progress.step for progress in told]
    assert any("tool's axis" in step for step in steps)
    assert any("tool's pose" in step for step in steps)


@given(costs=st.lists(st.floats(0.01, 10.0), min_size=2, max_size=50))
def test_a_step_tells_of_its_parts(costs: list[float]) -> None:
    told: list[Progress] = []
    clock = Clock()
    reporter = ProgressReporter(told.append, clock)
    reporter.stage("path")
    for done, cost in enumerate(costs):
        reporter.part("doing it", done, len(costs))
        clock.now += cost
    reporter.part("doing it", len(costs), len(costs))
    shares = [progress.share for progress in told if progress.step]
    assert shares == pytest.approx([k / len(costs) for k in range(len(costs) + 1)])
    assert told[-1].left is None


def test_parts_of_equal_cost_are_foretold(
    clock: Clock, reporter: ProgressReporter, told: list[Progress]
) -> None:
    reporter.part("doing it", 0, 10)
    assert (told[-1].share, told[-1].left) == (0.0, None)
    for done in range(1, 10):
        clock.now += 3.0
        reporter.part("doing it", done, 10)
        left = told[-1].left
        assert left.seconds == pytest.approx(3.0 * (10 - done))
        assert not left.at_most


def test_a_share_that_falls_is_not_told(
    clock: Clock, reporter: ProgressReporter, told: list[Progress]
) -> None:
    for done in (0, 5, 1, 2, 6):
        clock.now += 1.0
        reporter.part("doing it", done, 10)
    assert [progress.share for progress in told] == [0.0, 0.5, 0.6]


def test_many_small_parts_are_not_all_told(reporter: ProgressReporter, told: list[Progress]) -> None:
    for done in range(100_001):
        reporter.part("doing it", done, 100_000)
    assert 90 <= len(told) <= 102
    assert told[-1].share == 1.0


def test_another_step_begins_anew(clock: Clock, reporter: ProgressReporter, told: list[Progress]) -> None:
    reporter.stage("path", failed_starts=2)
    reporter.part("one", 1, 2)
    clock.now += 5.0
    reporter.part("other", 1, 4, at_most=True)
    clock.now += 1.0
    reporter.part("other", 2, 4, at_most=True)
    left = told[-1].left
    assert (left.seconds, left.at_most) == (pytest.approx(2.0), True)
    assert {progress.failed_starts for progress in told} == {2}
    reporter.step("the last")
    assert (told[-1].step, told[-1].share, told[-1].left) == ("the last", None, None)


def test_things_are_told_as_their_turn_comes(reporter: ProgressReporter, told: list[Progress]) -> None:
    assert list(reporter.each("each leg", ["a", "b", "c", "d"])) == ["a", "b", "c", "d"]
    assert [progress.share for progress in told] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_of_passes_it_is_known_how_many_there_are_at_most(
    clock: Clock, reporter: ProgressReporter, told: list[Progress]
) -> None:
    reporter.stage("optimise")
    for number, cost in ((1, 2.0), (2, 4.0)):
        clock.now += cost
        reporter.passed(a_pass(number), "Nm", 40)
    left = told[-1].left
    assert left.sentence() == "at most 38 more passes, 3.0 s each"
    assert "pass 2 (peak): peak 380.00 Nm, jerk of joint_1 50.00% beyond its bound" in told[-1].sentence()
    reporter.passed(a_pass(40), "Nm", 40)
    assert told[-1].left is None


def test_a_round_of_compensation_costs_about_what_the_last_took(
    clock: Clock, reporter: ProgressReporter, told: list[Progress]
) -> None:
    reporter.stage("optimise")
    for rounds, costs in ((0, (1.0, 2.0)), (1, (2.0, 3.0)), (2, (1.0,))):
        for number, cost in enumerate(costs, start=1):
            clock.now += cost
            reporter.passed(a_pass(number), "Nm", 40, rounds=rounds, most_rounds=8)
    found = [progress.left for progress in told if progress.rounds]
    assert [left and left.sentence() for left in found] == [
        "at most 8 more rounds, 3.0 s each",
        "at most 8 more rounds, 3.0 s each",
        "at most 7 more rounds, 5.0 s each",
    ]
    assert told[-1].sentence(passes=False) == "compensating the sag, round 2"


def test_nobody_has_to_listen() -> None:
    ProgressReporter().part("doing it", 1, 2)


def test_a_start_that_fails_is_told() -> None:
    told: list[Progress] = []
    block = {"name": "block", "box": [0.2, 0.2, 0.2], "xyz": [1.8, 0.45, -2.06]}
    with pytest.raises(PathNotFound):
        cmbot.plan(short_scene(obstacles=[block], planner={"other_starts": 2}), progress=told.append)
    assert max(progress.failed_starts for progress in told) == 2
