"""Trains over a span: axle loads, the deck's acceleration, and the pressure of their passing.

The span is a simply supported Euler-Bernoulli beam with three modes; axles are constant forces that move at
one speed. For each mode n::

    q_n'' + 2 zeta w_n q_n' + w_n^2 q_n = 2 / (m L) sum_i P_i sin(n pi s_i / L),    s_i = v (t - t_i) in 0 … L

which has a closed form for each axle, on the span and after it (Fryba, *Vibration of solids and structures
under moving loads*, 1972). The deck goes down by ``sum_n q_n sin(n pi x / L)`` at the place x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr

# With three the deflection under a load is within 0.3 % of that of all modes.
_SPAN_MODES = 3
# EN 1991-2:2003, Table 6.3 (2024: Table 8.4): intermediate coaches, their length D, axle spacing d of a
# bogie, m, axle load P, kN.
_HSLM_A = (
    *((18, 18.0, 2.0, 170.0), (17, 19.0, 3.5, 200.0), (16, 20.0, 2.0, 180.0), (15, 21.0, 3.0, 190.0)),
    *((14, 22.0, 2.0, 170.0), (13, 23.0, 2.0, 180.0), (13, 24.0, 2.0, 190.0), (12, 25.0, 2.5, 190.0)),
    *((11, 26.0, 2.0, 210.0), (11, 27.0, 2.0, 210.0)),
)
# Figure 6.12 there: axles of a power car, m, and its last one's distance from the end coach's first one.
_POWER_CAR, _COUPLING = (0.0, 3.0, 14.0, 17.0), 3.525
# 20 wagons Eaos of UIC 571-2 with the axle load of line category D (EN 15528: 22.5 t), behind a locomotive
# of 210 kN an axle; assumed: a multiple unit of 8 cars of 25 m with bogies of 2.5 m, 18 m apart, 150 kN.
_WAGONS, _WAGON, _PIVOTS, _WHEELBASE, _WAGON_KN = 20, 14.04, 9.0, 1.8, 220.0
_LOCOMOTIVE, _LOCOMOTIVE_KN = (0.0, 3.0, 10.4, 13.4), 210.0
_CARS, _CAR, _CAR_PIVOTS, _CAR_WHEELBASE, _CAR_KN = 8, 25.0, 18.0, 2.5, 150.0

# EN 1991-2, 6.6.2: factor of the vehicle's shape; how long each half of the pulse is at the head and tail, m.
_SHAPE_FACTORS = {"freight": 1.0, "smooth": 0.85, "streamlined": 0.6}
_HALF_PULSE_M = 5.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Train(ShortRepr):
    """Axles behind the first one, m, ascending from 0, and their loads, N; arrays (A,)."""

    axles: FloatArray
    loads: FloatArray

    @property
    def length(self) -> float:
        """From the first axle to the last one, m."""
        return float(self.axles[-1])


def train_of(name: str) -> Train:
    """Return a train by its name, one of `cmbot.scene.TRAINS`."""
    if name == "freight":
        wagon = np.array([0.0, _WHEELBASE, _PIVOTS, _PIVOTS + _WHEELBASE])
        first = _LOCOMOTIVE[-1] + _COUPLING
        wagons = first + (np.arange(_WAGONS)[:, None] * _WAGON + wagon).ravel()
        loads = np.repeat([_LOCOMOTIVE_KN, _WAGON_KN], [len(_LOCOMOTIVE), wagons.size])
        return Train(axles=np.concatenate([_LOCOMOTIVE, wagons]), loads=1e3 * loads)
    if name == "emu":
        car = np.array([0.0, _CAR_WHEELBASE, _CAR_PIVOTS, _CAR_PIVOTS + _CAR_WHEELBASE])
        axles = (np.arange(_CARS)[:, None] * _CAR + car).ravel()
        return Train(axles=axles, loads=np.full(axles.size, 1e3 * _CAR_KN))
    coaches, D, d, load = _HSLM_A[int(name.removeprefix("hslm_a")) - 1]
    begin = _POWER_CAR[-1] + _COUPLING
    # Coaches share bogies, which stand over their ends; the first one's front end is amid the coupling.
    joints = _POWER_CAR[-1] + _COUPLING / 2 + D * np.arange(1, coaches + 2)
    half = np.concatenate([_POWER_CAR, [begin, begin + d]])
    length = joints[0] + joints[-1]
    pairs = (joints[:, None] + np.array([-d / 2, d / 2])).ravel()
    axles = np.concatenate([half, pairs, length - half[::-1]])
    return Train(axles=axles, loads=np.full(axles.size, 1e3 * load))


@dataclass(frozen=True, kw_only=True)
class Span:
    """A simply supported beam: length, m; first frequency, Hz; mass, kg/m; damping; the arm's place, m."""

    length: float
    first: float
    mass: float
    damping: float
    at: float

    def deflection(self, train: Train, speed: float, t: FloatArray, order: int = 0) -> FloatArray:
        """Return how far the deck is down at the place (N,), m, at times `t` (N,), s, or a derivative of it.

        Parameters
        ----------
        train : Train
            Its first axle comes onto the span at time 0.
        speed : float, m/s
        t : (N,), s
        order : int
            0, 1 or 2: of the derivative by time.
        """
        down = np.zeros_like(t)
        for n in range(1, _SPAN_MODES + 1):
            shape = np.sin(n * np.pi * self.at / self.length)
            for place, load in zip(train.axles, train.loads, strict=True):
                down += shape * load * self._mode(n, speed, t - place / speed, order)
        return down

    def acceleration(self, train: Train, speed: float, t: FloatArray) -> FloatArray:
        """Return the acceleration of the deck (N, 3), m/s2, in W: along z alone."""
        return np.asarray(np.outer(self.deflection(train, speed, t, order=2), [0.0, 0.0, -1.0]))

    def passage(self, train: Train, speed: float) -> float:
        """Return when the last axle leaves, s."""
        return (self.length + train.length) / speed

    def _mode(self, n: int, speed: float, t: FloatArray, order: int) -> FloatArray:
        """Coordinate of a mode under a unit force that came onto the span at time 0, or a derivative."""
        w, forced = 2 * np.pi * self.first * n**2, n * np.pi * speed / self.length
        level = 2 / (self.mass * self.length)
        rate = complex(-self.damping * w, w * np.sqrt(1 - self.damping**2))
        leaves = self.length / speed
        # Steady part: of the force exp(i forced t), its imaginary part.
        steady = level / (w**2 - forced**2 + 2j * self.damping * w * forced)
        q = np.zeros_like(t)
        on, off = (t >= 0) & (t <= leaves), t > leaves
        free = _free(rate, -steady.imag, -(1j * forced * steady).imag)
        q[on] = ((1j * forced) ** order * steady * np.exp(1j * forced * t[on])).imag
        q[on] += (rate**order * free * np.exp(rate * t[on])).real
        end = steady * np.exp(1j * forced * leaves)
        gone = free * np.exp(rate * leaves)
        after = _free(rate, end.imag + gone.real, (1j * forced * end).imag + (rate * gone).real)
        q[off] = (rate**order * after * np.exp(rate * (t[off] - leaves))).real
        return q


def _free(rate: complex, value: float, slope: float) -> complex:
    """Amplitude A of the free vibration Re(A exp(rate t)) that begins with a value and a slope."""
    return complex(value, (rate.real * value - slope) / rate.imag)


def passing_pressure(speed: float, distance: float, shape: str) -> float:
    """Return the pressure of a passing train on what stands beside the track, Pa: EN 1991-2, 6.6.2.

    ``k (2.5 / (a + 0.25)^2 + 0.02) v^2 / 1.6``: its curve for simple vertical surfaces, in the form of EN
    14067.

    Parameters
    ----------
    speed : float, m/s
    distance : float, m
        From the axis of the track, 2.3 or more.
    shape : str
        Of the train: ``freight``, ``smooth`` or ``streamlined``.
    """
    return _SHAPE_FACTORS[shape] * (2.5 / (distance + 0.25) ** 2 + 0.02) * speed**2 / 1.6


def pressure_pulse(train: Train, speed: float, t: FloatArray) -> FloatArray:
    """Return the pressure of a passing (N,), as a share of its largest, at times `t` (N,), s.

    A full sine of 10 m as the head passes, and one as the tail does; the head does at time 0.
    """
    pulse = np.zeros_like(t)
    for place in (0.0, train.length):
        way = speed * t - place
        inside = np.abs(way) < _HALF_PULSE_M
        pulse[inside] -= np.sin(np.pi * way[inside] / _HALF_PULSE_M)
    return pulse
