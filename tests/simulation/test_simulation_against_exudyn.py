"""Geometrically exact beams with joints as constraints: another formulation, another program."""

from __future__ import annotations

import numpy as np
import pytest
from elastic_in_exudyn import BeamArm, simulate
from elastic_robots import SHEAR, YOUNG, Link, second_moment, tube, write_robot
from numpy.typing import NDArray
from small_motions import tool_points

from cmbot.elastic import ElasticBase
from cmbot.elastic.arm import ElasticOptions, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.robot import Kinematics, Robot
from cmbot.simulation import PrescribedMotion
from cmbot.simulation.generalized_alpha import ElasticSystem, GeneralizedAlpha

FloatArray = NDArray[np.float64]
DIAMETER, WALL, LENGTH, DENSITY, PAYLOAD = 0.04, 0.002, 0.9, 2700.0, 2.0
AREA = np.pi / 4 * (DIAMETER**2 - (DIAMETER - 2 * WALL) ** 2)
SECOND_MOMENT = second_moment(DIAMETER, WALL)
OUTPUT = 0.02


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Two uniform tubes: the first goes up and down, the second sideways."""
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
    folder = tmp_path_factory.mktemp("beams") / "arm"
    return write_robot(folder, links, np.array([LENGTH, 0.0, 0.0]), payload=PAYLOAD)


@pytest.fixture(scope="module")
def base() -> ElasticBase:
    """A hold that moves some millimetres, and couples; massless, for Exudyn has no matrix for it."""
    stiffness = np.diag([2e5, 3e5, 4e5, 2e4, 3e4, 2.5e4])
    stiffness[0, 4] = stiffness[4, 0] = 1e4
    return ElasticBase(stiffness=stiffness, mass=np.zeros((6, 6)), frequencies=np.zeros(0))


@pytest.fixture(scope="module")
def drive() -> PrescribedMotion:
    t = np.linspace(0.0, 2.0, 41)
    out_and_back = np.sin(np.pi * t / 2.0) ** 2
    return PrescribedMotion.through(t, np.column_stack([0.3 + 0.3 * out_and_back, -0.4 + 0.8 * out_and_back]))


@pytest.fixture(scope="module")
def theirs(robot: Robot, base: ElasticBase, drive: PrescribedMotion) -> FloatArray:
    carrier = robot.model.inertias[0]
    com = carrier.lever
    about = carrier.inertia + carrier.mass * (com @ com * np.eye(3) - np.outer(com, com))
    placements = [robot.model.jointPlacements[joint].rotation for joint in (1, 2)]
    arm = BeamArm(
        base_stiffness=base.stiffness,
        carrier=(carrier.mass, about[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]], com),
        turns=np.array(placements),
        length=LENGTH,
        mass_per_length=DENSITY * AREA,
        EI=YOUNG * SECOND_MOMENT,
        GJ=2 * SHEAR * SECOND_MOMENT,
        EA=YOUNG * AREA,
        GA=SHEAR * AREA / 2,
        polar_inertia=2 * DENSITY * SECOND_MOMENT,
        payload=PAYLOAD,
    )
    return simulate(arm, drive, elements=16, step=1e-3, every=round(OUTPUT / 1e-3))


def ours(robot: Robot, base: ElasticBase, drive: PrescribedMotion, segments: int) -> FloatArray:
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
def test_exudyn_moves_the_tool_alike(
    robot: Robot, base: ElasticBase, drive: PrescribedMotion, theirs: FloatArray
) -> None:
    """Undamped: within 0.05 mm of a vibration of 10 mm; the more segments, the nearer."""
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
