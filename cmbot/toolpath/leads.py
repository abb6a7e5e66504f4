"""Leads: straight ways on which the tool speeds up before a process and slows down after it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.toolpath.curves import Curve


@dataclass(frozen=True, kw_only=True, eq=False)
class CurveWithLeads(Curve):
    """A curve with straight leads along its tangents, on which the tool turns on as at the curve's ends.

    Attributes
    ----------
    inner : Curve
    before, after : float
        Lengths of the leads, m; 0 where there is none.
    orientation : (3, 3)
        R_WT where the curve begins.
    rotation_vector : (3,), rad
        In W, by which the tool turns along it, in proportion to the share of it that is covered.
    """

    inner: Curve
    before: float
    after: float
    orientation: FloatArray
    rotation_vector: FloatArray

    @property
    def length(self) -> float:
        """Length, m."""
        return self.before + self.inner.length + self.after

    @property
    def curvature(self) -> float:
        """Largest curvature, 1/m: that of the curve."""
        return self.inner.curvature

    @property
    def turns(self) -> bool:
        """Whether the tool turns along the curve."""
        return self.inner.turns or bool(self.rotation_vector.any())

    @cached_property
    def ends(self) -> FloatArray:
        """Shares (2,) at which the curve begins and ends: the speed has no jump there."""
        speeds = np.linalg.norm(self.inner.slope(np.array([0.0, 1.0])), axis=1)
        parts = np.array([self.before / speeds[0], 1.0, self.after / speeds[1]])
        return np.asarray(np.cumsum(parts)[:2] / parts.sum())

    @property
    def breaks(self) -> FloatArray:
        """Shares of the ends of leads, and at which the curve's pieces meet."""
        first, last = self.ends
        inside = first + (last - first) * self.inner.breaks
        ends = [end for end, lead in zip(self.ends, (self.before, self.after), strict=True) if lead]
        return np.unique(np.concatenate([inside, ends]))

    def reversed(self) -> CurveWithLeads:
        """Return the curve from its end to its start."""
        turn = Rotation.from_rotvec(self.rotation_vector).as_matrix()
        return CurveWithLeads(
            inner=self.inner.reversed(),
            before=self.after,
            after=self.before,
            orientation=turn @ self.orientation,
            rotation_vector=-self.rotation_vector,
        )

    def position(self, share: FloatArray) -> FloatArray:
        """Return points (N, 3), m."""
        inside, beyond = self._inside(share)
        return np.asarray(self.inner.position(inside) + beyond[:, None] * self.inner.slope(inside))

    def slope(self, share: FloatArray) -> FloatArray:
        """Return derivatives (N, 3), m."""
        inside, _ = self._inside(share)
        return np.asarray(self.inner.slope(inside) / (self.ends[1] - self.ends[0]))

    def arc_angle(self, share: FloatArray, at: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the angles and radii of the curve's arcs; zero on the leads."""
        angle, radius = self.inner.arc_angle(self._own(share), self._inside(at)[0])
        on = self._on_curve(at)
        return np.where(on, angle, 0.0), np.where(on, radius, 0.0)

    def rotation(self, share: FloatArray) -> FloatArray | None:
        """Return orientations R_WT (N, 3, 3)."""
        if not self.turns:
            return None
        inside, beyond = self._inside(share)
        R = self.inner.rotation(inside)
        if R is None:
            turn = Rotation.from_rotvec(inside[:, None] * self.rotation_vector)
            R = turn.as_matrix() @ self.orientation
        rates = self._rates[np.where(beyond < 0, 0, 1)]
        return np.asarray(Rotation.from_rotvec(beyond[:, None] * rates).as_matrix() @ R)

    def turn(self, share: FloatArray, at: FloatArray) -> FloatArray | None:
        """Return rotation vectors (N, 3), rad; on the leads they are linear in the share."""
        if not self.turns:
            return None
        own = self._own(share)[:, None]
        turn = self.inner.turn(own[:, 0], self._inside(at)[0])
        if turn is None:
            turn = own * self.rotation_vector
        rates = self._rates[np.where(at < self.ends[0], 0, 1)]
        return np.where(self._on_curve(at)[:, None], turn, own * rates)

    def roll(self, at: FloatArray) -> FloatArray:
        """Return the curvature of the cylinder; zero on the leads."""
        return np.where(self._on_curve(at), self.inner.roll(self._inside(at)[0]), 0.0)

    @cached_property
    def _rates(self) -> FloatArray:
        """Derivatives (2, 3) of the rotation vector by the curve's share at its ends, in W."""
        rates = self.inner.rotation_rate(np.array([0.0, 1.0]))
        return np.tile(self.rotation_vector, (2, 1)) if rates is None else rates

    def _own(self, share: FloatArray) -> FloatArray:
        """Shares (N,) of the curve; below 0 and above 1 on the leads."""
        return np.asarray((share - self.ends[0]) / (self.ends[1] - self.ends[0]))

    def _inside(self, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The nearest shares (N,) of the curve, and what is beyond these."""
        own = self._own(share)
        inside = np.clip(own, 0.0, 1.0)
        return inside, own - inside

    def _on_curve(self, at: FloatArray) -> BoolArray:
        return np.asarray((at >= self.ends[0]) & (at <= self.ends[1]))
