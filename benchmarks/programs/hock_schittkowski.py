"""Problems of W. Hock and K. Schittkowski, Test Examples for Nonlinear Programming Codes, Springer 1981.

Those without equality constraints that are written in a few lines, and four whose linear equality leaves
unknowns to eliminate (9, 14, 32, 41). Formulas take the unknowns as a list, counted from 0, and give the
objective and constraints ``g(x) >= 0``; bounds, the start and the published optimum stand beside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from measure import required

__all__ = ["PROBLEMS", "Problem", "add", "exp", "log"]

INF = math.inf
Formula = Callable[[Any], Any]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """``min f(x), g(x) >= 0, low <= x <= high``.

    Attributes
    ----------
    number : int
        In the book.
    start, low, high : tuple of float
        Bounds that are given as one number hold for all unknowns.
    objective, constraints : callable
        x to f, and to g as a list.
    optimum : float
        f as published.
    name : str
        How tables call it.
    remark : str
        Where it is no ordinary problem.
    """

    number: int
    start: tuple[float, ...]
    objective: Formula
    constraints: Formula
    low: tuple[float, ...]
    high: tuple[float, ...]
    optimum: float
    name: str
    remark: str = ""


PROBLEMS: list[Problem] = []


def add(
    number: int,
    start: Sequence[float],
    optimum: float,
    objective: Formula,
    constraints: Formula = lambda _: [],
    low: float | Sequence[float] = -INF,
    high: float | Sequence[float] = INF,
    remark: str = "",
) -> None:
    """Add a problem: its number, start, published optimum, f, g, bounds."""
    n = len(start)
    each = [tuple(side) if isinstance(side, Sequence) else (side,) * n for side in (low, high)]
    PROBLEMS.append(
        Problem(
            number=number,
            name=f"HS{number}",
            start=tuple(map(float, start)),
            objective=objective,
            constraints=constraints,
            low=each[0],
            high=each[1],
            optimum=optimum,
            remark=remark,
        )
    )


def exp(x: Any) -> Any:
    """Of a number, or of casadi's."""
    return required("casadi").exp(x)


def log(x: Any) -> Any:
    """Of a number, or of casadi's."""
    return required("casadi").log(x)


def sin(x: Any) -> Any:
    """Of a number, or of casadi's."""
    return required("casadi").sin(x)


def _banana(x: Any) -> Any:
    return 100 * (x[1] - x[0] ** 2) ** 2 + (1 - x[0]) ** 2


def _product(x: Any) -> Any:
    return -x[0] * x[1] * x[2]


_a = math.sqrt(598 / 1200)
_x = 2 * _a * math.cos(math.acos(1 / (400 * _a**3)) / 3)
add(1, [-2, 1], 0.0, _banana, low=[-INF, -1.5])
add(2, [-2, 1], _banana([_x, 1.5]), _banana, low=[-INF, 1.5], remark="another local optimum at 4.94")
add(3, [10, 1], 0.0, lambda x: x[1] + 1e-5 * (x[1] - x[0]) ** 2, low=[-INF, 0])
add(4, [1.125, 0.125], 8 / 3, lambda x: (x[0] + 1) ** 3 / 3 + x[1], low=[1, 0])
add(
    5,
    [0, 0],
    -math.sqrt(3) / 2 - math.pi / 3,
    lambda x: sin(x[0] + x[1]) + (x[0] - x[1]) ** 2 - 1.5 * x[0] + 2.5 * x[1] + 1,
    low=[-1.5, -3],
    high=[4, 3],
)
# 4 x1 = 3 x2: x1 = 3 s, x2 = 4 s.
add(9, [0], -0.5, lambda x: 0.5 * sin(math.pi * x[0] / 2))
add(
    10,
    [-10, 10],
    -1.0,
    lambda x: x[0] - x[1],
    lambda x: [-3 * x[0] ** 2 + 2 * x[0] * x[1] - x[1] ** 2 + 1],
)
add(11, [4.9, 0.1], -8.498464223, lambda x: (x[0] - 5) ** 2 + x[1] ** 2 - 25, lambda x: [-(x[0] ** 2) + x[1]])
add(
    12,
    [0, 0],
    -30.0,
    lambda x: 0.5 * x[0] ** 2 + x[1] ** 2 - x[0] * x[1] - 7 * x[0] - 7 * x[1],
    lambda x: [25 - 4 * x[0] ** 2 - x[1] ** 2],
)
add(
    13,
    [-2, -2],
    1.0,
    lambda x: (x[0] - 2) ** 2 + x[1] ** 2,
    lambda x: [(1 - x[0]) ** 3 - x[1]],
    low=0.0,
    remark="no multipliers exist at the optimum",
)
# x1 = 2 x2 - 1.
add(
    14,
    [2],
    9 - 2.875 * math.sqrt(7),
    lambda x: (2 * x[0] - 3) ** 2 + (x[0] - 1) ** 2,
    lambda x: [1 - (2 * x[0] - 1) ** 2 / 4 - x[0] ** 2],
)
add(
    15,
    [-2, 1],
    306.5,
    _banana,
    lambda x: [x[0] * x[1] - 1, x[0] + x[1] ** 2],
    high=[0.5, INF],
    remark="another local optimum at 360.4",
)
add(
    16,
    [-2, 1],
    0.25,
    _banana,
    lambda x: [x[0] + x[1] ** 2, x[0] ** 2 + x[1]],
    low=[-0.5, -INF],
    high=[0.5, 1],
    remark="another local optimum at 23.1",
)
add(
    17,
    [-2, 1],
    1.0,
    _banana,
    lambda x: [x[1] ** 2 - x[0], x[0] ** 2 - x[1]],
    low=[-0.5, -INF],
    high=[0.5, 1],
)
add(
    18,
    [2, 2],
    5.0,
    lambda x: 0.01 * x[0] ** 2 + x[1] ** 2,
    lambda x: [x[0] * x[1] - 25, x[0] ** 2 + x[1] ** 2 - 25],
    low=[2, 0],
    high=[50, 50],
)
add(
    19,
    [20.1, 5.84],
    -6961.81381,
    lambda x: (x[0] - 10) ** 3 + (x[1] - 20) ** 3,
    lambda x: [
        (x[0] - 5) ** 2 + (x[1] - 5) ** 2 - 100,
        82.81 - (x[1] - 5) ** 2 - (x[0] - 6) ** 2,
    ],
    low=[13, 0],
    high=[100, 100],
)
add(
    20,
    [-2, 1],
    81.5 - 25 * math.sqrt(3),
    _banana,
    lambda x: [x[0] + x[1] ** 2, x[0] ** 2 + x[1], x[0] ** 2 + x[1] ** 2 - 1],
    low=[-0.5, -INF],
    high=[0.5, INF],
    remark="another local optimum at 40.2",
)
add(
    21,
    [-1, -1],
    -99.96,
    lambda x: 0.01 * x[0] ** 2 + x[1] ** 2 - 100,
    lambda x: [10 * x[0] - x[1] - 10],
    low=[2, -50],
    high=[50, 50],
)
add(
    22,
    [2, 2],
    1.0,
    lambda x: (x[0] - 2) ** 2 + (x[1] - 1) ** 2,
    lambda x: [-x[0] - x[1] + 2, -(x[0] ** 2) + x[1]],
)
add(
    23,
    [3, 1],
    2.0,
    lambda x: x[0] ** 2 + x[1] ** 2,
    lambda x: [
        x[0] + x[1] - 1,
        x[0] ** 2 + x[1] ** 2 - 1,
        9 * x[0] ** 2 + x[1] ** 2 - 9,
        x[0] ** 2 - x[1],
        x[1] ** 2 - x[0],
    ],
    low=-50.0,
    high=50.0,
)
add(
    24,
    [1, 0.5],
    -1.0,
    lambda x: ((x[0] - 3) ** 2 - 9) * x[1] ** 3 / (27 * math.sqrt(3)),
    lambda x: [
        x[0] / math.sqrt(3) - x[1],
        x[0] + math.sqrt(3) * x[1],
        6 - x[0] - math.sqrt(3) * x[1],
    ],
    low=0.0,
)
add(
    25,
    [100, 12.5, 3],
    0.0,
    lambda x: sum(
        (-0.01 * i + exp(-exp(x[2] * log(25 + (-50 * math.log(0.01 * i)) ** (2 / 3) - x[1])) / x[0])) ** 2
        for i in range(1, 100)
    ),
    low=[0.1, 0, 0],
    high=[100, 25.6 - 1e-3, 5],
    remark="at the start nearly flat: 32.8 and no slope; x2 is kept 1e-3 below its bound, where u - x2 is 0",
)
add(29, [1, 1, 1], -16 * math.sqrt(2), _product, lambda x: [48 - x[0] ** 2 - 2 * x[1] ** 2 - 4 * x[2] ** 2])
add(
    30,
    [1, 1, 1],
    1.0,
    lambda x: x[0] ** 2 + x[1] ** 2 + x[2] ** 2,
    lambda x: [x[0] ** 2 + x[1] ** 2 - 1],
    low=[1, -10, -10],
    high=[10, 10, 10],
)
add(
    31,
    [1, 1, 1],
    6.0,
    lambda x: 9 * x[0] ** 2 + x[1] ** 2 + 9 * x[2] ** 2,
    lambda x: [x[0] * x[1] - 1],
    low=[-10, 1, -10],
    high=[10, 10, 1],
)
# x3 = 1 - x1 - x2.
add(
    32,
    [0.1, 0.7],
    1.0,
    lambda x: (1 + 2 * x[1]) ** 2 + 4 * (x[0] - x[1]) ** 2,
    lambda x: [6 * x[1] + 4 * (1 - x[0] - x[1]) - x[0] ** 3 - 3, 1 - x[0] - x[1]],
    low=0.0,
)
add(
    33,
    [0, 0, 3],
    math.sqrt(2) - 6,
    lambda x: (x[0] - 1) * (x[0] - 2) * (x[0] - 3) + x[2],
    lambda x: [x[2] ** 2 - x[1] ** 2 - x[0] ** 2, x[0] ** 2 + x[1] ** 2 + x[2] ** 2 - 4],
    low=0.0,
    high=[INF, INF, 5],
    remark="another stationary point at -4",
)
for _number, _best, _goal in (
    (34, -math.log(math.log(10)), lambda x: -x[0]),
    (66, 0.5181632741, lambda x: 0.2 * x[2] - 0.8 * x[0]),
):
    add(
        _number,
        [0, 1.05, 2.9],
        _best,
        _goal,
        lambda x: [x[1] - exp(x[0]), x[2] - exp(x[1])],
        low=0.0,
        high=[100, 100, 10],
    )
add(
    35,
    [0.5, 0.5, 0.5],
    1 / 9,
    lambda x: (
        9
        - 8 * x[0]
        - 6 * x[1]
        - 4 * x[2]
        + 2 * x[0] ** 2
        + 2 * x[1] ** 2
        + x[2] ** 2
        + 2 * x[0] * x[1]
        + 2 * x[0] * x[2]
    ),
    lambda x: [3 - x[0] - x[1] - 2 * x[2]],
    low=0.0,
)
add(
    36,
    [10, 10, 10],
    -3300.0,
    _product,
    lambda x: [72 - x[0] - 2 * x[1] - 2 * x[2]],
    low=0.0,
    high=[20, 11, 42],
)
add(
    37,
    [10, 10, 10],
    -3456.0,
    _product,
    lambda x: [72 - x[0] - 2 * x[1] - 2 * x[2], x[0] + 2 * x[1] + 2 * x[2]],
    low=0.0,
    high=42.0,
)
add(
    38,
    [-3, -1, -3, -1],
    0.0,
    lambda x: (
        _banana(x)
        + 90 * (x[3] - x[2] ** 2) ** 2
        + (1 - x[2]) ** 2
        + 10.1 * ((x[1] - 1) ** 2 + (x[3] - 1) ** 2)
        + 19.8 * (x[1] - 1) * (x[3] - 1)
    ),
    low=-10.0,
    high=10.0,
)
# x4 = x1 + 2 x2 + 2 x3.
add(
    41,
    [2, 2, 2],
    52 / 27,
    lambda x: 2 - x[0] * x[1] * x[2],
    lambda x: [x[0] + 2 * x[1] + 2 * x[2], 2 - x[0] - 2 * x[1] - 2 * x[2]],
    low=0.0,
    high=1.0,
    remark="another stationary point at 2",
)
add(
    43,
    [0, 0, 0, 0],
    -44.0,
    lambda x: x[0] ** 2 + x[1] ** 2 + 2 * x[2] ** 2 + x[3] ** 2 - 5 * x[0] - 5 * x[1] - 21 * x[2] + 7 * x[3],
    lambda x: [
        8 - x[0] ** 2 - x[1] ** 2 - x[2] ** 2 - x[3] ** 2 - x[0] + x[1] - x[2] + x[3],
        10 - x[0] ** 2 - 2 * x[1] ** 2 - x[2] ** 2 - 2 * x[3] ** 2 + x[0] + x[3],
        5 - 2 * x[0] ** 2 - x[1] ** 2 - x[2] ** 2 - 2 * x[0] + x[1] + x[3],
    ],
)
add(
    44,
    [0, 0, 0, 0],
    -15.0,
    lambda x: x[0] - x[1] - x[2] - x[0] * x[2] + x[0] * x[3] + x[1] * x[2] - x[1] * x[3],
    lambda x: [
        8 - x[0] - 2 * x[1],
        12 - 4 * x[0] - x[1],
        12 - 3 * x[0] - 4 * x[1],
        8 - 2 * x[2] - x[3],
        8 - x[2] - 2 * x[3],
        5 - x[2] - x[3],
    ],
    low=0.0,
    remark="another local optimum at -13",
)
add(
    45,
    [2] * 5,
    1.0,
    lambda x: 2 - math.prod(x) / 120,
    low=0.0,
    high=[1, 2, 3, 4, 5],
    remark="stationary at 2",
)
