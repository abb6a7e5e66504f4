"""The modal response: against gravity, closed forms, Lyapunov's equation, integrators, simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov
from small_motions import arm_on_its_guardrail

from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.excitation.along_work import PostureSystem, tool_along
from cmbot.excitation.response import (
    BAND_HZ,
    ModalResponse,
    TunedDamper,
    flat_band,
    ground_loads,
    linear_spectrum,
    modal_response,
)
from cmbot.planning import Plan
from cmbot.robot import Robot
from cmbot.scene import load_scene
from cmbot.simulation import PrescribedWork, SimulationOptions, elastic_arm_of, track_work
from cmbot.trajectory import QuinticTrajectory

ZETA = 0.02


@pytest.fixture(scope="module")
def arm(cmbot_robot: Robot) -> ElasticArm:
    return arm_on_its_guardrail(cmbot_robot)


@pytest.fixture(scope="module")
def posture() -> np.ndarray:
    return np.array(load_scene("triangle").posture)


@pytest.fixture(scope="module")
def response(arm: ElasticArm, posture: np.ndarray) -> ModalResponse:
    return modal_response(arm, posture, ZETA)


def oscillator(f: float = 3.0, zeta: float = 0.01, gain: float = 1.0) -> ModalResponse:
    """One mode that moves the tool along x by 1 m, shaken along x."""
    x = np.eye(3)[:, :1]
    return ModalResponse(
        frequencies=np.array([f]),
        damping=np.array([zeta]),
        gain=gain * x.T,
        tool=x,
        wrench=np.zeros((6, 1)),
        direct=np.zeros((6, 3)),
        place=x,
        place_direct=np.zeros((6, 3)),
        axis=np.eye(3)[2],
        shapes=np.eye(1),
        momenta=np.eye(1),
    )


def test_a_slow_acceleration_is_a_turned_gravity(
    arm: ElasticArm, posture: np.ndarray, response: ModalResponse
) -> None:
    """The tool moves as the sag does under another gravity, and the wrench is the whole mass's."""
    model = arm.robot.model.copy()
    turned, small = np.array([0.03, -0.02, 0.04]), 1e-3
    arms = []
    for sign in (1, -1):
        model.gravity.linear = arm.robot.model.gravity.linear - sign * small * turned
        robot = replace(arm.robot, model=model.copy())
        arms.append(arm_on_its_guardrail(robot))
    here, there = (Sag(each).at(posture[None]).tool[0] for each in arms)
    # Not the guardrail's own mass at the foot, which no gravity bends.
    bare = replace(arm, base=replace(arm.base, mass=np.zeros((6, 6))))
    still = modal_response(bare, posture, ZETA).static(turned)
    assert still[:3] == pytest.approx((here - there) / (2 * small), rel=1e-4, abs=1e-9)
    assert response.static(turned)[3:6] == pytest.approx(-arm.robot.mass * turned, rel=1e-9)


def test_the_wrench_is_what_the_springs_of_the_base_and_its_mass_take(
    arm: ElasticArm, posture: np.ndarray
) -> None:
    """Equilibrium of the guardrail's own mass at the foot, at a frequency between the modes."""
    f = np.array([6.0])
    light = modal_response(arm, posture, 1e-7)
    modes, at = arm_modes(arm, posture), arm.springs["base", ""]
    w2 = (2 * np.pi * f[0]) ** 2
    eta = light.gain / ((2 * np.pi * modes.frequencies) ** 2 - w2)[:, None]
    u = modes.shapes[at] @ eta
    taken = arm.base.stiffness @ u + arm.base.mass @ (np.eye(6, 3) - w2 * u)
    # What the geometric stiffness of the weights adds at the base is of the order of 1e-3.
    assert np.abs(light.transfer(f)[0, 3:].real - taken).max() < 5e-3 * np.abs(taken).max()


def test_white_noise_in_closed_form() -> None:
    """Miles: the variance of an oscillator under white noise is S / (64 pi^3 zeta f^3)."""
    f, zeta, S = 3.0, 0.01, 0.5
    moments = oscillator(f, zeta).moments(lambda at: np.full((len(at), 3), S), (1e-3, 400.0))
    assert moments.value[0, 0] == pytest.approx(S / (64 * np.pi**3 * zeta * f**3), rel=2e-3)
    assert moments.rate[0, 0] == pytest.approx(S / (16 * np.pi * zeta * f), rel=1e-2)


def test_white_noise_by_lyapunovs_equation(
    arm: ElasticArm, posture: np.ndarray, response: ModalResponse
) -> None:
    """Of all elastic coordinates, from their matrices: no mode and no frequency is in it."""
    modes = arm_modes(arm, posture)
    M, K, D, B = (
        modes.mass,
        modes.stiffness,
        modes.damping(ZETA) + arm.damping,
        ground_loads(arm, arm.configuration(posture, modes.u)),
    )
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    G = np.vstack([np.zeros((n, 3)), -np.linalg.solve(M, B)])
    S = np.array([0.3, 0.2, 0.5])
    covariance = solve_continuous_lyapunov(A, -G @ np.diag(S / 2) @ G.T)[:n, :n]
    # The tool by the elastic coordinates, from two equilibria: the modes' shapes are complete.
    J = response.tool @ np.linalg.pinv(modes.shapes)
    ours = response.moments(lambda f: np.tile(S, (len(f), 1)), (1e-3, 3000.0)).value[:3, :3]
    expected = J @ covariance @ J.T
    assert np.abs(ours - expected).max() < 5e-3 * np.trace(expected)


def test_a_history_is_that_of_the_equation_of_motion() -> None:
    f, zeta, step = 3.0, 0.05, 0.01
    t = step * np.arange(400)
    force = np.sin(7 * t) + 0.3 * np.random.default_rng(0).normal(size=len(t))
    force[0] = 0.0

    def rates(time: float, y: np.ndarray) -> list[float]:
        w = 2 * np.pi * f
        return [y[1], np.interp(time, t, force) - 2 * zeta * w * y[1] - w**2 * y[0]]

    exact = solve_ivp(rates, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-13, max_step=step / 2).y[0]
    ours = oscillator(f, zeta).history(force[:, None] * np.eye(1, 3), step)[:, 0]
    assert np.abs(ours - exact).max() < 1e-5 * np.abs(exact).max()


def test_a_damper_is_a_second_mass() -> None:
    """Against the equations of two masses."""
    mass, step = 0.1, 0.004
    damper = TunedDamper(mass=mass, frequency=2.8, damping=0.15)
    t = step * np.arange(4000)
    a = np.where(t < 8, np.sin(2 * np.pi * 3.1 * t) * np.sin(np.pi * t / 8), 0.0)

    def rates(time: float, y: np.ndarray) -> list[float]:
        w, wd = 2 * np.pi * 3.0, 2 * np.pi * damper.frequency
        g = np.interp(time, t, a)
        x, z, v, u = y  # of the oscillator, and of the damper relative to it
        spring = mass * (wd**2 * z + 2 * damper.damping * wd * u)
        acceleration = -g - w**2 * x - 0.02 * w * v + spring
        return [v, u, acceleration, -spring / mass - g - acceleration]

    exact = solve_ivp(rates, (0, t[-1]), np.zeros(4), t_eval=t, rtol=1e-8, atol=1e-12, max_step=step).y[0]
    with_damper = replace(oscillator(3.0, 0.01, gain=-1.0), damper=damper)
    ours = with_damper.history(a[:, None] * np.eye(1, 3), step)[:, 0]
    assert np.abs(ours - exact).max() < 2e-3 * np.abs(exact).max()
    systems = [PostureSystem.of(with_damper, 100.0)] * 3
    inputs = (a[:, None] * np.eye(1, 3))[:, :, None]
    along = tool_along(systems, np.linspace(0.0, 1.0, len(t)), inputs, step)[:, 0, 0]
    assert np.abs(along - exact).max() < 1e-4 * np.abs(exact).max()


def test_moments_are_those_of_simulated_records(response: ModalResponse) -> None:
    """RMS within 2 % of records that are integrated in time."""
    rows = np.array([[0.5, 0.02, 0.01, 0.03], [5.0, 0.05, 0.03, 0.04], [30.0, 0.0, 0.01, 0.0]])
    spectrum, step, count = linear_spectrum(rows), 1 / 1000, 2**18
    f = np.arange(count // 2 + 1) / (count * step)
    rng = np.random.default_rng(5)
    phases = np.exp(2j * np.pi * rng.uniform(size=(len(f), 3)))
    a = np.fft.irfft(np.sqrt(spectrum(f) / (2 * count * step)) * count * phases, count, axis=0)
    # Periodic records, one axis after the other: the second period is steady.
    each = (np.vstack([a * axis, a * axis]) for axis in np.eye(3))
    squares = [response.history(inputs, step)[count:].var(axis=0) for inputs in each]
    expected = np.sqrt(np.diag(response.moments(spectrum, (0.5, 30.0)).value))
    assert np.sqrt(np.sum(squares, axis=0)) == pytest.approx(expected, rel=5e-3)


def test_the_whole_simulation_sways_as_the_modes_do(triangle_plan: Plan) -> None:
    """A posture held on a shaken base, simulated with all that is not linear: within 2 % of the modes."""
    step = 0.002
    options = SimulationOptions(settle_s=0.5, step_s=step, output_step_s=step, damping=ZETA)
    arm = elastic_arm_of(triangle_plan, options)
    q = triangle_plan.trajectory.evaluate(np.array([8.0]))[0]
    work = PrescribedWork.of([(QuinticTrajectory.held(q, 6.0), triangle_plan.strokes[0].task.path)])
    t = step * np.arange(3250)
    a = 0.4 * np.sin(2 * np.pi * np.array([3.6, 4.4, 2.0]) * t[:, None]) * np.minimum(t, 1.0)[:, None]

    def ground(at: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(at, t, axis) for axis in a.T], axis=1)

    simulated = track_work(arm, work, options, ground=ground).dynamic
    ours = modal_response(arm, q, ZETA).history(a, step)[: len(simulated), :3]
    rms = np.sqrt(np.mean(np.sum(simulated**2, axis=1)))
    assert rms > 1e-3
    assert np.sqrt(np.mean(np.sum((simulated[: len(ours)] - ours) ** 2, axis=1))) < 0.02 * rms


def test_the_modes_change_along_the_work(triangle_plan: Plan) -> None:
    """The moving arm on a shaken base: RMS and peak within 2 % of the whole simulation, all along alike."""
    step = 0.002
    options = SimulationOptions(settle_s=0.0, step_s=step, output_step_s=step, damping=ZETA)
    arm, work = elastic_arm_of(triangle_plan, options), PrescribedWork.planned(triangle_plan)
    coarse = np.arange(0.0, work.duration + 0.02, 0.02)
    f, rng = np.fft.rfftfreq(len(coarse), 0.02), np.random.default_rng(4)
    X = np.fft.rfft(rng.normal(size=(len(coarse), 3)), axis=0)
    a = 0.3 * np.fft.irfft(np.where((f > 0.5) & (f < 15), 1.0, 0.0)[:, None] * X, len(coarse), axis=0)
    a[0] = 0.0

    def ground(at: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(at, coarse, axis) for axis in a.T], axis=1)

    simulated = track_work(arm, work, options, sag=triangle_plan.sag, ground=ground)
    done = np.linspace(0.0, 1.0, 49)
    each = [modal_response(arm, q, ZETA) for q in work.postures(done * work.duration)]
    systems = [PostureSystem.of(response, 200.0) for response in each]
    ours = tool_along(systems, simulated.t / work.duration, ground(simulated.t)[:, :, None], step)[:, 0]
    sizes = [np.linalg.norm(tool, axis=1) for tool in (ours, simulated.dynamic)]
    assert sizes[0].max() == pytest.approx(sizes[1].max(), rel=0.02)
    assert np.sqrt(np.mean(sizes[0] ** 2)) == pytest.approx(np.sqrt(np.mean(sizes[1] ** 2)), rel=0.02)
    off = np.linalg.norm(ours - simulated.dynamic, axis=1)
    assert np.sqrt(np.mean(off**2)) < 0.08 * np.sqrt(np.mean(sizes[1] ** 2))


def test_the_band_from_two_hertz_hides_a_slow_mode() -> None:
    slow = oscillator(1.4)
    wide, narrow = (slow.moments(flat_band(1.0, band), band).value[0, 0] for band in (BAND_HZ, (2.0, 30.0)))
    assert wide > 10 * narrow
