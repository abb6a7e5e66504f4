"""The space of free postures: what it spares."""

from __future__ import annotations

import numpy as np

from cmbot.collision import Clearances
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.robot import Robot, load_robot

# TIAGo's lift and arm; in between its wrist comes 20.995 mm near the forearm, as it does in most postures.
START = [0.35, 1.308, -1.069, -2.936, 1.673, -1.453, -0.765, 2.094]
END = [0.345, 2.012, -0.934, -3.262, 1.459, 0.997, 0.724, 1.149]
MARGIN = 0.02


def free_space(robot: Robot) -> FreeSpace:
    return FreeSpace(robot, Clearances(robot, ()), MARGIN, lambda q: np.zeros(len(q)))


def test_links_that_are_always_near_each_other_do_not_shut_the_space() -> None:
    robot = load_robot("tiago", base_frame="torso_fixed_link", tool_frame="arm_7_link")
    whole, ends = free_space(robot), np.array([START, END])
    space = whole.around(ends)
    assert space is not None
    line = START + np.linspace(0, 1, 400)[:, None] * np.subtract(END, START)
    least = whole.clearances.query(line).distance.min()
    assert MARGIN + space.spare < least < whole.clearances.query(ends).distance.min() - 1e-3
    assert space.straight(*ends)
    # Found in random postures.
    near = whole.clearances.always_near
    assert ((near > MARGIN) & (near < least + 1e-4)).any()


def test_an_arm_whose_links_come_apart_spares_what_its_ends_do(cmbot_robot: Robot) -> None:
    space = free_space(cmbot_robot)
    assert not len(space.clearances.always_near)
    ends = np.array([[0.0, 0.3, 0.0, 0.6, 0.0, 0.4, 0.0]])
    left = space.clearances.query(ends).distance[0] - MARGIN
    around = space.around(ends)
    assert around is not None
    assert around.spare == min(space.spare, left / 2)
