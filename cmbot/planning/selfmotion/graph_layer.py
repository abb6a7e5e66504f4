"""The postures of a chart as nodes of a search: whether they are admissible is found out when it is asked."""

from __future__ import annotations

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray
from cmbot.planning.selfmotion.charts import Chart

__all__ = ["GraphLayer"]


class GraphLayer:
    """The postures of one chart; whether they are admissible is found out when it is asked."""

    def __init__(self, chart: Chart, clearances: Clearances, margin: float) -> None:
        self.chart = chart
        self.admissible = chart.within & (chart.joint_use <= 1.0)
        self._clearances = clearances
        self._margin = margin
        self._looked = ~self.admissible
        self.too_near = np.zeros(len(chart.q), dtype=np.bool_)

    def look(self, which: BoolArray) -> bool:
        """Find out the clearance of the nodes `which` (M,); return whether any turned out inadmissible."""
        new = np.flatnonzero(which & ~self._looked)
        if len(new) == 0:
            return False
        near = self._clearances.check_collision(self.chart.q[new], self._margin)
        self._looked[new] = True
        self.too_near[new] = near
        self.admissible[new] = ~near
        return bool(near.any())

    def look_at(self, node: int) -> bool:
        """Find out the clearance of one node; return whether it turned out inadmissible."""
        return self.look(np.arange(len(self.admissible)) == node)

    def least(self) -> float:
        """Smallest value of any admissible node; infinite when there is none."""
        best = self.best()
        return float(self.chart.value[best]) if best >= 0 else float("inf")

    def best(self) -> int:
        """Return the index of the admissible node with the smallest value; -1 when there is none."""
        while True:
            value = np.where(self.admissible, self.chart.value, np.inf)
            best = int(value.argmin()) if len(value) else 0
            if not len(value) or not np.isfinite(value[best]):
                return -1
            if self._looked[best]:
                return best
            self.look_at(best)
