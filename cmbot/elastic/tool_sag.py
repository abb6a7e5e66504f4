"""How far the tool is expected to sag: from the elastic model, at postures and along motions."""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.sag import Sag

__all__ = ["ToolSag"]

# Along a smooth motion the sag is worked out this often at most, s, and interpolated in between.
_EVERY = 0.02
# A norm has no derivative at zero; below this, m, it is taken as flat.
_FLAT = 1e-12


class ToolSag:
    """Predicted displacement of the tool point by weight: guardrail and links bend.

    Parameters
    ----------
    sag : Sag
    """

    def __init__(self, sag: Sag) -> None:
        self._sag = sag

    def at(self, q: FloatArray) -> FloatArray:
        """Return the displacements (N, 3), m, in W, at rest in postures `q` (N, n)."""
        return self._sag.at(q).tool

    def along(self, t: FloatArray, q: FloatArray) -> FloatArray:
        """Return the displacements (N, 3), m, along a smooth motion through `q` (N, n) at times `t` (N,)."""
        every = max(1, int(_EVERY / max(float(np.diff(t).max(initial=0.0)), 1e-9)))
        some = np.unique(np.append(np.arange(0, len(t), every), len(t) - 1))
        if every == 1 or len(some) < 4:
            return self.at(q)
        # Only where sag is compensated: it takes a while to come.
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(t[some], self.at(q[some]))(t))

    def length(self, q: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Return the lengths (N,), m, in postures `q` (N, n), and their gradients (N, n), m/rad."""
        at = self._sag.at(q)
        length = np.linalg.norm(at.tool, axis=1)
        unit = at.tool / np.maximum(length, _FLAT)[:, None]
        return np.asarray(length), np.einsum("ki,kij->kj", unit, at.d_tool)
