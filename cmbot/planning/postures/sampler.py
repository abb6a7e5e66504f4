"""Postures that hold the tool, random ones and near ones: within ranges, strong enough and clear."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.workcell import Workcell
from cmbot.toolpath import ToolPoses

# Sides to which the tool leans where nothing is found in the middle of its cone, and by which share of it.
_SIDES, _CONE_SHARE = 6, 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class PostureSampler:
    """Samples postures that hold the tool in a workcell; all methods take and return batches.

    Attributes
    ----------
    cell : Workcell
    task : ToolTask
    steps : int
        Newton steps at most.
    tolerance : float, m or rad
        Largest error of a task coordinate.
    most_use : float
        Largest share of its bound that a joint, or a foot, may use at rest.
    rng : Generator
        Of the random postures; by default they are the same in every run.
    """

    cell: Workcell
    task: ToolTask
    steps: int = 40
    tolerance: float = 1e-10
    most_use: float = 1.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def drawn(self, number: int) -> FloatArray:
        """Return so many random postures (N, n) within the ranges, wherever their tool is."""
        return self.cell.robot.limits.drawn(self.rng, number)

    def held(self, q: FloatArray, goals: ToolPoses) -> tuple[FloatArray, BoolArray]:
        """Return the postures from `q` (N, n) with the axis in the middle of its cone, and which hold it.

        Joints are less than half a turn from the middle of their ranges. Goals are one for each, or one.
        """
        placed, reached = self._projected(self.task.on_axis, q, goals)
        return self.cell.robot.limits.turned_to_middle(placed), reached

    def within_cone(
        self, q: FloatArray, goals: ToolPoses, *, or_middle: bool = False
    ) -> tuple[FloatArray, BoolArray]:
        """Return the postures near `q` (N, n) with the axis anywhere in its cone, and which hold it.

        Where it would be out of it, in the middle of the cone, if that will do.
        """
        placed, reached = self._projected(self.task, q, goals)
        if self.task.cone is not None:
            axes = self.cell.postures.tool_at(placed).tool_rotation
            reached &= self.task.rotation(axes, goals) <= self.task.cone
            beyond = np.flatnonzero(~reached) if or_middle else np.empty(0, dtype=np.intp)
            if len(beyond):
                some = goals if len(goals) == 1 else goals[beyond]
                placed[beyond], reached[beyond] = self._projected(self.task.on_axis, q[beyond], some)
        return placed, reached

    def admissible(self, q: FloatArray) -> FloatArray:
        """Return those of postures (N, n) that are admissible."""
        return np.asarray(q[self.cell.admissible(q, self.most_use)])

    def near(self, q: FloatArray, goals: ToolPoses) -> FloatArray:
        """Return admissible postures (k, n) that hold the tool, from `q` (N, n); see `held`."""
        placed, reached = self.held(q, goals)
        return self.admissible(placed[reached])

    def at_each(self, goals: ToolPoses, number: int, known: FloatArray) -> list[FloatArray]:
        """Return admissible postures (k, n) at each goal, from `known` (n,) and `number` - 1 random ones.

        Where there are none with the axis in the middle of its cone, it leans by most of it to all sides.
        """
        each = [np.empty((0, self.cell.robot.dof))] * len(goals)
        cone = self.task.cone
        for lean in (None, *(() if cone is None else axis_leans(_CONE_SHARE * cone, _SIDES))):
            empty = [k for k, found in enumerate(each) if not len(found)]
            if not empty:
                break
            which = np.repeat(empty, number)
            some = goals[which]
            some = some if lean is None else replace(some, rotation=some.rotation @ lean)
            q = self.drawn(len(which))
            q[::number] = known
            placed, reached = self.held(q, some)
            for k in empty:
                each[k] = self.admissible(placed[reached & (which == k)])
        return each

    def _projected(self, task: ToolTask, q: FloatArray, goals: ToolPoses) -> tuple[FloatArray, BoolArray]:
        postures = self.cell.postures
        return project_onto_task(postures, task, q, goals, steps=self.steps, tolerance=self.tolerance)


def axis_leans(angle: float, number: int) -> list[FloatArray]:
    """Return rotations (3, 3) in the tool's frame that lean its axis by an angle, rad, to so many sides."""
    sides = 2 * np.pi * np.arange(number) / number
    axes = np.stack([np.cos(sides), np.sin(sides), np.zeros(number)], axis=1)
    return list(Rotation.from_rotvec(angle * axes).as_matrix())
