"""Figures of a tracking error against what can be computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import welch

from cmbot.simulation.metrics import error_metrics, mode_power, power_density, residual, statistics

FloatArray = NDArray[np.float64]
STEP = 0.005
T = STEP * np.arange(4001)


def along(x: FloatArray, axis: int = 0) -> FloatArray:
    """A vector with one component."""
    error = np.zeros((len(x), 3))
    error[:, axis] = x
    return error


def test_statistics_of_a_few_samples() -> None:
    """By hand, with the trapezoidal rule's weights 1/4, 1/2, 1/4."""
    figures = statistics(
        np.array([0.0, 1.0, 2.0]), np.array([[0.0, 3.0, 0.0], [4.0, 3.0, 0.0], [8.0, 3.0, 0.0]])
    )
    norms = np.array([3.0, 5.0, np.sqrt(73.0)])
    norm_mean = (norms[0] + 2 * norms[1] + norms[2]) / 4
    np.testing.assert_allclose(figures.mean, [4.0, 3.0, 0.0, norm_mean])
    np.testing.assert_allclose(figures.standard_deviation[:3], [np.sqrt(8.0), 0.0, 0.0])
    np.testing.assert_allclose(figures.rms[:3], [np.sqrt(24.0), 3.0, 0.0])
    np.testing.assert_allclose(figures.rms[3], np.sqrt((9 + 2 * 25 + 73) / 4))
    np.testing.assert_allclose(figures.peak_to_peak, [8.0, 0.0, 0.0, norms[2] - 3.0])


def test_a_last_step_that_is_shorter_weighs_less() -> None:
    t = np.array([0.0, 1.0, 2.0, 2.5])
    figures = statistics(t, along(t))
    assert figures.mean[0] == pytest.approx(1.25)
    assert figures.rms[0] ** 2 == pytest.approx(np.trapezoid(t**2, t) / 2.5)


def test_statistics_of_a_vibration_about_a_mean() -> None:
    error = along(0.01 + 0.002 * np.sin(2 * np.pi * 5 * T), 2)
    figures = statistics(T, error)
    assert figures.mean[2] == pytest.approx(0.01)
    assert figures.standard_deviation[2] == pytest.approx(0.002 / np.sqrt(2))
    assert figures.rms[2] ** 2 == pytest.approx(0.01**2 + 0.002**2 / 2)
    assert figures.peak_to_peak[2] == pytest.approx(0.004)
    np.testing.assert_allclose(figures.rms[3], figures.rms[2])


def test_mean_square_is_mean_and_deviation(rng: np.random.Generator) -> None:
    figures = statistics(T, rng.normal([1.0, 0.0, -2.0], 1.0, (len(T), 3)))
    np.testing.assert_allclose(figures.rms**2, figures.mean**2 + figures.standard_deviation**2)
    np.testing.assert_allclose((figures.rms[:3] ** 2).sum(), figures.rms[3] ** 2)


def test_a_residual_that_decays() -> None:
    t = STEP * np.arange(401)
    swing = 1e-3 * np.exp(-0.6 * t) * np.cos(2 * np.pi * 4 * t)
    found = residual(t + 20.0, np.column_stack([3 * swing, 4 * swing, 0 * swing]))
    assert found.seconds == pytest.approx(2.0)
    low, high = swing.min(), swing.max()
    np.testing.assert_allclose(found.peak_to_peak, [3 * (high - low), 4 * (high - low), 0.0])
    assert found.diameter == pytest.approx(5 * (high - low))
    # From the first quarter to the last it is 1.5 s.
    assert found.decay == pytest.approx(np.exp(-0.6 * 1.5), rel=0.01)


def test_the_diameter_is_not_the_diagonal_of_a_box() -> None:
    angle = np.linspace(0, 2 * np.pi, 361)
    found = residual(angle, np.column_stack([np.cos(angle), np.sin(angle), 0 * angle]))
    np.testing.assert_allclose(found.peak_to_peak, [2.0, 2.0, 0.0])
    assert found.diameter == pytest.approx(2.0)


def test_what_does_not_move_does_not_decay() -> None:
    found = residual(T[:400], np.zeros((400, 3)))
    assert found.decay is None
    assert found.diameter == 0.0


def test_power_of_sines() -> None:
    """A sine of amplitude A has the mean square A^2/2; axes add up; the mean has no power."""
    short = T[:400]
    for t, sines, modes, power, rtol, atol in (
        (T, [(1e-3, 4), (2e-3, 11)], [4, 7, 11], [0.5e-6, 0, 2e-6], 0.009, 5e-10),
        (T, [(1, 3.9), (1, 4.4)], [3.8, 4.5], [0.5, 0.5], 0.01, 0),  # near modes share their bands
        (T, [(1, 20)], [4, 9], [0, 0], 0, 1e-6),
        (short, [(1, 8)], [8], [0.5], 0.02, 0),
    ):
        error = 5.0 + sum(along(A * np.sin(2 * np.pi * f * t), axis) for axis, (A, f) in enumerate(sines))
        np.testing.assert_allclose(mode_power(STEP, error, np.array(modes)), power, rtol=rtol, atol=atol)


@pytest.mark.parametrize(("count", "size"), [(5000, 2048), (301, 301), (300, 300), (7, 4), (2, 2)])
def test_power_density_is_that_of_scipy(count: int, size: int, rng: np.random.Generator) -> None:
    dynamic = 1.0 + rng.normal(size=(count, 3))
    frequencies, density = power_density(STEP, dynamic, size)
    wanted_at, wanted = welch(dynamic, 1 / STEP, nperseg=size, detrend="constant", axis=0)
    np.testing.assert_allclose(frequencies, wanted_at, rtol=1e-14)
    np.testing.assert_allclose(density, wanted.sum(axis=1), rtol=0, atol=1e-13 * wanted.max())


def test_figures_split_the_error_at_the_stop() -> None:
    static = along(np.full(len(T), -0.01), 2)
    dynamic = along(np.where(T <= 15.0, 1e-3, 2e-3) * np.sin(2 * np.pi * 5 * T))
    moving = 3001
    figures = error_metrics(
        T, static + dynamic, static, 3 * static, moving, np.array([5.0, 9.0, 20.0, 70.0, 400.0])
    )
    assert figures.static.mean[2] == pytest.approx(-0.01)
    assert figures.static.peak_to_peak.max() == 0.0
    assert figures.path.mean[2] == pytest.approx(-0.03)
    assert figures.dynamic.rms[0] == pytest.approx(1e-3 / np.sqrt(2), rel=1e-3)
    np.testing.assert_allclose(figures.total.mean, figures.static.mean, atol=1e-4)
    assert figures.residual is not None
    assert figures.residual.seconds == pytest.approx(5.0)
    assert figures.residual.diameter == pytest.approx(4e-3, rel=1e-3)
    assert figures.mode_power[0] == pytest.approx(0.5e-6, rel=0.01)
    assert len(figures.mode_frequencies) == 4


def test_modes_that_the_samples_show_count_and_of_many_the_first_four() -> None:
    error = along(np.sin(T))
    for t, modes, shown in ((4 * T, [5, 20, 22], [5, 20]), (T, range(1, 20), [1, 2, 3, 4])):
        figures = error_metrics(t, error, error, error, len(T), np.array(modes, dtype=float))
        np.testing.assert_array_equal(figures.mode_frequencies, shown)
        assert figures.residual is None
