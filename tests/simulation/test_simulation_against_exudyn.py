"""Geometrically exact beams with joints as constraints: another formulation, another program."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from elastic_in_exudyn import simulate
from elastic_robots import Link, second_moment, tube, write_robot
from numpy.typing import NDArray
from small_motions import tool_points

from cmbot.elastic import ElasticBase
from cmbot.elastic.arm import ElasticOptions, elastic_arm
from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Robot
from cmbot.trajectory import QuinticTrajectory

FloatArray = NDArray[np.float64]
DIAMETER, WALL, LENGTH, DENSITY, PAYLOAD = 0.04, 0.002, 0.9, 2700.0, 2.0
AREA = np.pi / 4 * (DIAMETER**2 - (DIAMETER - 2 * WALL) ** 2)
SECOND_MOMENT = second_moment(DIAMETER, WALL)
OUTPUT = 0.02


def two_tubes(folder: Path) -> Robot:
    """The first tube goes up and down, the second sideways."""
    mass = DENSITY * AREA * LENGTH
    slim = DENSITY * SECOND_MOMENT * LENGTH
    inertia = np.diag([2 * slim, mass * LENGTH**2 / 12 + slim, mass * LENGTH**2 / 12 + slim])
    links = [
        Link(
            mass=mass,
            com=np.array([LENGTH / 2, 0.0, 0.0]),
            inertia=inertia,
            xyz=np.array([start, 0.0, 0.0]),
            rpy=np.array([roll, 0.0, 0.0]),
            axis=np.array([0.0, 0.0, 1.0]),
            tube=tube([0, 0, 0], [LENGTH, 0, 0], DIAMETER, WALL),
        )
        for start, roll in ((0.0, np.pi / 2), (LENGTH, -np.pi / 2))
    ]
    return write_robot(folder, links, np.array([LENGTH, 0.0, 0.0]), payload=PAYLOAD)


def ours(robot: Robot, base: ElasticBase, drive: QuinticTrajectory, segments: int) -> FloatArray:
    arm = elastic_arm(robot, base, ElasticOptions(segments=segments))
    start = Sag(arm).at(drive.states([0.0])[0]).u[0]
    system = ElasticSystem.of(arm, np.zeros_like(arm.stiffness))
    integrator = GeneralizedAlpha(system, step=5e-4, rho_inf=0.8, corrections=2)
    motion = integrator.run([drive], start, np.zeros_like(start))
    every = round(OUTPUT / 5e-4)
    return tool_points(arm, motion.joints[::every], motion.u[::every])


@pytest.mark.slow
# Newer Exudyn has other names for much of what older ones know.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_exudyn_moves_the_tool_alike(tmp_path: Path) -> None:
    """Undamped: within 0.05 mm of a vibration of 10 mm; the more segments, the nearer."""
    robot = two_tubes(tmp_path)
    # A hold that moves some millimetres, and couples; massless, for Exudyn has no matrix for it.
    stiffness = np.diag([2e5, 3e5, 4e5, 2e4, 3e4, 2.5e4])
    stiffness[0, 4] = stiffness[4, 0] = 1e4
    none = np.zeros((6, 6))
    base = ElasticBase(stiffness=stiffness, mass=none, damping=none)
    t = np.linspace(0.0, 1.2, 25)
    out_and_back = np.sin(np.pi * t / 1.2) ** 2
    drive = QuinticTrajectory.through(
        t, np.column_stack([0.3 + 0.2 * out_and_back, -0.4 + 0.5 * out_and_back])
    )
    theirs = simulate(robot, base, drive, elements=16, step=1e-3, every=round(OUTPUT / 1e-3))
    apart = []
    for segments in (1, 2, 4):
        points = ours(robot, base, drive, segments)
        # One segment has the tube's own weight in two lumps.
        np.testing.assert_allclose(points[0], theirs[0], atol=1e-4 / segments**2)
        apart.append(np.abs(points - theirs).max())
    assert apart[0] < 5e-4
    assert apart[1] < 1e-4
    assert apart[2] < 5e-5
    assert apart[0] > apart[1] > apart[2]

    # It was not the rigid motion that was compared.
    q = drive.states(OUTPUT * np.arange(len(theirs)))[0]
    sag = Sag(elastic_arm(robot, base)).at(q).tool
    dynamic = theirs - Kinematics(robot).tool_poses(q)[0] - sag
    assert np.abs(sag).max() > 1e-2
    assert np.abs(dynamic).max() > 5e-3
