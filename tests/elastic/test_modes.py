"""Vibrations about the static equilibrium: matrices, beams in closed form, orthogonality, modal damping."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from elastic_robots import (
    SHEAR,
    YOUNG,
    FloatArray,
    cantilever,
    make_arm,
    make_random_arm,
    random_base,
    second_moment,
)
from finite_differences import check_derivative, finite_difference

from cmbot.common.errors import InputError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes, linearised, newmark
from cmbot.elastic.sag import Sag
from cmbot.robot import Robot
from cmbot.scene import load_scene

EI = YOUNG * second_moment()


@pytest.fixture
def arm(tmp_path: Path, rng: np.random.Generator) -> ElasticArm:
    return make_random_arm(tmp_path, rng, 5)


@pytest.mark.parametrize("segments", [1, 3])
def test_a_mass_on_a_cantilever(tmp_path: Path, segments: int) -> None:
    """Two bending modes; what has no mass has no mode."""
    L, payload = 0.7, 3.0
    robot = cantilever(tmp_path, length=L, mass=1e-12, payload=payload)
    modes = arm_modes(make_arm(robot, segments=segments), np.zeros(1))
    expected = np.sqrt(3 * EI / (payload * L**3)) / (2 * np.pi)
    np.testing.assert_allclose(modes.frequencies[:2], expected, rtol=1e-4)  # the weight stiffens it a little
    assert (modes.frequencies[2:] > 1e3 * expected).all()


def test_a_uniform_cantilever(tmp_path: Path) -> None:
    L, mass = 0.7, 0.01
    robot = cantilever(tmp_path, length=L, mass=mass)
    unit = np.sqrt(EI / (mass * L**3)) / (2 * np.pi)
    exact = np.array([1.875104, 1.875104, 4.694091, 4.694091, 7.854757, 7.854757]) ** 2 * unit
    one, ten = (
        arm_modes(make_arm(robot, segments=segments), np.zeros(1)).frequencies[:6] for segments in (1, 10)
    )
    np.testing.assert_allclose(one[:2], exact[:2], rtol=0.01)
    np.testing.assert_allclose(ten[:2], exact[:2], rtol=1e-4)
    np.testing.assert_allclose(ten, exact, rtol=0.002)


def test_a_disc_that_turns_on_a_tube(tmp_path: Path) -> None:
    """One mode of torsion, its frequency from GJ/L and the moment of inertia about the axis."""
    L = 0.7
    robot = cantilever(tmp_path, length=L, mass=0.01)
    polar = 0.4
    model = robot.model.copy()
    # The disc alone: the tube has no mass.
    model.inertias[1] = pin.Inertia(1.0, np.array([L, 0, 0]), np.diag([polar, polar / 2, polar / 2]))
    modes = arm_modes(make_arm(replace(robot, model=model)), np.zeros(1))
    twisting = np.abs(modes.shapes[2]) > 0.5 / np.sqrt(polar)
    expected = np.sqrt(2 * SHEAR * second_moment() / L / polar) / (2 * np.pi)
    np.testing.assert_allclose(modes.frequencies[twisting], [expected], rtol=1e-3)


def test_modes_solve_the_equation_of_motion(arm: ElasticArm, rng: np.random.Generator) -> None:
    """Accelerations from the full inverse dynamics, the stiffness from its differences."""
    q = rng.uniform(-2, 2, 5)
    modes = arm_modes(arm, q)
    model, data, elastic = arm.model, arm.model.createData(), arm.elastic
    still = np.zeros(model.nv)

    def force(u: FloatArray, a: FloatArray) -> FloatArray:
        full = arm.configuration(np.zeros(5), a)
        tau = pin.rnea(model, data, arm.configuration(q, u), still, full)[elastic]
        return np.asarray(tau + arm.stiffness @ u + arm.added_mass @ a)

    zero = np.zeros(len(elastic))
    assert np.abs(force(modes.u, zero)).max() < 1e-9 * np.abs(arm.stiffness @ modes.u).max()
    K = finite_difference(lambda u: force(u, zero), modes.u)
    M = np.array([force(modes.u, a) - force(modes.u, zero) for a in np.eye(len(zero))]).T
    omega2 = (2 * np.pi * modes.frequencies) ** 2
    left, right = K @ modes.shapes, M @ modes.shapes * omega2
    for i in range(len(omega2)):
        np.testing.assert_allclose(left[:, i], right[:, i], rtol=0, atol=1e-6 * np.abs(left[:, i]).max())
    np.testing.assert_allclose(modes.mass, M, rtol=0, atol=1e-10 * np.abs(M).max())


@pytest.mark.parametrize("ratio", [0.0, 0.01, 0.3])
def test_modes_are_orthonormal_and_damped_by_the_ratio(
    arm: ElasticArm, rng: np.random.Generator, ratio: float
) -> None:
    modes = arm_modes(arm, rng.uniform(-2, 2, 5))
    assert modes.shapes.shape == (len(arm.elastic), len(modes.frequencies))
    assert (np.diff(modes.frequencies) >= 0).all()
    omega = 2 * np.pi * modes.frequencies
    each, D = np.eye(len(omega)), modes.damping(ratio)
    np.testing.assert_allclose(modes.shapes.T @ modes.mass @ modes.shapes, each, atol=1e-6)
    modal = modes.shapes.T @ modes.stiffness @ modes.shapes / omega / omega[:, None]
    np.testing.assert_allclose(modal, each, atol=1e-6)
    assert np.abs(D - D.T).max() <= 1e-12 * np.abs(D).max()
    modal = modes.shapes.T @ D @ modes.shapes / np.sqrt(omega) / np.sqrt(omega)[:, None]
    np.testing.assert_allclose(modal, 2 * ratio * each, atol=1e-6)


def test_damped_vibrations_decay_at_the_ratio(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    modes = arm_modes(make_arm(cmbot_robot, random_base(rng)), rng.uniform(-2, 2, 7))
    f = len(modes.u)
    inverse = np.linalg.inv(modes.mass)
    state = np.block(
        [[np.zeros((f, f)), np.eye(f)], [-inverse @ modes.stiffness, -inverse @ modes.damping(0.05)]]
    )
    eigenvalues = np.linalg.eigvals(state)
    # One of each conjugate pair, slowest first.
    eigenvalues = eigenvalues[eigenvalues.imag > 0]
    slow = eigenvalues[np.argsort(np.abs(eigenvalues))][:8]
    np.testing.assert_allclose(np.abs(slow), 2 * np.pi * modes.frequencies[:8], rtol=1e-6)
    np.testing.assert_allclose(-slow.real / np.abs(slow), 0.05, rtol=1e-5)
    for ratio in (-0.01, float("nan"), float("inf")):
        with pytest.raises(InputError, match=r"ArmModes.damping: ratio"):
            modes.damping(ratio)


def test_mass_of_the_guardrail_slows_everything(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    base, q = random_base(rng), rng.uniform(-2, 2, 7)
    bare = arm_modes(make_arm(cmbot_robot, replace(base, mass=np.zeros((6, 6)))), q).frequencies
    heavy = arm_modes(make_arm(cmbot_robot, replace(base, mass=50 * base.mass)), q).frequencies
    assert (heavy <= bare * (1 + 1e-9)).all()
    assert heavy[0] < 0.9 * bare[0]


def test_a_rigid_arm_has_no_modes(cmbot_robot: Robot) -> None:
    modes = arm_modes(make_arm(replace(cmbot_robot.with_rigid_joints, elasticity={})), np.zeros(7))
    assert modes.frequencies.shape == (0,)
    assert modes.damping(0.01).shape == (0, 0)


def test_mass_and_coupling_match_inverse_dynamics(arm: ElasticArm, rng: np.random.Generator) -> None:
    q = rng.uniform(-2, 2, (3, len(arm.driven)))
    at = linearised(arm, q)
    data = arm.model.createData()
    for k in range(3):
        configuration, still = arm.configuration(q[k], at.u[k]), np.zeros(arm.model.nv)

        def force(a: FloatArray, x: FloatArray = configuration, still: FloatArray = still) -> FloatArray:
            return np.asarray(pin.rnea(arm.model, data, x, still, a)[arm.elastic])

        rest = force(still)
        for axes, matrix in (
            (arm.elastic, at.mass[k] - arm.added_mass),
            (arm.driven, at.coupling[k]),
        ):
            columns = np.stack([force(np.eye(arm.model.nv)[axis]) - rest for axis in axes], axis=1)
            np.testing.assert_allclose(matrix, columns, atol=1e-9 * np.abs(columns).max())


def test_derivative_of_the_equilibrium(arm: ElasticArm, rng: np.random.Generator) -> None:
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


def test_segments_converge_on_the_shipped_robot(cmbot_robot: Robot) -> None:
    scene = load_scene("triangle")
    base = elastic_base(scene.elastic_guardrail)
    one, four, eight = (
        arm_modes(make_arm(cmbot_robot, base, segments=segments), scene.posture) for segments in (1, 4, 8)
    )
    np.testing.assert_allclose(one.frequencies[:6], eight.frequencies[:6], rtol=0.005)
    np.testing.assert_allclose(four.frequencies[:6], eight.frequencies[:6], rtol=0.0005)


def test_newmark_follows_an_oscillator_whose_stiffness_changes() -> None:
    """A load that is put on at once, and off where the stiffness falls to a quarter: two cases of either."""
    step, count, omega = 2e-4, 10_000, np.array([6.0, 9.0])
    t = step * np.arange(count + 1)
    K = np.stack([omega**2, omega**2 / 4])[:, :, None, None]
    M, interval = np.ones((2, 1, 1, 1)), (np.arange(count + 1) > 5000).astype(np.intp)[:, None]
    loads = np.where(interval, 0.0, np.arange(2) + 1.0)[..., None]
    w, v = newmark(M, 0 * K, K, loads, np.repeat(interval, 2, axis=1), step)
    for stiff, load in product(range(2), range(2)):
        first, swung = omega[stiff], t[:5001]
        still, own = (1.0 + load) / first**2, w[:, load, stiff, 0]
        np.testing.assert_allclose(own[:5001], still * (1 - np.cos(first * swung)), atol=2e-3 * still)
        # From there on it swings by half the frequency, the load off.
        place, speed = still * (1 - np.cos(first)), still * first * np.sin(first)
        half, left = first / 2, t[5001:] - 1.0
        free = place * np.cos(half * left) + speed / half * np.sin(half * left)
        np.testing.assert_allclose(own[5001:], free, atol=5e-3 * still)
        ends = speed * np.cos(half * left[-1]) - place * half * np.sin(half * left[-1])
        np.testing.assert_allclose(v[load, stiff, 0], ends, atol=2e-2 * still * first)
    # Where it begins elsewhere it swings about where the load is borne.
    displaced, _ = newmark(M, 0 * K, K, loads, np.repeat(interval, 2, axis=1), step, np.array([[1.0], [2.0]]))
    free = np.array([1.0, 2.0]) * np.cos(omega * t[:5001, None])
    for load in range(2):
        np.testing.assert_allclose((displaced - w)[:5001, load, :, 0], free, atol=5e-3)
