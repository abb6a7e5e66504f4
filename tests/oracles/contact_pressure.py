"""When a plate slips: linear pressure without tension, and sliding about any centre.

The pressure on a rectangular contact is linear over it, zero where that would be tension, and balances the
normal force and both tipping moments. The plate slips when for some rigid sliding motion the load does more
work than friction takes (Goyal, Ruina and Papadopoulos 1991). Sums over a grid of points.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_POINTS = 14
_RADII = np.array([0.0, *np.geomspace(0.02, 40.0, 26)])
_DIRECTIONS = 32


class PressedPlate:
    """A plate with half sides `along`, `across` (m) and friction `friction`."""

    def __init__(self, along: float, across: float, friction: float) -> None:
        self.half, self.friction = (along, across), friction
        share = 2 * (np.arange(_POINTS) + 0.5) / _POINTS - 1
        u, w = (x.ravel() for x in np.meshgrid(along * share, across * share, indexing="ij"))
        self.u, self.w = u, w
        angle = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
        way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        self.velocity = (np.hypot(along, across) * _RADII[:, None, None] * way).reshape(-1, 2)
        # Sliding speeds of the points where the plate turns by 1 rad/s and its centre moves.
        self.speed = np.hypot(self.velocity[:, :1] - w, self.velocity[:, 1:] + u)

    def shares(self, along: float, across: float) -> FloatArray:
        """Share of the normal force on each point, whose resultant is at (along, across), m."""
        X = np.stack([np.ones_like(self.u), self.u / self.half[0], self.w / self.half[1]], axis=1)
        wanted = len(self.u) * np.array([1.0, along / self.half[0], across / self.half[1]])
        c = np.array([1.0, 3 * along / self.half[0], 3 * across / self.half[1]])
        for step in range(60):
            pressure = X @ c
            on = pressure > 0
            change = np.linalg.solve(X[on].T @ X[on] + 1e-9 * np.eye(3), X[on].T @ pressure[on] - wanted)
            # Where points come and go the whole step may lead to and fro.
            c -= change if step < 20 else 0.3 * change
        pressure = np.maximum(X @ c, 0.0)
        return np.asarray(pressure / pressure.sum())

    def slips(self, load: FloatArray, adhesion: float) -> bool:
        """Whether a load (6,), as `Foot.from_wrench` has it, makes a plate with that adhesion slip or tip."""
        pressed = adhesion - load[2]
        # A moment about the member moves the pressure across it; the signs do not matter to slipping alone.
        along, across = -load[4] / pressed, load[3] / pressed
        if pressed <= 0 or max(abs(along) / self.half[0], abs(across) / self.half[1]) >= 0.97:
            return True
        shares = self.shares(along, across)
        turning = 1.0 if load[5] >= 0 else -1.0
        borne = self.friction * pressed * (self.speed @ shares)
        work = turning * self.velocity @ load[:2] + abs(load[5])
        straight = np.hypot(load[0], load[1]) > self.friction * pressed
        return bool(straight or (work > borne).any())

    def needed(self, load: FloatArray, most: float) -> float:
        """The least adhesion with which a load does not make it slip, up to `most`, N."""
        low, high = 0.0, most
        for _ in range(25):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.slips(load, middle) else (low, middle)
        return high
