"""When a plate slips, by a linear program: what the package's formula of holding is compared with.

The pressure is linear over the contact and nowhere a tension: where the load asks for one a gap opens. It
balances the normal force and both tipping moments. Friction is one force a cell, within a cone of 32 sides
around the circle of friction times pressure, so that no cone is smaller than the circle. The cells are those
of Gauss-Lobatto quadrature, whose outermost points lie on the edges, over the box of what is pressed. Nothing
here is shared with the package.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linprog

FloatArray = NDArray[np.float64]

POINTS, SIDES = 15, 32
"""Cells along each side, and sides of the cones."""
# Steps at most: Newton's for the pressure, and of the search for the adhesion; where that ends, as a share,
# and the factor by which it goes down at first; boxes of cells at most.
_STEPS, _CLOSE, _DOWN, _BOXES = 100, 1e-3, 1.04, 8


class Plate:
    """A rectangular plate with sides along and across, m, its friction, and cells along each side."""

    def __init__(self, along: float, across: float, friction: float, points: int = POINTS) -> None:
        self.half = np.array([along, across]) / 2
        # Nodes of Gauss-Lobatto: the ends, and the roots of the derivative of Legendre's polynomial.
        legendre = np.polynomial.legendre.Legendre.basis(points - 1)
        nodes = np.concatenate([[-1.0], np.sort(legendre.deriv().roots().real), [1.0]])
        weights = 1 / (points * (points - 1)) / legendre(nodes) ** 2
        self._nodes = np.array(np.meshgrid(nodes, nodes, indexing="ij")).reshape(2, -1).T
        self.weights = 4 * np.outer(weights, weights).ravel()
        angle = 2 * np.pi * np.arange(SIDES) / SIDES
        corner = friction / np.cos(np.pi / SIDES)
        self._cone = corner * np.array([np.cos(angle), np.sin(angle)])
        self._cells = sparse.kron(sparse.eye(points**2), np.ones((1, SIDES)), format="csr")

    def pressure(self, centre: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return points (K, 2) and the shares (K,) of the normal force on them; None where the plate tilts.

        Its resultant is at `centre` (2,), all in half sides.
        """
        if np.abs(centre).max() >= 1:
            return None
        low, high = -np.ones(2), np.ones(2)
        for _ in range(_BOXES):
            points = 0.5 * (low + high) + 0.5 * (high - low) * self._nodes
            c = self._balanced(points, centre)
            pressed = _pressed_corners(c)
            smaller = np.clip(pressed.min(axis=0), low, high), np.clip(pressed.max(axis=0), low, high)
            if (smaller[1] - smaller[0] > 0.9 * (high - low)).all():
                break
            # The cells at hand may not see all that is pressed.
            low, high = (0.9 * new + 0.1 * old for new, old in zip(smaller, (low, high), strict=True))
        share = self.weights * np.maximum(c[0] + points @ c[1:], 0.0)
        return points, share / share.sum()

    def _balanced(self, points: FloatArray, centre: FloatArray) -> FloatArray:
        """The linear pressure (3,) without tension, one in all, about `centre`, by sums over points."""
        middle, half = points.mean(axis=0), np.ptp(points, axis=0) / 2
        X = np.column_stack([np.ones(len(points)), (points - middle) / half])
        goal = np.array([1.0, *((centre - middle) / half)])
        c = np.linalg.solve(X.T @ (self.weights[:, None] * X), goal)

        def energy(c: FloatArray) -> float:
            return float(0.5 * self.weights @ np.maximum(X @ c, 0.0) ** 2 - goal @ c)

        # The pressure minimises a convex function: Newton's steps, halved until they lower it.
        for _ in range(_STEPS):
            pressure = X @ c
            on = np.where(pressure > 0, self.weights, 0.0)
            lack = X.T @ (on * pressure) - goal
            if np.abs(lack).max() < 1e-9:
                break
            step = np.linalg.solve(X.T @ (on[:, None] * X) + 1e-12 * np.eye(3), lack)
            share = 1.0
            while energy(c - share * step) > energy(c) - 1e-4 * share * (lack @ step) and share > 1e-9:
                share *= 0.5
            c = c - share * step
        slope = c[1:] / half
        return np.array([c[0] - slope @ middle, *slope])

    def factor(self, load: FloatArray, pressed: float) -> float:
        """Return by how much friction and torsion of a load may grow until the plate slips.

        It is pressed by `pressed`, N; zero where it tilts.
        """
        found = self.pressure(np.array([load[4], -load[3]]) / pressed / self.half)
        if found is None:
            return 0.0
        points, pressure = found
        u, w = (np.kron(np.ones(len(points)), part) for part in self._cone)
        x, y = (np.repeat(part, SIDES) for part in (points * self.half).T)
        rows = np.array([u, w, x * w - y * u])
        goal, scale = load[[0, 1, 5]], np.array([1.0, 1.0, 1 / self.half.max()])
        columns = np.column_stack([rows, -goal / pressed]) * scale[:, None]
        cells = sparse.hstack([self._cells, sparse.csr_array((len(pressure), 1))])
        cost = np.zeros(columns.shape[1])
        cost[-1] = -1.0
        found = linprog(cost, A_ub=cells, b_ub=pressure, A_eq=columns, b_eq=np.zeros(3), method="highs")
        if found.status == 3:
            return np.inf
        if not found.success:
            raise RuntimeError(found.message)
        return float(found.x[-1])

    def needed(self, load: FloatArray, guess: float) -> float:
        """The adhesion, N, from which on a load (6,), as `Foot.from_wrench` has it, is held.

        With less it slips or tilts. With much less it may hold again, as the centre of pressure moves: so the
        search goes downwards, from a guess that is likely to be enough.
        """
        tilts = float((np.abs([load[4], load[3]]) / self.half).max())
        low = max(tilts, 1e-9) * (1 + _CLOSE)
        high = max(guess - load[2], low)
        while (at_high := self.factor(load, high) - 1) < 0:
            high *= 1 + 5 * _CLOSE
        while high > low:
            below = max(low, high / _DOWN)
            at_low = self.factor(load, below) - 1
            if at_low < 0:
                return self._root(load, below, at_low, high, at_high) + float(load[2])
            high, at_high = below, at_low
        return tilts + float(load[2])

    def _root(self, load: FloatArray, low: float, at_low: float, high: float, at_high: float) -> float:
        """The force, N, between one that is too little and one that is enough."""
        # Regula falsi; an end that stays counts half (Illinois), and both ends come nearer.
        for _ in range(_STEPS):
            if high - low <= _CLOSE * high:
                break
            share = -at_low / (at_high - at_low) if np.isfinite(at_high) else 0.5
            pressed = low + min(max(share, 0.1 * _CLOSE), 1 - 0.1 * _CLOSE) * (high - low)
            value = self.factor(load, pressed) - 1
            if value >= 0:
                high, at_high, at_low = pressed, value, 0.5 * at_low
            else:
                low, at_low, at_high = pressed, value, 0.5 * at_high
        return low


def _pressed_corners(pressure: FloatArray) -> FloatArray:
    """The corners (k, 2) of the part of the square of half sides 1 in which a linear pressure is positive."""
    corners = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    value = pressure[0] + corners @ pressure[1:]
    after, next_ = np.roll(value, -1), np.roll(corners, -1, axis=0)
    crosses = (value > 0) != (after > 0)
    share = value[crosses] / (value - after)[crosses]
    return np.vstack([corners[value > 0], corners[crosses] + share[:, None] * (next_ - corners)[crosses]])
