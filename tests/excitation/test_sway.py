"""Sway: peaks and the probability of leaving a tolerance against records that are integrated in time."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.signal import lfilter

import cmbot
from cmbot.common.errors import InputError
from cmbot.excitation.peaks import davenport_factor, departure_rate, probability_of_leaving
from cmbot.excitation.response import ModalResponse, TunedDamper, flat_band
from cmbot.excitation.sway import RandomSway, sampled_tool, shaken_adhesion, sway_mm_per_m_s2, sway_of
from cmbot.planning import Plan
from cmbot.scene import Tolerance, load_scene

BAND, SECONDS = (0.5, 30.0), 8.0
RECORDS, STEP = 10_000, 1 / 120


def two_modes() -> ModalResponse:
    """Two close modes of different directions, and a third that is quicker; the tool's axis is z."""
    rng = np.random.default_rng(7)
    tool = rng.normal(size=(3, 3))
    return ModalResponse(
        frequencies=np.array([3.7, 4.2, 10.5]),
        damping=np.array([0.01, 0.01, 0.01]),
        gain=rng.normal(size=(3, 3)),
        tool=tool,
        wrench=np.zeros((6, 3)),
        direct=np.zeros((6, 3)),
        place=tool,
        place_direct=np.zeros((6, 3)),
        axis=np.eye(3)[2],
        shapes=np.eye(3),
        momenta=np.eye(3),
    )


@pytest.fixture(scope="module")
def distances() -> tuple[np.ndarray, np.ndarray]:
    """Largest distances across and along the tool's axis in each of 10,000 records, m.

    Noise in a band, and each mode by a difference equation in time.
    """
    response, rng = two_modes(), np.random.default_rng(11)
    settle, count = round(25.0 / STEP), round(SECONDS / STEP) + 1
    across, along, n = [], [], 4000
    # A flat spectrum of 1 (m/s2)^2 from 0.5 to 30 Hz, of a series that is longer than all that is used.
    f = np.arange(n // 2 + 1) / (n * STEP)
    inside = (f >= BAND[0]) & (f <= BAND[1])
    size = np.sqrt(1 / (BAND[1] - BAND[0]) / (n * STEP)) * n / 2
    X = np.zeros((RECORDS // 20, 3, len(f)), dtype=complex)
    for _ in range(20):
        X[..., inside] = response.gain @ rng.normal(0.0, size, (*X.shape[:2], 2 * inside.sum())).view(complex)
        force, eta = np.fft.irfft(X, n), []
        for k in range(3):
            w, zeta = 2 * np.pi * response.frequencies[k], response.damping[k]
            pole = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w * STEP)
            denominator = [1.0, -2 * pole.real, abs(pole) ** 2]
            # Impulse invariance, with the gain at the mode's frequency that of the equation of motion.
            z = np.exp(1j * w * STEP)
            gain = 1 / (2j * zeta * w**2) * (1 + denominator[1] / z + denominator[2] / z**2)
            eta.append(lfilter([0.0, abs(gain)], denominator, force[:, k, : settle + count])[:, settle:])
        y = np.einsum("dk,krn->drn", response.tool, eta)
        across.append(np.hypot(y[0], y[1]).max(axis=1))
        along.append(np.abs(y[2]).max(axis=1))
    return np.concatenate(across), np.concatenate(along)


def swayed(tolerance: Tolerance | None) -> RandomSway:
    response, spectrum = two_modes(), flat_band()
    t = np.linspace(0.0, SECONDS, 3)
    moments = [response.moments(spectrum, BAND)] * 3
    draw = partial(sampled_tool, t, [response] * 3, spectrum, BAND)
    return sway_of(t, [response] * 3, moments, tolerance, draw)


@pytest.mark.parametrize("share", [0.02, 0.1, 0.5])
def test_exceedance_is_that_of_ten_thousand_records(
    distances: tuple[np.ndarray, np.ndarray], share: float
) -> None:
    """Within a factor 1.2."""
    typical = np.median(np.stack(distances), axis=1)
    level = np.quantile(np.max(np.stack(distances) / typical[:, None], axis=0), 1 - share)
    across_mm, along_axis_mm = (1e3 * level * typical).tolist()
    sway = swayed(Tolerance(across_mm=across_mm, along_axis_mm=along_axis_mm))
    assert sway.leaves_by == "records"
    assert 1 / 1.2 < sway.leaves / share < 1.2


def test_crossings_bound_the_exceedance(distances: tuple[np.ndarray, np.ndarray]) -> None:
    """Rare departures, of which simulated records show too few, are never told to be rarer than they are."""
    moments = two_modes().moments(flat_band(), BAND).along(np.eye(2, 9))
    for share in (0.002, 0.02, 0.1):
        bound = float(np.quantile(distances[0], 1 - share))
        rate, outside = departure_rate(moments, bound)
        told = probability_of_leaving(np.array([0.0, SECONDS]), np.full(2, rate), np.full(2, outside))
        assert told > 0.9 * share
    sway = swayed(Tolerance(across_mm=1e3 * 2 * float(distances[0].max())))
    assert sway.leaves_by == "crossings"
    assert 0 <= sway.leaves < 1e-3


def test_rates_across_one_level_are_rices() -> None:
    """Of one output: twice the rate of zero crossings times exp(-b^2 / 2 s^2), for a wide band."""
    moments = two_modes().moments(flat_band(), BAND).along(np.eye(1, 9))
    moments = replace(moments, first=np.zeros((1, 1)))  # a spread of one: no clumps but few
    s, v = np.sqrt(moments.value[0, 0]), np.sqrt(moments.rate[0, 0])
    rate, outside = departure_rate(moments, 5 * s)
    assert rate == pytest.approx(v / s / np.pi * np.exp(-12.5), rel=0.01)
    assert outside == pytest.approx(np.exp(-12.5))


def test_davenports_factor() -> None:
    """Of 3,600 cycles: sqrt(2 ln 3600) + 0.577 / sqrt(2 ln 3600) = 4.19."""
    assert davenport_factor(1.0, 3600.0) == pytest.approx(4.19, abs=0.005)


@pytest.mark.parametrize("damper", [None, TunedDamper(mass=0.05, frequency=3.6, damping=0.2)])
@pytest.mark.parametrize("acting", [[1, 1, 1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
def test_simulated_records_have_the_covariance(damper: TunedDamper | None, acting: list[int]) -> None:
    """Of the deck along some axes, or of a load on the arm, which a damper does not feel."""
    gain = np.random.default_rng(8).normal(size=(3, 4))
    response, t = (
        replace(two_modes(), gain=gain, direct=np.zeros((6, 4)), damper=damper),
        np.linspace(0, 4, 3),
    )

    def spectrum(f: np.ndarray) -> np.ndarray:
        return flat_band()(f)[:, :1] * np.array(acting)

    tool = sampled_tool(t, [response] * 3, spectrum, BAND, records=1500)
    expected = response.moments(spectrum, BAND).value[:3, :3]
    found = np.einsum("nri,nrj->ij", tool, tool) / (tool.shape[0] * tool.shape[1])
    assert np.abs(found - expected).max() < 0.05 * np.trace(expected)


def test_records_go_on_from_posture_to_posture() -> None:
    """Where frequencies change along the work, responses are not mixed: none is weaker between postures."""
    t, slow = np.linspace(0.0, 20.0, 5), two_modes()
    each = [replace(slow, frequencies=slow.frequencies * (1 + 0.03 * k)) for k in range(len(t))]
    tool = sampled_tool(t, each, flat_band(), BAND, records=1500)
    variances = [response.tool_variance(flat_band(), BAND) for response in each]
    found = (tool.astype(float) ** 2).sum(axis=2).mean(axis=1)
    assert found.min() > 0.8 * min(variances)
    assert found.max() < 1.2 * max(variances)


def test_the_triangle_sways_by_ten_millimetres(triangle_plan: Plan) -> None:
    """By 1 m/s2 of the deck along each axis, as measured with another program: 10.0 to 11."""
    excitation = cmbot.excite(triangle_plan)
    assert excitation.kind == "reference"
    assert 10.0 < excitation.rms_mm < 11.0
    assert sway_mm_per_m_s2(triangle_plan) == pytest.approx(excitation.rms_mm, rel=0.02)
    posture = triangle_plan.trajectory.q[0]
    guardrail = load_scene("triangle").elastic_guardrail
    alone = sway_mm_per_m_s2(posture, triangle_plan.robot, guardrail)
    assert alone == pytest.approx(1e3 * excitation.reference.rms[0], rel=1e-6)
    with pytest.raises(InputError, match="the robot"):
        sway_mm_per_m_s2(posture)
    rigid = replace(triangle_plan.robot, elasticity={}, joint_elasticity={})
    with pytest.raises(InputError, match="nothing that bends"):
        sway_mm_per_m_s2(posture, rigid)


def test_adhesion_is_no_less_than_what_simulated_loads_need(triangle_plan: Plan) -> None:
    """The bound holds for every load within the peaks of its parts."""
    excited = cmbot.excite(triangle_plan)
    holding, robot = triangle_plan.robot.holding, triangle_plan.robot
    assert holding is not None
    moments = two_modes().moments(flat_band(), BAND)
    rng = np.random.default_rng(3)
    spread = rng.normal(size=(6, 6)) * [50, 50, 50, 30, 30, 30]
    moments = replace(moments, value=np.block([[np.zeros((3, 9))], [np.zeros((6, 3)), spread.T @ spread]]))
    planned = np.array([[0.0, 0.0, -300.0, 200.0, -100.0, 20.0]])
    bound = shaken_adhesion(robot, planned, [moments], 3.0)
    root = np.linalg.cholesky(moments.value[3:, 3:] + 1e-9 * np.eye(6))
    directions = rng.normal(size=(4000, 6))
    # All loads together within three standard deviations.
    shaken = planned + 3.0 * directions / np.linalg.norm(directions, axis=1)[:, None] @ root.T
    needed = max(holding.needed(number, shaken).max() for number in holding.adhesive)
    assert needed <= bound
    assert excited.adhesion > triangle_plan.figures.adhesion_needed.peak
