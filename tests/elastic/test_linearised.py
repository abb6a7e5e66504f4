"""The arm close to rest: its matrices against pinocchio's own and against finite differences."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from elastic_robots import FloatArray, random_base, random_robot
from finite_differences import check_derivative

from cmbot.elastic.arm import ElasticArm, ElasticOptions, elastic_arm
from cmbot.elastic.modes import linearised
from cmbot.elastic.sag import Sag


@pytest.fixture
def arm(tmp_path: Path, rng: np.random.Generator) -> ElasticArm:
    robot = random_robot(tmp_path, rng, 5, payload=1.0)
    return elastic_arm(robot, random_base(rng), ElasticOptions(segments=2, link_factor=0.05))


def test_mass_and_coupling_are_what_accelerations_ask_for(arm: ElasticArm, rng: np.random.Generator) -> None:
    q = rng.uniform(-2, 2, (3, len(arm.driven)))
    at = linearised(arm, q)
    data = arm.model.createData()
    for k in range(3):
        configuration, still = arm.configuration(q[k], at.u[k]), np.zeros(arm.model.nv)

        def force(a: FloatArray, configuration: FloatArray = configuration) -> FloatArray:
            still = np.zeros(arm.model.nv)
            return np.asarray(pin.rnea(arm.model, data, configuration, still, a)[arm.elastic])

        rest = force(still)
        for axes, matrix in ((arm.elastic, at.mass[k] - arm.added_mass), (arm.driven, at.coupling[k])):
            columns = np.stack([force(np.eye(arm.model.nv)[axis]) - rest for axis in axes], axis=1)
            np.testing.assert_allclose(matrix, columns, atol=1e-9 * np.abs(columns).max())


def test_the_equilibrium_moves_with_the_joints_as_its_matrices_say(
    arm: ElasticArm, rng: np.random.Generator
) -> None:
    q = rng.uniform(-2, 2, len(arm.driven))
    at = linearised(arm, q[None])
    slope = -np.linalg.solve(at.stiffness[0], at.weight[0])
    sag = Sag(arm)
    check_derivative(lambda x: sag.at(x[None]).u[0], q, slope, rtol=1e-7)
    np.testing.assert_array_equal(at.u[0], sag.at(q[None]).u[0])
    for matrix in (at.mass[0], at.stiffness[0]):
        np.testing.assert_array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(at.stiffness[0]).min() > 0
    # What is between two segments has no mass of its own.
    energies = np.linalg.eigvalsh(at.mass[0])
    assert energies.min() > -1e-12 * energies.max()
