"""Random min-max programs as large as the paper's torque problem: 46 blocks of 7 unknowns, in a band."""

from __future__ import annotations

from typing import Any

import numpy as np
from measure import required

from programs.hock_schittkowski import Problem
from programs.nonlinear import Nonlinear

__all__ = ["random_program"]

# As 50 via-points of seven joints: what is compared with the peak, on five times of every segment, is the
# norm of three numbers that depend on the unknowns of four blocks.
_BLOCKS, _JOINTS, _TOUCHED, _TIMES = 46, 7, 4, 5
_SMOOTHING, _WAVES, _ROUND = 0.05, 0.2, 0.01


def random_program(seed: int, blocks: int = _BLOCKS) -> Nonlinear:
    """Return the program of a seed.

    It minimises the largest norm and a small multiple of the squares, with as many quadratic constraints, and
    no unknown above 1.
    """
    ca, rng = required("casadi"), np.random.default_rng(seed)
    n, width = blocks * _JOINTS, _TOUCHED * _JOINTS
    sites = []
    for segment in range(blocks + 3):
        first = max(segment - _TOUCHED + 1, 0) * _JOINTS
        last = min(segment + 1, blocks) * _JOINTS
        for _ in range(_TIMES):
            B, waves = rng.normal(size=(2, 3, last - first)) / np.sqrt(width)
            sites.append((slice(first, last), rng.normal(size=3), B, waves, rng.normal(size=last - first)))

    def norms(x: list[Any]) -> list[Any]:
        found = []
        for here, d, B, waves, _ in sites:
            part = ca.vertcat(*x[here])
            value = d + ca.mtimes(ca.DM(B), part) + _WAVES * ca.sin(ca.mtimes(ca.DM(waves), part))
            found.append(ca.sqrt(ca.dot(value, value) + _ROUND))
        return found

    def rooms(x: list[Any]) -> list[Any]:
        return [1 - ca.dot(ca.DM(w), ca.vertcat(*x[here])) ** 2 for here, _, _, _, w in sites]

    problem = Problem(
        number=seed,
        start=(0.0,) * n,
        objective=lambda x: 0.5 * _SMOOTHING * sum(each**2 for each in x),
        constraints=rooms,
        low=(-1.0,) * n,
        high=(1.0,) * n,
        optimum=float("nan"),
        name=f"random {seed}",
    )
    return Nonlinear(problem, norms, np.arange(1, blocks + 1) * _JOINTS)
