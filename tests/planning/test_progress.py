"""What the planner tells while it plans: shares that never fall, and no figure that is below zero."""

import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_scenes import short_scene

import cmbot
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import ExchangeReport, Plan, Progress, remarks
from cmbot.planning.flexibility.sag_compensation import MOST_ROUNDS
from cmbot.planning.progress import ProgressReporter


class Listener:
    """What a reporter tells, by a clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now, self.told = 100.0, list[Progress]()
        self.reporter = ProgressReporter(self.told.append, lambda: self.now)

    def part(self, step: str, done: int, of: int, *, after: float = 0.0, **options: bool) -> Progress:
        """Tell of a part that is done after some seconds, s."""
        self.now += after
        self.reporter.part(step, done, of, **options)
        return self.told[-1]

    def passed(self, number: int, *, after: float = 0.0, **rounds: int) -> Progress:
        """Tell of a pass of the exchange that took some seconds, s."""
        self.now += after
        worst = Violation("jerk of joint_1", 0.5)
        report = ExchangeReport(
            stage="peak",
            number=number,
            iterations=3,
            ended=True,
            constraints=9,
            peak_torque=380.0,
            worst=worst,
        )
        self.reporter.passed(report, "Nm", 40, **rounds)
        return self.told[-1]


@pytest.fixture
def listener() -> Listener:
    return Listener()


@pytest.mark.parametrize(
    "options",
    [{}, {"knots": "sliding"}, {"knots": "sliding", "compensate": True}],
    ids=["fixed", "sliding", "compensated"],
)
def test_while_a_scene_is_planned(options: dict[str, object]) -> None:
    told: list[Progress] = []
    made = cmbot.plan(short_scene(planner=options), progress=told.append)
    for before, after in pairwise(told):
        same_step = (before.stage, before.step) == (after.stage, after.step)
        if same_step and None not in (before.share, after.share):
            assert before.share <= after.share
    for progress in told:
        assert progress.share is None or 0.0 <= progress.share <= 1.0
        assert progress.left is None or progress.left.seconds >= 0.0
        assert progress.left is None or progress.share != 0.0
    stages = [progress.stage for progress in told]
    assert (stages[0], stages[-1]) == ("path", "certify")
    assert stages == sorted(stages, key=["path", "optimise", "certify"].index)
    # Of the rounds of compensation the plan keeps the last one's passes.
    reports = tuple(progress.report for progress in told if progress.report)
    assert made.passes == (reports[-len(made.passes) :] if "compensate" in options else reports)
    timed = {progress.step for progress in told if progress.share and progress.left}
    assert "following the tool path as the baseline does" in timed
    if "knots" in options:
        charted = [progress.share for progress in told if "charting" in progress.step]
        assert charted[0] == pytest.approx(1 / 8)
        assert charted[-1] == 1.0
        assert "finding the least torque at rest" in {progress.step for progress in told}
    else:
        assert "following the tool path" in timed
    if "compensate" in options:
        check_rounds(made, told)
    else:
        assert not any(progress.rounds for progress in told)


def check_rounds(made: Plan, told: list[Progress]) -> None:
    """Of the compensation of the sag: which round it is, and how many are left at most."""
    passed = [progress for progress in told if progress.report]
    last, rounds = passed[-1], [progress.rounds for progress in passed]
    assert rounds == sorted(rounds)
    assert set(rounds) == set(range(made.compensation.rounds + 1))
    assert last.sentence().startswith(f"compensating the sag, round {last.rounds}, pass ")
    assert sum(progress.rounds == last.rounds for progress in told) == len(made.passes)
    for progress in told:
        assert not progress.rounds or progress.left.most == MOST_ROUNDS - progress.rounds + 1
    (time,) = (remark for remark in remarks(made) if remark.startswith("Time: "))
    words = rf"\({len(made.passes)} pass(es)? in the last of {made.compensation.rounds} rounds?\)"
    assert re.search(words, time)


def test_a_wide_self_motion_is_charted_twice() -> None:
    told: list[Progress] = []
    scene = short_scene(tool_path={"keep": "axis"}, planner={"knots": "sliding"})
    cmbot.plan(scene, progress=told.append)
    steps = [progress.step for progress in told]
    assert any("tool's axis" in step for step in steps)
    assert any("tool's pose" in step for step in steps)


@given(costs=st.lists(st.floats(0.01, 10.0), min_size=2, max_size=50))
def test_a_step_tells_of_its_parts(costs: list[float]) -> None:
    listener = Listener()
    listener.reporter.stage("path")
    for done, cost in enumerate([0.0, *costs]):
        last = listener.part("doing it", done, len(costs), after=cost)
    shares = [progress.share for progress in listener.told if progress.step]
    assert shares == pytest.approx([k / len(costs) for k in range(len(costs) + 1)])
    assert last.left is None


def test_parts_of_equal_cost_are_foretold(listener: Listener) -> None:
    first = listener.part("doing it", 0, 10)
    assert (first.share, first.left) == (0.0, None)
    for done in range(1, 10):
        left = listener.part("doing it", done, 10, after=3.0).left
        assert left.seconds == pytest.approx(3.0 * (10 - done))
        assert not left.at_most


def test_a_share_that_falls_is_not_told(listener: Listener) -> None:
    for done in (0, 5, 1, 2, 6):
        listener.part("doing it", done, 10, after=1.0)
    assert [progress.share for progress in listener.told] == [0.0, 0.5, 0.6]


def test_many_small_parts_are_not_all_told(listener: Listener) -> None:
    for done in range(100_001):
        last = listener.part("doing it", done, 100_000)
    assert 90 <= len(listener.told) <= 102
    assert last.share == 1.0


def test_another_step_begins_anew(listener: Listener) -> None:
    listener.reporter.stage("path", failed_starts=2)
    listener.part("one", 1, 2)
    listener.part("other", 1, 4, after=5.0, at_most=True)
    left = listener.part("other", 2, 4, after=1.0, at_most=True).left
    assert (left.seconds, left.at_most) == (pytest.approx(2.0), True)
    assert {progress.failed_starts for progress in listener.told} == {2}
    listener.reporter.step("the last")
    last = listener.told[-1]
    assert (last.step, last.share, last.left) == ("the last", None, None)


def test_things_are_told_as_their_turn_comes(listener: Listener) -> None:
    assert list(listener.reporter.each("each leg", ["a", "b", "c", "d"])) == ["a", "b", "c", "d"]
    assert [progress.share for progress in listener.told] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_of_passes_it_is_known_how_many_there_are_at_most(listener: Listener) -> None:
    listener.reporter.stage("optimise")
    listener.passed(1, after=2.0)
    second = listener.passed(2, after=4.0)
    assert second.left.sentence() == "at most 38 more passes, 3.0 s each"
    assert "pass 2 (peak): peak 380.00 Nm, jerk of joint_1 50.00% beyond its bound" in second.sentence()
    assert listener.passed(40).left is None


def test_a_round_of_compensation_costs_about_what_the_last_took(listener: Listener) -> None:
    listener.reporter.stage("optimise")
    for rounds, costs in ((0, (1.0, 2.0)), (1, (2.0, 3.0)), (2, (1.0,))):
        for number, cost in enumerate(costs, start=1):
            last = listener.passed(number, after=cost, rounds=rounds, most_rounds=8)
    found = [progress.left for progress in listener.told if progress.rounds]
    assert [left.sentence() for left in found] == [
        "at most 8 more rounds, 3.0 s each",
        "at most 8 more rounds, 3.0 s each",
        "at most 7 more rounds, 5.0 s each",
    ]
    assert last.sentence(passes=False) == "compensating the sag, round 2"


def test_nobody_has_to_listen() -> None:
    ProgressReporter().part("doing it", 1, 2)


def test_what_is_sought_beside_has_the_time_left_or_less() -> None:
    clock = Listener()
    reporter = ProgressReporter(clock=lambda: clock.now, limit=60.0)
    clock.now += 50.0
    assert reporter.silent().time_left == 10.0
    assert reporter.silent(15.0).time_left == 10.0
    brief = reporter.silent(5.0)
    clock.now += 5.0
    assert brief.expired() and not reporter.expired()


@pytest.mark.parametrize(
    ("used", "more", "over"), [(59, 0, False), (60, 0, True), (71, 0.2, False), (72, 0.2, True)]
)
def test_what_is_a_must_may_exceed_the_limit(used: float, more: float, over: bool) -> None:
    clock = Listener()
    reporter = ProgressReporter(clock=lambda: clock.now, limit=60.0)
    clock.now += used
    assert reporter.expired(more) is over
