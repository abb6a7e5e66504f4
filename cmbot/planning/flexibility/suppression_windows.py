"""Windows of a few legs each, in which vibration suppression changes splines independently."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy import linalg, sparse

from cmbot.common.arrays import FloatArray
from cmbot.optimization import LeastChange, least_distance
from cmbot.planning.flexibility.leg_vibration import LegVibration
from cmbot.planning.torque.problem import TorqueProblem
from cmbot.trajectory import SUPPORT, QuinticTrajectory, SplineSpace

__all__ = ["Leg", "QuietWindow", "legs_by_window"]

# Legs share a window up to so many segments, and as long as it has fewer than so many.
_MOST, _FEWEST = 64, 12
# By how much times may miss their knots, s.
_SAME_TIME = 1e-9

Leg = tuple[int, int]
"""First and last knot of a leg."""


def legs_by_window(space: SplineSpace, leg_times: FloatArray) -> list[list[Leg]]:
    """Divide legs among windows.

    Parameters
    ----------
    space : SplineSpace
    leg_times : (m + 1,), s
        Where legs start and end, all of them knots.

    Returns
    -------
    list of list of Leg
        One list a window; a path of no more than 64 segments is one window.
    """
    windows: list[list[Leg]] = []
    for leg in pairwise(int(k) for k in np.searchsorted(space.t, np.asarray(leg_times) - _SAME_TIME)):
        if windows and _joins(windows[-1][0][0], *leg):
            windows[-1].append(leg)
        else:
            windows.append([leg])
    if len(windows) > 1 and windows[-1][-1][1] - windows[-1][0][0] < _FEWEST:
        windows[-2:] = [windows[-2] + windows[-1]]
    return windows


def _joins(start: int, first: int, last: int) -> bool:
    """Whether a leg belongs to the window that starts at the knot `start`."""
    return last - start <= _MOST or first - start < _FEWEST


class QuietWindow:
    """The basis splines that live on some legs alone, and what they are to do to the vibration at their ends.

    Of a long leg they are those near its end: their number is bounded, however long the path is.

    Parameters
    ----------
    problem : TorqueProblem
    legs : list of Leg
        Neighbours.

    Attributes
    ----------
    numbers : (s,)
        Which of the basis splines.
    start : float, s
        Of the first leg.
    """

    def __init__(self, problem: TorqueProblem, legs: list[Leg]) -> None:
        space = problem.space
        self._space, self._jerk = space, problem.context.robot.limits.jerk
        self.start = float(space.t[legs[0][0]])
        near = [np.arange(max(first, last - _MOST), last) for first, last in legs]
        numbers = np.concatenate(near)
        self.numbers = numbers[numbers <= legs[-1][1] - SUPPORT]
        self._basis = space.basis[:, self.numbers]
        # With y = L' X / jerk bound the mean squared jerk, in units of its bounds, is |y|^2.
        gram = space.jerk_gram[self.numbers][:, self.numbers].toarray()
        self._factor = np.linalg.cholesky(gram) if len(self.numbers) else gram
        self._conditions: list[FloatArray] = []
        self._vibration: list[FloatArray] = []

    def bring_to_rest(self, leg: LegVibration, trajectory: QuinticTrajectory) -> None:
        """Take the vibration away that `trajectory` leaves at the end of one of the legs."""
        snap = (self._space.design(leg.times, 4) @ self._basis).T
        self._conditions += [snap @ leg.weights[:, c] for c in range(leg.weights.shape[1])]
        self._vibration.append(leg.vibration(trajectory))

    def change(self, rows: sparse.csr_array, room: FloatArray) -> LeastChange | None:
        """Change the splines with the least jerk; None where no change keeps to the room.

        Parameters
        ----------
        rows : (K, (n - 4) d)
            Derivatives of what is bounded by the numbers of all splines, the joints of each in turn.
        room : (K,)
            By how much these may grow.

        Returns
        -------
        LeastChange or None
            Whose x is X (s, d).
        """
        s, d = len(self.numbers), len(self._jerk)
        if s == 0:
            return None
        own = rows[:, (self.numbers[:, None] * d + np.arange(d)).ravel()].toarray()
        E = self._whitened(np.stack(self._conditions))
        found = least_distance(
            E, -np.concatenate(self._vibration), self._whitened(own.reshape(-1, s, d)), room
        )
        if found is None:
            return None
        X = linalg.solve_triangular(self._factor, found.x.reshape(s, d), lower=True, trans="T") * self._jerk
        return LeastChange(X, found.share)

    def _whitened(self, rows: FloatArray) -> FloatArray:
        """Derivatives (K, s d) by y from those (K, s, d) by X."""
        k, s, d = rows.shape
        by_number = rows.transpose(1, 0, 2).reshape(s, k * d)
        y = linalg.solve_triangular(self._factor, by_number, lower=True).reshape(s, k, d) * self._jerk
        return np.asarray(y.transpose(1, 0, 2).reshape(k, s * d))
