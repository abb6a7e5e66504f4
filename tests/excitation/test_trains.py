"""Trains: a moving load in closed form and by integration, the universal trains of EN 1991-2, pressure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cmbot.excitation.ground import axles_of
from cmbot.excitation.trains import Span, Train, passing_pressure, pressure_pulse, train_of

SPAN = Span(length=24.0, first=5.5, mass=3500.0, damping=0.005, at=9.0)
ONE = Train(axles=np.zeros(1), loads=np.array([1e5]))


@pytest.mark.parametrize("speed", [5.0, 20.0, 40.0, 70.0])
@pytest.mark.parametrize("share", [0.25, 0.5, 0.7])
def test_one_load_is_frybas_series(speed: float, share: float) -> None:
    """Within 1 % of 60 modes, undamped: 2 P/(m L) sin(n pi x/L) (sin W t - W/w sin w t)/(w^2 - W^2)."""
    span = Span(length=24.0, first=5.5, mass=3500.0, damping=1e-9, at=24.0 * share)
    t = np.linspace(0.0, 24.0 / speed, 2001)
    series = np.zeros_like(t)
    for n in range(1, 61):
        w, W = 2 * np.pi * 5.5 * n**2, n * np.pi * speed / 24.0
        part = (np.sin(W * t) - W / w * np.sin(w * t)) / (w**2 - W**2)
        series += 2e5 / (3500.0 * 24.0) * np.sin(n * np.pi * share) * part
    ours = span.deflection(ONE, speed, t)
    assert np.abs(ours - series).max() < 0.01 * np.abs(series).max()
    assert np.abs(ours).max() == pytest.approx(np.abs(series).max(), rel=0.01)


@pytest.mark.parametrize("speed", [11.0, 44.0, 90.0])
def test_axles_are_those_of_the_beams_equation(speed: float) -> None:
    """On the span and after it, three modes, by an integrator of ordinary differential equations."""
    train = Train(axles=np.array([0.0, 3.0]), loads=np.array([1e5, 2e5]))
    t = np.linspace(0.0, SPAN.passage(train, speed) + 0.5, 1501)

    def rates(time: float, y: np.ndarray) -> list[float]:
        out = []
        for n in (1, 2, 3):
            w = 2 * np.pi * SPAN.first * n**2
            way = speed * time - train.axles
            on = (way >= 0) & (way <= SPAN.length)
            force = 2 * (train.loads * np.sin(n * np.pi * way / SPAN.length) * on).sum()
            q, v = y[2 * n - 2 : 2 * n]
            out += [v, force / (SPAN.mass * SPAN.length) - 2 * SPAN.damping * w * v - w**2 * q]
        return out

    y = solve_ivp(rates, (0, t[-1]), np.zeros(6), t_eval=t, rtol=1e-9, atol=1e-13, max_step=2e-3).y
    shapes = np.sin(np.pi * np.array([1, 2, 3]) * SPAN.at / SPAN.length)
    expected = shapes @ y[::2]
    ours = SPAN.deflection(train, speed, t)
    assert np.abs(ours - expected).max() < 1e-5 * np.abs(expected).max()
    # Its derivatives are those of the same curve.
    second = np.gradient(SPAN.deflection(train, speed, t, 1), t)
    smooth = np.abs(np.gradient(second)) < np.quantile(np.abs(np.gradient(second)), 0.9)
    difference = np.abs(second - SPAN.deflection(train, speed, t, 2))[5:-5]
    assert np.median(difference[smooth[5:-5]]) < 1e-2 * np.abs(second).max()


def test_a_slow_load_bends_the_beam_as_at_rest() -> None:
    """P L^3 / (48 EI) at the middle."""
    span = Span(length=24.0, first=5.5, mass=3500.0, damping=0.05, at=12.0)
    bending = 3500.0 * (2 * np.pi * 5.5) ** 2 * (24.0 / np.pi) ** 4
    speed = 0.2
    deflection = span.deflection(ONE, speed, np.array([12.0 / speed]))[0]
    assert deflection == pytest.approx(1e5 * 24.0**3 / (48 * bending), rel=3e-3)


# Intermediate coaches, their length D and bogies' axle spacing d, m, and load of an axle, kN: EN 1991-2:2003,
# Table 6.3 (2024: Table 8.4), as BeamDyn of KTH Stockholm has it (github.com/addeKTH/BeamDyn, trainloads.js).
UNIVERSAL_TRAINS = [
    *((18, 18, 2.0, 170), (17, 19, 3.5, 200), (16, 20, 2.0, 180), (15, 21, 3.0, 190), (14, 22, 2.0, 170)),
    *((13, 23, 2.0, 180), (13, 24, 2.0, 190), (12, 25, 2.5, 190), (11, 26, 2.0, 210), (11, 27, 2.0, 210)),
]


@pytest.mark.parametrize(("number", "row"), [*enumerate(UNIVERSAL_TRAINS, start=1)])
def test_universal_trains_are_those_of_the_standard(
    number: int, row: tuple[int, float, float, float]
) -> None:
    """Every axle, by the distances of Figure 6.12 from one to the next."""
    coaches, D, d, load = row
    train = train_of(f"hslm_a{number}")
    head = [3, 11, 3, 3.525, d, D - 3.525 / 2 - 1.5 * d]
    gaps = [*head, *[d, D - d] * coaches, d, *head[::-1]]
    assert np.diff(train.axles) == pytest.approx(gaps)
    assert np.all(train.loads == 1e3 * load)
    assert len(train.axles) == 2 * coaches + 14
    assert 350 < train.length < 410


def test_freight_wagons_are_those_of_uic_571_2() -> None:
    """Eaos: 14.04 m over buffers, pivots 9.00 m and axles of a bogie 1.8 m apart; 22.5 t, category D."""
    train = train_of("freight")
    assert np.diff(train.axles[4:12]) == pytest.approx([1.8, 7.2, 1.8, 3.24, 1.8, 7.2, 1.8])
    assert len(train.axles) == 84
    assert train.loads[4:] == pytest.approx(22.5e3 * 9.81, rel=4e-3)


def test_coaches_shake_a_span_most_at_their_resonance() -> None:
    """v = f D / n: at 5.5 Hz and D = 18 m with n = 2 at 178 km/h."""
    train, span = train_of("hslm_a1"), Span(length=12.0, first=5.5, mass=5000.0, damping=0.01, at=6.0)
    speeds = np.arange(150.0, 205.0, 2.0)
    t = [np.arange(0.0, span.passage(train, v / 3.6), 0.002) for v in speeds]
    largest = [np.abs(span.acceleration(train, v / 3.6, at)).max() for v, at in zip(speeds, t, strict=True)]
    assert speeds[int(np.argmax(largest))] == pytest.approx(3.6 * 5.5 * 18 / 2, abs=4)


def test_axles_from_a_file_are_those_of_the_train(tmp_path) -> None:
    train = train_of("emu")
    rows = np.column_stack([train.axles + 5.0, train.loads / 1e3])
    path = tmp_path / "axles.csv"
    np.savetxt(path, rows, delimiter=",", header="at_m,load_kn", comments="")
    read = axles_of(str(path))
    assert read.axles == pytest.approx(train.axles)
    assert read.loads == pytest.approx(train.loads)


def test_pressure_is_that_of_the_standard() -> None:
    """By hand, at 160 km/h and 3 m: (2.5 / 3.25^2 + 0.02) 44.44^2 / 1.6 = 317 Pa."""
    assert passing_pressure(160 / 3.6, 3.0, "freight") == pytest.approx(316.9, abs=0.1)
    assert passing_pressure(160 / 3.6, 3.0, "streamlined") == pytest.approx(0.6 * 316.9, abs=0.1)
    t = np.linspace(-1.0, 12.0, 13001)
    pulse = pressure_pulse(train_of("emu"), 40.0, t)
    assert pulse.max() == pytest.approx(1.0, abs=1e-3)
    assert pulse.min() == pytest.approx(-1.0, abs=1e-3)
    assert np.trapezoid(pulse, t) == pytest.approx(0.0, abs=1e-6)
