"""Free paths on which the largest cost is least."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning.budget import Deadline
from cmbot.planning.free_motion import roadmap
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.free_motion.roadmap import lower_peak
from cmbot.planning.free_motion.rrt_connect import MOST_GROWTHS, _Tree, rrt_connect
from cmbot.planning.workcell.workcell import robot_of

START, END = np.radians([[-10, -90, 90, -60, 10, 50, 0], [-10, -90, 90, 60, 10, 50, 40]])


def hill(q: FloatArray) -> FloatArray:
    """A ridge between start and end, with a pass beside it."""
    return np.exp(-((q[:, 3] / 0.3) ** 2)) * np.minimum(1.0, (q[:, 6] - 1.2) ** 2) + 0.1


def wall(q: FloatArray) -> FloatArray:
    """No posture but beside it can be held."""
    return np.where((np.abs(q[:, 3]) < 0.3) & (q[:, 6] < 1.0), np.inf, 1.0)


@pytest.fixture(scope="module")
def space() -> FreeSpace:
    robot = robot_of(short_scene())
    return FreeSpace(robot, Clearances(robot, ()), 0.0, hill)


def test_the_path_leads_over_the_pass(space: FreeSpace) -> None:
    straight = np.stack([START, END])
    assert space.peak(straight) > 0.8
    lowered = lower_peak(space, straight, 0.2)
    assert space.peak(lowered) <= 0.2
    np.testing.assert_array_equal(lowered[[0, -1]], straight)
    assert all(space.straight(a, b) for a, b in pairwise(lowered))
    np.testing.assert_array_equal(lower_peak(space, straight, 0.2), lowered)


def test_it_ends_where_more_postures_hardly_help(space: FreeSpace, monkeypatch: pytest.MonkeyPatch) -> None:
    """No path is below the hill's foot, which is asked for."""
    rounds, anywhere = [0], roadmap._anywhere

    def counted(*arguments: Any) -> FloatArray:
        rounds[0] += 1
        return anywhere(*arguments)

    monkeypatch.setattr(roadmap, "_anywhere", counted)
    straight = np.stack([START, END])
    lowered = lower_peak(space, straight, 0.0)
    assert 2 <= rounds[0] < roadmap._MAX_ROADMAP_ROUNDS
    found, rounds[0] = rounds[0], 0
    with monkeypatch.context() as blocked:
        blocked.setattr(FreeSpace, "straight", lambda *_: False)
        blocked.setattr(roadmap, "_MAX_CHECKED_EDGES", 10)
        assert lower_peak(space, straight, 0.0) is straight
    assert rounds[0] == roadmap._FRUITLESS_AT_FIRST < roadmap._MAX_ROADMAP_ROUNDS
    rounds[0] = found
    monkeypatch.setattr(roadmap, "_FRUITLESS", np.inf)
    monkeypatch.setattr(roadmap, "_MAX_ROADMAP_ROUNDS", rounds[0] + 2)
    assert space.peak(lowered) <= (1 + roadmap._LITTLE) * space.peak(lower_peak(space, straight, 0.0))


def test_what_is_low_enough_or_out_of_time_stays(space: FreeSpace) -> None:
    straight = np.stack([START, END])
    assert lower_peak(space, straight, 0.9) is straight
    assert lower_peak(space, straight, 0.2, lambda: True) is straight


def test_the_time_limit_holds_where_costs_take_long(space: FreeSpace) -> None:
    """On a clock that goes on by 1 s with every posture: a round computes few beside those that it draws."""
    spent = [0.0]

    def slow_hill(q: FloatArray) -> FloatArray:
        spent[0] += len(q)
        return hill(q)

    deadline = Deadline(30_000.0, lambda: spent[0])
    lowered = lower_peak(replace(space, cost=slow_hill), np.stack([START, END]), 0.0, deadline.expired)
    assert space.peak(lowered) < 0.2
    assert 30_000.0 < spent[0] < 40_000.0


def test_trees_lead_around_postures_that_cannot_be_held(space: FreeSpace) -> None:
    walled = FreeSpace(space.robot, space.clearances, 0.0, wall)
    assert not walled.straight(START, END)
    path = rrt_connect(walled, START, END[None])
    for line in (path, walled.shorten(path), lower_peak(walled, path, 0.5)):
        assert walled.peak(line) == 1.0
        assert all(walled.straight(a, b) for a, b in pairwise(line))


def test_trees_lead_to_the_one_of_several_postures_that_can_be_reached(
    space: FreeSpace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The nearest of them is shut in."""
    shut = START + 0.2 * (END - START)
    shut[4] += 0.5

    def cost(q: FloatArray) -> FloatArray:
        away = np.linalg.norm(q - shut, axis=1)
        return np.where((away > 0.1) & (away < 0.6), np.inf, wall(q))

    walled = FreeSpace(space.robot, space.clearances, 0.0, cost)
    assert walled.holds(np.stack([START, END, shut])).all()
    path = rrt_connect(walled, START, np.stack([shut, END]))
    np.testing.assert_array_equal(path[[0, -1]], [START, END])
    assert rrt_connect(walled, START, shut[None], stop=iter([*50 * [False], True]).__next__) is None
    # Around it there is soon nothing new; without that all growths would be tried.
    steps, grow = [0], _Tree.grow

    def counted(tree: _Tree, *arguments: Any) -> int | None:
        steps[0] += 1
        return grow(tree, *arguments)

    monkeypatch.setattr(_Tree, "grow", counted)
    assert rrt_connect(walled, START, shut[None]) is None
    assert steps[0] < MOST_GROWTHS


def test_a_line_is_checked_wherever_it_may_be_blocked(space: FreeSpace) -> None:
    """However thin the part that costs too much is, to the distance between checks."""
    thin = FreeSpace(space.robot, space.clearances, 0.0, lambda q: np.abs(q[:, 3] - 0.5) < 0.02)
    assert thin.straight(START, END)
    assert not thin.below(0.0).straight(START, END)
    assert thin.below(0.0).straight(START, START + 0.4 * (END - START))
