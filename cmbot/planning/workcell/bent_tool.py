"""The tool of the bent arm near a motion: its sag is known there, and beside it to first order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.robot import Postures, ToolBatch


@dataclass(frozen=True, kw_only=True, eq=False)
class BentToolBatch(ToolBatch):
    """A `ToolBatch` whose point is the bent arm's.

    Attributes
    ----------
    sag : (N, 3), m
        Displacement of the tool point from where the rigid arm has it.
    d_sag : (N, 3, n), m/rad
        Its derivative by the joints.
    """

    sag: FloatArray
    d_sag: FloatArray

    @cached_property
    def leading_jacobian(self) -> FloatArray:
        """The Jacobian of the bent tool's point, and of the rigid arm's orientation: (6, n, N)."""
        rigid = self.rigid.leading_jacobian.copy()
        rigid[:3] += self.d_sag.transpose(1, 2, 0)
        return rigid

    @cached_property
    def rigid(self) -> ToolBatch:
        """The tool of the rigid arm."""
        own = {name: getattr(self, name) for name in ("q", "tool_rotation", "axis", "origin", "arm", "part")}
        return ToolBatch(**own, tool_point=self.tool_point - self.sag)


@dataclass(frozen=True, kw_only=True, eq=False)
class BentTool:
    """Where the bent arm's tool is along motions near one at `times` (N,), s.

    Attributes
    ----------
    postures : Postures
    times : (N,), s
    q : (N, n)
        That motion.
    sag : (N, 3), m
        Of the tool in its postures.
    slope : (N, 3, n), m/rad
        Its derivative by the joints.
    """

    postures: Postures
    times: FloatArray
    q: FloatArray
    sag: FloatArray
    slope: FloatArray

    @cached_property
    def _spline(self) -> Callable[[FloatArray], FloatArray]:
        """From times (N,) to the slope (N, 3, n) and the sag at joints of zero (N, 3), as (N, 3, n + 1)."""
        # Imported where needed: it takes a while to load, and plans of rigid arms do not need it.
        from scipy.interpolate import CubicSpline

        at_zero = self.sag - np.einsum("kij,kj->ki", self.slope, self.q)
        values = np.concatenate([self.slope, at_zero[:, :, None]], axis=2)
        spline: Callable[[FloatArray], FloatArray] = CubicSpline(self.times, values)
        return spline

    def at(self, t: FloatArray, q: FloatArray) -> BentToolBatch:
        """Return the tool at times `t` (N,), s, in postures `q` (N, n)."""
        tool, linear = self.postures.tool_at(q), self._spline(t)
        slope = linear[:, :, :-1]
        sag = linear[:, :, -1] + np.einsum("kij,kj->ki", slope, q)
        own = vars(tool) | {"tool_point": tool.tool_point + sag}
        return BentToolBatch(**own, sag=sag, d_sag=slope)
