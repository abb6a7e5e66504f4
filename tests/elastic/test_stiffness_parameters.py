"""Parameters of an arm's stiffness: what they mean, their derivatives, the covariance of the sag."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from elastic_robots import FloatArray, make_arm, make_random_arm, random_base
from finite_differences import check_derivative
from scipy.linalg import expm

from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.elastic.stiffness_parameters import (
    StiffnessParameters,
    entries_of,
    exponential_slopes,
    symmetric,
)
from cmbot.robot import Robot


@pytest.fixture(params=["random", "shipped"])
def arm(
    request: pytest.FixtureRequest, tmp_path: Path, cmbot_robot: Robot, rng: np.random.Generator
) -> ElasticArm:
    if request.param == "random":
        return make_random_arm(tmp_path, rng, 3)
    return make_arm(cmbot_robot, random_base(rng))


def with_parameters(arm: ElasticArm, x: FloatArray) -> ElasticArm:
    return replace(arm, stiffness=StiffnessParameters(arm).stiffness(x))


def test_compliances_grow_with_the_exponential(arm: ElasticArm, rng: np.random.Generator) -> None:
    parameters = StiffnessParameters(arm)
    np.testing.assert_allclose(parameters.stiffness(np.zeros(parameters.count)), arm.stiffness, rtol=1e-9)
    x = rng.normal(0, 0.3, parameters.count)
    K = parameters.stiffness(x)
    np.testing.assert_array_equal(K, K.T)
    for spring, each in zip(parameters.springs, x, strict=False):
        at = np.ix_(arm.springs[spring], arm.springs[spring])
        np.testing.assert_allclose(K[at], np.exp(-each) * arm.stiffness[at], rtol=1e-12)
    L = np.linalg.cholesky(np.linalg.inv(arm.stiffness[:6, :6]))
    compliance = L @ expm(symmetric(x[len(parameters.springs) :])) @ L.T
    np.testing.assert_allclose(np.linalg.inv(K[:6, :6]), compliance, rtol=1e-6)


def test_the_shipped_arm_has_tubes_joints_and_a_base(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    parameters = StiffnessParameters(make_arm(cmbot_robot, random_base(rng)))
    assert parameters.has_base
    assert [kind for kind, _ in parameters.springs] == ["link"] * 4 + ["joint"] * 7
    assert parameters.count == 11 + 21
    rigid = StiffnessParameters(make_arm(cmbot_robot.with_rigid_joints))
    assert not rigid.has_base
    assert rigid.count == 4


def test_derivatives_of_the_sag(arm: ElasticArm, rng: np.random.Generator) -> None:
    parameters, q = StiffnessParameters(arm), rng.uniform(-1, 1, (2, arm.robot.dof))
    x = rng.normal(0, 0.2, parameters.count)
    tool, u, lever = Sag(with_parameters(arm, x)).loaded(q)
    np.testing.assert_allclose(tool, Sag(with_parameters(arm, x)).at(q).tool, atol=1e-12)
    slope = (lever @ parameters.relaxation(u, x)).reshape(6, -1)
    check_derivative(
        lambda y: Sag(with_parameters(arm, y)).at(q).tool.ravel(), x, slope, step=1e-5, rtol=1e-5
    )


def test_the_spread_is_that_of_draws(arm: ElasticArm, rng: np.random.Generator) -> None:
    count, q = StiffnessParameters(arm).count, rng.uniform(-1, 1, (1, arm.robot.dof))
    root = 0.02 * rng.normal(size=(count, count)) / np.sqrt(count)
    spread = Sag(arm, root @ root.T).spread(q)[0]
    tool = [Sag(with_parameters(arm, root @ rng.normal(size=count))).at(q).tool[0] for _ in range(80)]
    np.testing.assert_allclose(np.trace(np.cov(np.array(tool).T)), np.trace(spread), rtol=0.5)
    np.testing.assert_array_equal(Sag(arm).spread(q), np.zeros((1, 3, 3)))


def test_slopes_of_the_exponential_where_eigenvalues_meet(rng: np.random.Generator) -> None:
    direction = symmetric(rng.normal(size=21))
    for Y in (np.zeros((6, 6)), np.diag([1.0, 1, 1, 2, 2, 3]), symmetric(rng.normal(size=21))):
        found = exponential_slopes(Y, direction[None])[0]
        step = 1e-6
        expected = (expm(Y + step * direction) - expm(Y - step * direction)) / (2 * step)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    entries = rng.normal(size=21)
    np.testing.assert_array_equal(entries_of(symmetric(entries)), entries)
