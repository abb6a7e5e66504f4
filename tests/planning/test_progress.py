"""What the planner tells while it plans: shares that never fall, and no figure that is below zero."""

from itertools import pairwise

import pytest
from hypothesis import given, strategies as st
from small_scenes import short_scene

import cmbot
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import Deadline, ExchangeReport, Progress
from cmbot.planning.progress import ProgressReporter


class Listener:
    """What a reporter tells, by a clock that goes on when it is told to."""

    def __init__(self) -> None:
        self.now, self.told = 100.0, list[Progress]()
        self.reporter = ProgressReporter(self.told.append, lambda: self.now)

    def part(self, step: str, done: int, of: int) -> Progress:
        """Tell of a part that is done."""
        self.reporter.part(step, done, of)
        return self.told[-1]

    def passed(self, number: int) -> Progress:
        """Tell of a pass of the exchange."""
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
        self.reporter.passed(report, "Nm")
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
    stages = [progress.stage for progress in told]
    assert (stages[0], stages[-1]) == ("path", "certify")
    assert stages == sorted(stages, key=["path", "optimise", "certify"].index)
    assert made.passes == tuple(progress.report for progress in told if progress.report)
    assert [report.number for report in made.passes] == list(range(1, len(made.passes) + 1))
    timed = {progress.step for progress in told if progress.share}
    assert "following the tool path as the baseline does" in timed
    if "knots" in options:
        charted = [progress.share for progress in told if "charting" in progress.step]
        assert charted[0] == pytest.approx(1 / 8)
        assert charted[-1] == 1.0
        assert "finding the least torque at rest" in {progress.step for progress in told}
    else:
        assert "following the tool path" in timed


def test_a_wide_self_motion_is_charted_twice() -> None:
    told: list[Progress] = []
    scene = short_scene(tool_path={"keep": "axis"}, planner={"knots": "sliding"})
    cmbot.plan(scene, progress=told.append)
    steps = [progress.step for progress in told]
    assert any("tool's axis" in step for step in steps)
    assert any("tool's pose" in step for step in steps)


@given(parts=st.integers(2, 50))
def test_a_step_tells_of_its_parts(parts: int) -> None:
    listener = Listener()
    listener.reporter.stage("path")
    for done in range(parts + 1):
        listener.part("doing it", done, parts)
    shares = [progress.share for progress in listener.told if progress.step]
    assert shares == pytest.approx([k / parts for k in range(parts + 1)])


def test_a_share_that_falls_is_not_told(listener: Listener) -> None:
    for done in (0, 5, 1, 2, 6):
        listener.part("doing it", done, 10)
    assert [progress.share for progress in listener.told] == [0.0, 0.5, 0.6]


def test_many_small_parts_are_not_all_told(listener: Listener) -> None:
    for done in range(100_001):
        last = listener.part("doing it", done, 100_000)
    assert 90 <= len(listener.told) <= 102
    assert last.share == 1.0


def test_another_step_begins_anew(listener: Listener) -> None:
    listener.reporter.stage("path", failed_starts=2)
    listener.part("one", 1, 2)
    assert listener.part("other", 1, 4).share == 0.25
    assert {progress.failed_starts for progress in listener.told} == {2}
    listener.reporter.step("the last")
    last = listener.told[-1]
    assert (last.step, last.share) == ("the last", None)


def test_things_are_told_as_their_turn_comes(listener: Listener) -> None:
    assert list(listener.reporter.each("each leg", ["a", "b", "c", "d"])) == ["a", "b", "c", "d"]
    assert [progress.share for progress in listener.told] == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_a_pass_is_told_in_words(listener: Listener) -> None:
    listener.reporter.stage("optimise")
    said = listener.passed(2).sentence()
    assert said == "optimising, pass 2 (peak): peak 380.00 Nm, jerk of joint_1 50.00% beyond its bound"


def test_steps_are_logged_once(listener: Listener, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("DEBUG", "cmbot"):
        for done in range(3):
            listener.part("seeking", done, 3)
        listener.passed(1)
    assert [record.getMessage() for record in caplog.records] == [
        "following the tool path: seeking",
        "optimising, pass 1 (peak): peak 380.00 Nm, jerk of joint_1 50.00% beyond its bound",
    ]


def test_nobody_has_to_listen() -> None:
    ProgressReporter().part("doing it", 1, 2)


@pytest.mark.parametrize(
    ("used", "more", "over"), [(59, 0, False), (60, 0, True), (71, 0.2, False), (72, 0.2, True)]
)
def test_what_is_a_must_may_exceed_the_limit(used: float, more: float, over: bool) -> None:
    now = [100.0]
    deadline = Deadline(60.0, lambda: now[0])
    now[0] += used
    assert deadline.expired(more) is over
