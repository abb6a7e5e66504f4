"""Further problems of the same book, from number 64 on, some of them badly scaled."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from programs.hock_schittkowski import INF, PROBLEMS, add, exp, log

__all__ = ["PROBLEMS"]

add(
    64,
    [1, 1, 1],
    6299.842428,
    lambda x: 5 * x[0] + 50000 / x[0] + 20 * x[1] + 72000 / x[1] + 10 * x[2] + 144000 / x[2],
    lambda x: [1 - 4 / x[0] - 32 / x[1] - 120 / x[2]],
    low=1e-5,
)
add(
    65,
    [-5, 5, 0],
    0.9535288567,
    lambda x: (x[0] - x[1]) ** 2 + (x[0] + x[1] - 10) ** 2 / 9 + (x[2] - 5) ** 2,
    lambda x: [48 - x[0] ** 2 - x[1] ** 2 - x[2] ** 2],
    low=[-4.5, -4.5, -5],
    high=[4.5, 4.5, 5],
)
add(
    72,
    [1, 1, 1, 1],
    727.67937,
    lambda x: 1 + x[0] + x[1] + x[2] + x[3],
    lambda x: [
        0.0401 - 4 / x[0] - 2.25 / x[1] - 1 / x[2] - 0.25 / x[3],
        0.010085 - 0.16 / x[0] - 0.36 / x[1] - 0.64 / x[2] - 0.64 / x[3],
    ],
    low=1e-3,
    high=[4e5, 3e5, 2e5, 1e5],
)
add(
    76,
    [0.5] * 4,
    -4.681818181,
    lambda x: (
        x[0] ** 2
        + 0.5 * x[1] ** 2
        + x[2] ** 2
        + 0.5 * x[3] ** 2
        - x[0] * x[2]
        + x[2] * x[3]
        - x[0]
        - 3 * x[1]
        + x[2]
        - x[3]
    ),
    lambda x: [
        5 - x[0] - 2 * x[1] - x[2] - x[3],
        4 - 3 * x[0] - x[1] - 2 * x[2] + x[3],
        x[1] + 4 * x[2] - 1.5,
    ],
    low=0.0,
)


def _colville_3(x: Any) -> list[Any]:
    a = 85.334407 + 0.0056858 * x[1] * x[4] + 0.0006262 * x[0] * x[3] - 0.0022053 * x[2] * x[4]
    b = 80.51249 + 0.0071317 * x[1] * x[4] + 0.0029955 * x[0] * x[1] + 0.0021813 * x[2] ** 2 - 90
    c = 9.300961 + 0.0047026 * x[2] * x[4] + 0.0012547 * x[0] * x[2] + 0.0019085 * x[2] * x[3] - 20
    return [a, 92 - a, b, 20 - b, c, 5 - c]


add(
    83,
    [78, 33, 27, 27, 27],
    -30665.53867,
    lambda x: 5.3578547 * x[2] ** 2 + 0.8356891 * x[0] * x[4] + 37.293239 * x[0] - 40792.141,
    _colville_3,
    low=[78, 33, 27, 27, 27],
    high=[102, 45, 45, 45, 45],
)

# Colville 1 and its dual, Colville 2.
_E = np.array([-15.0, -27, -36, -18, -12])
_C = np.array(
    [
        [30.0, -20, -10, 32, -10],
        [-20, 39, -6, -31, 32],
        [-10, -6, 10, -6, -10],
        [32, -31, -6, 39, -20],
        [-10, 32, -10, -20, 30],
    ]
)
_D = np.array([4.0, 8, 10, 6, 2])
_A = np.array(
    [
        [-16, 2, 0, 1, 0],
        [0, -2, 0, 0.4, 2],
        [-3.5, 0, 2, 0, 0],
        [0, -2, 0, -4, -1],
        [0, -9, -2, 1, -2.8],
        [2, 0, -4, 0, 0],
        [-1, -1, -1, -1, -1],
        [-1, -2, -3, -2, -1],
        [1, 2, 3, 4, 5],
        [1, 1, 1, 1, 1],
    ]
)
_B = np.array([-40, -2, -0.25, -4, -4, -1, -40, -60, 5, 1])


def _dot(a: Any, x: Any) -> Any:
    return sum(float(each) * x[k] for k, each in enumerate(a) if each)


def _cubic(x: Any, of_cubes: float) -> Any:
    quadratic = sum(_C[i, j] * x[i] * x[j] for i in range(5) for j in range(5))
    return quadratic + of_cubes * sum(_D[j] * x[j] ** 3 for j in range(5))


add(
    86,
    [0, 0, 0, 0, 1],
    -32.34867897,
    lambda x: _dot(_E, x) + _cubic(x, 1.0),
    lambda x: [_dot(row, x) - b for row, b in zip(_A, _B, strict=True)],
    low=0.0,
)


def _rocket(x: Any) -> tuple[Any, Any]:
    return x[0] * x[3] * (x[0] + x[1] + x[2]), x[1] * x[2] * (x[0] + 1.57 * x[1] + x[3])


add(
    93,
    [5.54, 4.4, 12.02, 11.8, 0.702, 0.852],
    135.075961,
    lambda x: _rocket(x)[0] * (0.0204 + 0.0607 * x[4] ** 2) + _rocket(x)[1] * (0.0187 + 0.0437 * x[5] ** 2),
    lambda x: [
        1e-3 * math.prod(x) - 2.07,
        1 - 0.00062 * x[4] ** 2 * _rocket(x)[0] - 0.00058 * x[5] ** 2 * _rocket(x)[1],
    ],
    low=0.0,
)
add(
    100,
    [1, 2, 0, 4, 0, 1, 1],
    680.6300573,
    lambda x: (
        (x[0] - 10) ** 2
        + 5 * (x[1] - 12) ** 2
        + x[2] ** 4
        + 3 * (x[3] - 11) ** 2
        + 10 * x[4] ** 6
        + 7 * x[5] ** 2
        + x[6] ** 4
        - 4 * x[5] * x[6]
        - 10 * x[5]
        - 8 * x[6]
    ),
    lambda x: [
        127 - 2 * x[0] ** 2 - 3 * x[1] ** 4 - x[2] - 4 * x[3] ** 2 - 5 * x[4],
        282 - 7 * x[0] - 3 * x[1] - 10 * x[2] ** 2 - x[3] + x[4],
        196 - 23 * x[0] - x[1] ** 2 - 6 * x[5] ** 2 + 8 * x[6],
        -4 * x[0] ** 2 - x[1] ** 2 + 3 * x[0] * x[1] - 2 * x[2] ** 2 - 5 * x[5] + 11 * x[6],
    ],
)


def _power(x: Any, exponent: float) -> Any:
    return exp(exponent * log(x))


def _reactor(x: Any) -> Any:
    first = 0.4 * _power(x[0], 0.67) * _power(x[6], -0.67)
    return first + 0.4 * _power(x[1], 0.67) * _power(x[7], -0.67) + 10 - x[0] - x[1]


def _reactor_rows(x: Any) -> list[Any]:
    def last(a: Any, b: Any, c: Any) -> Any:
        return 1 - 4 * a / b - 2 * _power(a, -0.71) / b - 0.0588 * c * _power(a, -1.3)

    f = _reactor(x)
    return [
        1 - 0.0588 * x[4] * x[6] - 0.1 * x[0],
        1 - 0.0588 * x[5] * x[7] - 0.1 * x[0] - 0.1 * x[1],
        last(x[2], x[4], x[6]),
        last(x[3], x[5], x[7]),
        f - 1,
        4.2 - f,
    ]


add(104, [6, 3, 0.4, 0.2, 6, 6, 1, 0.5], 3.9511634396, _reactor, _reactor_rows, low=0.1, high=10.0)
add(
    106,
    [5000, 5000, 5000, 200, 350, 150, 225, 425],
    7049.24802,
    lambda x: x[0] + x[1] + x[2],
    lambda x: [
        1 - 0.0025 * (x[3] + x[5]),
        1 - 0.0025 * (x[4] + x[6] - x[3]),
        1 - 0.01 * (x[7] - x[4]),
        x[0] * x[5] - 833.33252 * x[3] - 100 * x[0] + 83333.333,
        x[1] * x[6] - 1250 * x[4] - x[1] * x[3] + 1250 * x[3],
        x[2] * x[7] - 1250000 - x[2] * x[4] + 2500 * x[4],
    ],
    low=[100, 1000, 1000, 10, 10, 10, 10, 10],
    high=[10000, 10000, 10000, 1000, 1000, 1000, 1000, 1000],
    remark="published as 7049.330923, which is 1e-5 too much",
)


def _hexagon(x: Any) -> list[Any]:
    x1, x2, x3, x4, x5, x6, x7, x8, x9 = x
    return [
        1 - x3**2 - x4**2,
        1 - x9**2,
        1 - x5**2 - x6**2,
        1 - x1**2 - (x2 - x9) ** 2,
        1 - (x1 - x5) ** 2 - (x2 - x6) ** 2,
        1 - (x1 - x7) ** 2 - (x2 - x8) ** 2,
        1 - (x3 - x5) ** 2 - (x4 - x6) ** 2,
        1 - (x3 - x7) ** 2 - (x4 - x8) ** 2,
        1 - x7**2 - (x8 - x9) ** 2,
        x1 * x4 - x2 * x3,
        x3 * x9,
        -x5 * x9,
        x5 * x8 - x6 * x7,
    ]


add(
    108,
    [1] * 9,
    -0.8660254038,
    lambda x: -0.5 * (x[0] * x[3] - x[1] * x[2] + x[2] * x[8] - x[4] * x[8] + x[4] * x[7] - x[5] * x[6]),
    _hexagon,
    low=[-INF] * 8 + [0],
    remark="other local optima at -0.675 and -0.5",
)
add(
    110,
    [9] * 10,
    -45.77846971,
    lambda x: (
        sum(log(each - 2) ** 2 + log(10 - each) ** 2 for each in x) - exp(0.2 * sum(log(each) for each in x))
    ),
    low=2.001,
    high=9.999,
)
add(
    113,
    [2, 3, 5, 5, 1, 2, 7, 3, 6, 10],
    24.3062091,
    lambda x: (
        x[0] ** 2
        + x[1] ** 2
        + x[0] * x[1]
        - 14 * x[0]
        - 16 * x[1]
        + (x[2] - 10) ** 2
        + 4 * (x[3] - 5) ** 2
        + (x[4] - 3) ** 2
        + 2 * (x[5] - 1) ** 2
        + 5 * x[6] ** 2
        + 7 * (x[7] - 11) ** 2
        + 2 * (x[8] - 10) ** 2
        + (x[9] - 7) ** 2
        + 45
    ),
    lambda x: [
        105 - 4 * x[0] - 5 * x[1] + 3 * x[6] - 9 * x[7],
        -10 * x[0] + 8 * x[1] + 17 * x[6] - 2 * x[7],
        8 * x[0] - 2 * x[1] - 5 * x[8] + 2 * x[9] + 12,
        -3 * (x[0] - 2) ** 2 - 4 * (x[1] - 3) ** 2 - 2 * x[2] ** 2 + 7 * x[3] + 120,
        -5 * x[0] ** 2 - 8 * x[1] - (x[2] - 6) ** 2 + 2 * x[3] + 40,
        -0.5 * (x[0] - 8) ** 2 - 2 * (x[1] - 4) ** 2 - 3 * x[4] ** 2 + x[5] + 30,
        -(x[0] ** 2) - 2 * (x[1] - 2) ** 2 + 2 * x[0] * x[1] - 14 * x[4] + 6 * x[5],
        3 * x[0] - 6 * x[1] - 12 * (x[8] - 8) ** 2 + 7 * x[9],
    ],
)
add(
    117,
    [1e-3] * 6 + [60] + [1e-3] * 8,
    32.34867897,
    lambda x: -_dot(_B, x) + _cubic(x[10:], 2.0),
    lambda x: [
        2 * _dot(_C[:, j], x[10:]) + 3 * _D[j] * x[10 + j] ** 2 + _E[j] - _dot(_A[:, j], x) for j in range(5)
    ],
    low=0.0,
)


def _output(x: Any) -> Any:
    linear, square = (2.3, 1.7, 2.2), (1e-4, 1e-4, 1.5e-4)
    return sum(linear[k % 3] * each + square[k % 3] * each**2 for k, each in enumerate(x))


def _steps(x: Any) -> list[Any]:
    rows = [sum(x[3 * j : 3 * j + 3]) - least for j, least in enumerate((60, 50, 70, 85, 100))]
    for k in range(3, 15):
        step = x[k] - x[k - 3] + 7
        rows += [step, (14 if k % 3 == 1 else 13) - step]
    return rows


add(
    118,
    [20, 55, 15] + [20, 60, 20] * 4,
    664.82045,
    _output,
    _steps,
    low=[8, 43, 3] + [0] * 12,
    high=[21, 57, 16] + [90, 120, 60] * 4,
)
