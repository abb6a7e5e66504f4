"""The integrator against closed forms, another integrator, energy, and its own order."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp
from small_systems import (
    FloatArray,
    equilibrium,
    integrate,
    joined,
    mass_on_spring,
    pendulum_on_a_cart,
    resting,
    soft_arm,
    swinging,
)

from cmbot.common.errors import CmbotError, SimulationDiverged
from cmbot.elastic.generalized_alpha import ElasticMotion, ElasticSystem, GeneralizedAlpha
from cmbot.trajectory import QuinticTrajectory

MASS, STIFFNESS, GRAVITY = 2.0, 800.0, 9.81
SAG = MASS * GRAVITY / STIFFNESS
OMEGA = np.sqrt(STIFFNESS / MASS)


def test_a_mass_on_a_spring_follows_its_closed_form() -> None:
    errors = []
    for step in (0.004, 0.002, 0.001):
        motion = integrate(mass_on_spring(MASS, STIFFNESS), resting(0, 3.0), step=step)
        exact = -SAG * (1 - np.cos(OMEGA * motion.t))
        errors.append(np.abs(motion.u[:, 0] - exact).max())
        assert motion.joints.shape == (len(motion.t), 0)
    assert errors[-1] < 4e-3 * SAG
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.05)


def test_a_damped_mass_follows_its_closed_form() -> None:
    ratio = 0.05
    system = mass_on_spring(MASS, STIFFNESS, 2 * ratio * OMEGA * MASS)
    motion = integrate(system, resting(0, 4.0), step=0.0005)
    damped, decay = OMEGA * np.sqrt(1 - ratio**2), np.exp(-ratio * OMEGA * motion.t)
    swing = np.cos(damped * motion.t) + ratio * OMEGA / damped * np.sin(damped * motion.t)
    np.testing.assert_allclose(motion.u[:, 0], -SAG * (1 - decay * swing), atol=2e-4 * SAG)
    rate = -SAG * OMEGA**2 / damped * decay * np.sin(damped * motion.t)
    np.testing.assert_allclose(motion.v[:, 0], rate, atol=2e-4 * SAG * OMEGA)


def test_it_starts_as_it_is_told_and_keeps_to_the_drive() -> None:
    system, drive = soft_arm(), swinging(2)
    u = [0.001, -0.002, 0.003]
    motion = integrate(system, drive, step=0.0021, u=u)
    assert motion.t[0] == 0.0
    assert motion.t[-1] == drive.duration
    assert np.diff(motion.t).max() <= 0.0021
    np.testing.assert_array_equal(motion.u[0], u)
    np.testing.assert_array_equal(motion.v[0], 0.0)
    np.testing.assert_allclose(motion.joints, drive.states(motion.t)[0], rtol=0, atol=1e-15)


def test_the_equation_of_motion_holds_at_every_step() -> None:
    system, drive = soft_arm(), swinging(2)
    motion = integrate(system, drive, step=0.002, corrections=3)
    q, v, a = states(system, drive, motion)
    data = system.model.createData()
    inertia = np.array([pin.rnea(system.model, data, *x)[system.elastic] for x in zip(q, v, a, strict=True)])
    spring = motion.u @ system.stiffness
    np.testing.assert_allclose(inertia, -spring, atol=1e-7 * np.abs(spring).max())


def states(
    system: ElasticSystem, drive: QuinticTrajectory, motion: ElasticMotion
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All coordinates, rates and accelerations, (N, n)."""
    joints = drive.states(motion.t)
    pairs = zip(joints, (motion.u, motion.v, motion.a), strict=True)
    q, v, a = (joined(system, driven, elastic) for driven, elastic in pairs)
    return q, v, a


@pytest.mark.parametrize("damping", [0.0, 12.0])
def test_a_driven_pendulum_on_a_spring_against_scipy(damping: float) -> None:
    """Lagrange's equation of the cart, written down by hand."""
    system, drive = pendulum_on_a_cart(damping=damping), swinging(1, 3.0)
    M, m, r, k = 2.0, 1.5, 0.8, 900.0

    def rates(t: float, y: FloatArray) -> list[float]:
        angle, rate, acceleration = (x[0, 0] for x in drive.states([t]))
        # The bob is at x - r sin(angle).
        bob = m * r * (acceleration * np.cos(angle) - rate**2 * np.sin(angle))
        return [y[1], (bob - k * y[0] - damping * y[1]) / (M + m)]

    motion = integrate(system, drive, step=0.0005)
    exact = solve_ivp(rates, (0, 3.0), [0, 0], method="DOP853", rtol=1e-10, atol=1e-12, t_eval=motion.t)
    size = np.abs(exact.y).max(axis=1)
    np.testing.assert_allclose(motion.u[:, 0], exact.y[0], atol=3e-4 * size[0])
    np.testing.assert_allclose(motion.v[:, 0], exact.y[1], atol=3e-4 * size[1])


@pytest.mark.parametrize("rho_inf", [0.0, 0.8, 1.0])
def test_it_is_of_second_order(rho_inf: float) -> None:
    system, drive = soft_arm(softer=10), swinging(2)
    start = equilibrium(system, np.zeros(2))
    steps = (5e-4, 2.5e-4, 1.25e-4)
    runs = [integrate(system, drive, step=step, u=start, rho_inf=rho_inf).u for step in steps]
    coarse, middle, fine = (u[:: 2**k] for k, u in enumerate(runs))
    ratio = np.abs(middle - coarse).max() / np.abs(fine - middle).max()
    assert np.log2(ratio) == pytest.approx(2.0, abs=0.12)


def test_two_corrections_leave_nothing_to_a_third() -> None:
    system, drive = soft_arm(), swinging(2)
    two, three = (integrate(system, drive, step=0.002, corrections=n).u for n in (2, 3))
    coarse = integrate(system, drive, step=0.004, corrections=3).u
    assert np.abs(two - three).max() < 1e-3 * np.abs(coarse - three[::2]).max()


def test_corrections_that_gain_nothing_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Within the tolerance, where it is slow; where it is quick, none is."""
    count, rnea = [0], pin.rnea

    def counted(*arguments: Any) -> Any:
        count[0] += 1
        return rnea(*arguments)

    monkeypatch.setattr(pin, "rnea", counted)
    system, found = soft_arm(), {}
    for seconds, most in ((40.0, 1.3), (2.0, 2.1)):
        drive, start = swinging(2, seconds), equilibrium(system, np.zeros(2))
        for tolerance in (0.0, 1e-8):
            count[0] = 0
            options = {"step": 0.004, "rho_inf": 0.8, "corrections": 2, "tolerance": tolerance}
            found[tolerance] = GeneralizedAlpha(system, **options).run([drive], start, 0 * start).u
        assert count[0] < most * len(found[0.0])
        assert np.abs(found[0.0] - found[1e-8]).max() < 1e-4


def test_steps_are_longer_where_nothing_vibrates() -> None:
    """A slow motion, then a quick one, whose steps are those that were asked for."""
    system, t = soft_arm(), np.linspace(0.0, 60.0, 500)
    slow = QuinticTrajectory.through(t, np.column_stack([2e-4 * np.sin(np.pi * t / t[-1]) ** 2] * 2))
    start, runs = equilibrium(system, np.zeros(2)), []
    for longest in (1, 8):
        options = {"step": 0.004, "rho_inf": 0.8, "corrections": 2, "tolerance": 1e-8, "longest": longest}
        runs.append(GeneralizedAlpha(system, **options).run([slow, swinging(2)], start, 0 * start))
    even, longer = runs
    quick = longer.t >= t[-1]
    assert (~quick).sum() < 0.3 * (even.t < t[-1]).sum()
    at = np.searchsorted(even.t, longer.t - 1e-9)
    np.testing.assert_allclose(longer.t, even.t[at], rtol=0, atol=1e-9)
    np.testing.assert_allclose(longer.u, even.u[at], rtol=0, atol=1e-8)
    np.testing.assert_allclose(np.diff(longer.t[quick]), 0.004, rtol=1e-9)


def energy(system: ElasticSystem, q: FloatArray, v: FloatArray) -> FloatArray:
    """Kinetic, gravity's and elastic energy, J."""
    data, u = system.model.createData(), q[:, system.elastic]
    elastic = 0.5 * np.einsum("ki,ij,kj->k", u, system.stiffness, u)
    return elastic + [
        pin.computeKineticEnergy(system.model, data, *x)
        + pin.computePotentialEnergy(system.model, data, x[0])
        for x in zip(q, v, strict=True)
    ]


def power(system: ElasticSystem, q: FloatArray, v: FloatArray, a: FloatArray) -> FloatArray:
    """What the drives give less what damping takes, W."""
    data, driven, rates = system.model.createData(), system.driven, v[:, system.elastic]
    given = [pin.rnea(system.model, data, *x)[driven] @ x[1][driven] for x in zip(q, v, a, strict=True)]
    return given - np.einsum("ki,ij,kj->k", rates, system.damping, rates)


@pytest.mark.parametrize(("rho_inf", "damping"), [(1.0, 0.0), (0.8, 0.0), (0.8, 5.0)])
def test_energy_is_accounted_for(rho_inf: float, damping: float) -> None:
    system = soft_arm()
    system = replace(system, damping=damping * np.diag([20.0, 1.0, 1.0]))
    drive = swinging(2)
    drifts = []
    for step in (0.001, 0.0005):
        # From the straight arm: it falls into its springs and shakes.
        motion = integrate(system, drive, step=step, rho_inf=rho_inf)
        q, v, a = states(system, drive, motion)
        held_energy, flow = energy(system, q, v), power(system, q, v, a)
        work = np.concatenate([[0.0], np.cumsum(0.5 * (flow[1:] + flow[:-1]) * np.diff(motion.t))])
        drifts.append(np.abs(held_energy - held_energy[0] - work).max())
        swing = np.ptp(held_energy)
    assert swing > 5.0
    assert drifts[1] < 2e-3 * swing
    assert drifts[1] < 0.3 * drifts[0]


def test_energy_of_a_free_motion_does_not_drift_over_many_periods() -> None:
    """A resting drive, no damping: some 300 periods of the slowest mode."""
    system = soft_arm()
    start = 1.5 * equilibrium(system, np.zeros(2))
    motion = integrate(system, resting(2, 20.0), step=0.001, u=start)
    q, v, _ = states(system, resting(2, 20.0), motion)
    held_energy = energy(system, q[::100], v[::100])
    strain = 0.5 * start @ system.stiffness @ start
    assert abs(held_energy[-1] - held_energy[0]) < 0.01 * strain


def test_an_arm_at_rest_in_equilibrium_stays_there() -> None:
    system = soft_arm()
    start = equilibrium(system, np.zeros(2))
    motion = integrate(system, resting(2, 1.0), step=0.002, u=start)
    assert np.abs(start).max() > 1e-4
    assert np.abs(motion.u - start).max() < 1e-11


def test_what_hardly_bends_moves_like_a_rigid_arm() -> None:
    system, drive = soft_arm(), swinging(2)
    bends = []
    for factor in (1e4, 1e6):
        stiff = replace(system, stiffness=factor * system.stiffness)
        start = equilibrium(stiff, np.zeros(2))
        bends.append(np.abs(integrate(stiff, drive, step=0.002, u=start).u).max())
    assert bends[1] < 1e-7
    assert bends[0] / bends[1] == pytest.approx(100.0, rel=0.2)


@pytest.mark.parametrize("rho_inf", [0.0, 0.8, 1.0])
def test_the_spectral_radius_is_what_is_left_of_the_infinitely_fast(rho_inf: float) -> None:
    system = replace(mass_on_spring(1.0, 1e12), model=mass_on_spring(1.0, 1.0).model)
    motion = integrate(system, resting(0, 0.8), step=0.01, u=[1e-3], rho_inf=rho_inf)
    # The roots coincide at infinity, so the asymptote is reached slowly.
    late = np.abs(motion.u[60:, 0])
    if rho_inf == 0.0:
        assert late.max() < 1e-9
    elif rho_inf == 1.0:
        assert late.min() > 0.5e-3
    else:
        assert (late[-1] / late[0]) ** (1 / (len(late) - 1)) == pytest.approx(rho_inf, abs=0.05)


def test_where_the_acceleration_jumps_the_step_ends() -> None:
    """A cart pulled by a pendulum that sets off, and stops, with full acceleration."""
    system = pendulum_on_a_cart()
    t, one = np.array([0.0, 0.7]), np.ones((2, 1))
    off = QuinticTrajectory(t=t, q=np.array([[0.0], [0.245]]), v=t[:, None], a=one)
    on = QuinticTrajectory(t=t, q=np.array([[0.245], [0.49]]), v=t[::-1, None], a=-one)
    ends = []
    for step in (0.004, 0.002, 0.001):
        integrator = GeneralizedAlpha(system, step=step, rho_inf=0.8, corrections=2)
        still = QuinticTrajectory.held(np.array([0.49]), 0.5)
        motion = integrator.run([off, on, still], np.zeros(1), np.zeros(1))
        assert motion.t[-1] == pytest.approx(1.9)
        assert np.diff(motion.t).min() > 0
        ends.append(motion.u[-1, 0])
    assert np.log2((ends[0] - ends[1]) / (ends[1] - ends[2])) == pytest.approx(2.0, abs=0.2)


def test_divergence_says_when_and_where() -> None:
    """Pushed away by a spring of negative stiffness: -SAG (cosh(omega t) - 1) reaches 1 m."""
    system = mass_on_spring(MASS, -STIFFNESS)
    with pytest.raises(SimulationDiverged, match=r"diverges at t = 0\.2\d+ s") as caught:
        integrate(system, resting(0, 5.0), step=0.0005)
    assert caught.value.time == pytest.approx(np.arccosh(1 / SAG + 1) / OMEGA, abs=0.002)
    (u,) = caught.value.state
    assert 1.0 <= abs(u) < 1.05
    assert isinstance(caught.value, CmbotError)
    assert isinstance(caught.value, RuntimeError)


@pytest.mark.parametrize(
    "change",
    [
        {"stiffness": np.array([[np.nan]])},
        {"stiffness": np.array([[1e308]])},
        {"added_mass": np.array([[-3.0]])},
        {"added_mass": np.array([[np.inf]])},
    ],
)
def test_no_number_that_is_none_comes_out(change: dict[str, FloatArray]) -> None:
    system = replace(mass_on_spring(MASS, STIFFNESS), **change)
    with pytest.raises(SimulationDiverged):
        integrate(system, resting(0, 1.0), step=0.002, u=[0.1])
