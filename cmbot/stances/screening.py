"""Screening: bounds of thousands of stances, from sampled postures at some via-points.

The arm is the same in every stance; only its base is elsewhere. So all postures are found in the base's
frame, in a few large batches: near neighbours of the tool's pose in a table of random postures, put on the
task and moved along the self-motion to where the objective is less; more of them at the via-point of the
largest value, until that has been searched closely. Obstacles are left out, so a stance may be blocked; joint
ranges, joint torques and the feet's bounds count, and the velocities by which the joints lead the tool
through a posture at the path's own speed. The largest, over the via-points, of the smallest value that was
found is an estimate of the stance's lower bound from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.common.workers import Workers
from cmbot.planning import FEET, ToolTask
from cmbot.robot import Robot
from cmbot.scene import STOW, Scene
from cmbot.stances.arm import CLOSELY, FIGURES, ROUGHLY, BaseArm, Effort
from cmbot.stances.bounds import Bounds, StanceObjective
from cmbot.stances.candidates import AnyCandidate
from cmbot.stances.charting import cannot_hold
from cmbot.stances.loads import StanceLoads
from cmbot.stances.placed_scene import put_away
from cmbot.stances.search import Rejection

VIA_POINTS = 6
"""Of a stroke at which all stances are screened."""
# Postures that are tried at once.
_POSTURES_PER_BATCH = 12_000
_SAG, _ADHESION = FIGURES.index("sag_mm"), FIGURES.index("adhesion")
# Stances whose rough bounds are not above that of so many others by this factor are looked at closely.
_PROMISING_STANCES, _PROMISING_RATIO = 20, 1.5
# The share of the time that the rough search takes.
_ROUGH_TIME_SHARE = 0.3


@dataclass(frozen=True, kw_only=True, eq=False)
class Screening:
    """What is known of C candidates for each of S strokes.

    Attributes
    ----------
    within_reach : (S, C)
        Whether the tool's places are within reach of the arm's links.
    figures : (8, S, C)
        `FIGURES` at rest in the posture of each bound, at the via-point where it is largest; the bound is
        infinite where no posture was found, and what was not computed is NaN.
    via_point : (S, C)
        Number of that via-point, of `VIA_POINTS` at equal times.
    """

    within_reach: BoolArray
    figures: FloatArray
    via_point: IntArray

    @property
    def bound(self) -> FloatArray:
        """Bound (S, C) of each, in the unit of what is ranked."""
        return np.asarray(self.figures[0])


class Screener:
    """Screens candidates: what is common to all of them, and to the stages that follow.

    Parameters
    ----------
    scene : Scene
    robot : Robot
        In the scene's stance.
    candidates : sequence of Candidate or MountCandidate
    objective : str
        Of postures and stances.
    bounds : Bounds
    late : callable
        Whether it is to end; what is not looked at then has a bound of zero.
    """

    def __init__(
        self,
        scene: Scene,
        robot: Robot,
        candidates: Sequence[AnyCandidate],
        objective: StanceObjective = "torque",
        bounds: Bounds | None = None,
        late: Callable[[], bool] = lambda: False,
    ) -> None:
        self._late, self._scene = late, scene
        self._robot, self._bases = robot, np.array([candidate.base for candidate in candidates])
        self.arm = BaseArm(scene, robot)
        self.loads = StanceLoads(scene, candidates, robot, self.arm.robot, objective, bounds or Bounds())

    @cached_property
    def away(self) -> FloatArray:
        """`FIGURES` (8, C) at rest in the posture in which the arm is put away."""
        return self.arm.figures(*self._put_away, self.loads)

    @cached_property
    def _put_away(self) -> tuple[FloatArray, IntArray]:
        """The posture in which the arm is put away, for each candidate, and their numbers."""
        every = np.arange(len(self._bases))
        return np.tile(np.array(put_away(self._scene).posture), (len(every), 1)), every

    @property
    def least(self) -> FloatArray:
        """What is ranked (C,) is no less in any job: of ``hold`` what is needed where the arm is put away."""
        return self.away[_ADHESION] if self.loads.objective == "hold" else np.zeros(len(self._bases))

    def sag_mm(self, tasks: Sequence[ToolTask], numbers: Sequence[int]) -> float:
        """Largest sag, mm, over the via-points of the strokes' tasks in the stance that sags least there.

        In the best postures of the candidates of these numbers; NaN where none is found in time.
        """
        number, each = np.array(numbers, dtype=np.intp), list[FloatArray]()
        for task in tasks if len(number) else ():
            if self._late():
                return np.nan
            each += [
                self.arm.least(task, time, self._bases[number], self.loads, number, CLOSELY)[_SAG]
                for time in times_of(task)
            ]
        least = [float(np.nanmin(sag)) for sag in each if np.isfinite(sag).any()]
        return max(least, default=np.nan)

    def unheld(self) -> dict[int, Rejection]:
        """Return by numbers the candidates in which joints or feet cannot hold the arm as it is put away.

        Where nothing is known of the feet that is found later, of those that are promising.
        """
        if not self.loads.bounded:
            return {}
        robot = self.arm.robot
        use, names = self.arm.use(*self._put_away, self.loads), [*robot.joints, FEET]
        name = "stow" if STOW in robot.group_states and self._scene.return_to != "start" else "start"
        weakest = [names[which] for which in use.argmax(axis=1)]
        return {
            k: Rejection.unheld(cannot_hold(weakest[k], name), float(use[k].max()), weakest[k])
            for k in np.flatnonzero(use.max(axis=1) > 1).tolist()
        }

    def least_use(self, tasks: Sequence[ToolTask], numbers: Sequence[int]) -> tuple[float, int]:
        """Return what share of what feet bear the job asks in the best of some candidates, and its number.

        An estimate, with the arm put away and at work, without obstacles; infinite where no posture is found.
        """
        loads, number, least = self.loads.by_use(), np.array(numbers, dtype=np.intp), np.inf
        asked = self.arm.use(*self._put_away, self.loads)[number, -1]
        order = np.argsort(asked, kind="stable")
        for first in range(0, len(number), _PROMISING_STANCES):
            # The job asks no less than to put the arm away: where that is too much, no posture is sought.
            some = order[first : first + _PROMISING_STANCES]
            for task, k in product(tasks, range(VIA_POINTS)):
                if len(some := some[asked[some] < least]):
                    at, time = number[some], times_of(task)[k]
                    use = self.arm.least(task, time, self._bases[at], loads, at, CLOSELY)[0]
                    asked[some] = np.maximum(asked[some], use)
            least = min(least, asked[some].min(initial=np.inf))
        best = int(asked.argmin())
        return float(asked[best]), int(number[best])

    def screened(
        self,
        tasks: Sequence[ToolTask],
        report: Callable[[float], None] = lambda _: None,
        left_out: Sequence[int] = (),
        workers: Workers | None = None,
    ) -> Screening:
        """Screen them for the tasks (S) of strokes, in W; `report` takes the share that is done.

        Of the numbers that are `left_out` no postures are sought. The `workers` do so beside each other.
        """
        workers = workers or Workers(1)
        shape = len(tasks), len(self._bases)
        within = np.array([_within_reach(task, self._bases, self._robot) for task in tasks]).reshape(shape)
        figures, worst = np.full((len(FIGURES), *shape), np.nan), np.zeros(shape, dtype=np.intp)
        figures[0] = np.inf
        kept = np.ones(shape[1], dtype=np.bool_)
        kept[list(left_out)] = False
        for s, task in enumerate(tasks):

            def told(share: float, done: int = s) -> None:
                report((done + share) / len(tasks))

            left = np.flatnonzero(within[s] & kept)
            if len(left):
                figures[:, s, left], worst[s, left] = self._bounded(task, left, told, workers)
        return Screening(within_reach=within, figures=figures, via_point=worst)

    def _bounded(
        self, task: ToolTask, number: IntArray, report: Callable[[float], None], workers: Workers
    ) -> tuple[FloatArray, IntArray]:
        """Figures (8, C) where, over the via-points, what is ranked is largest, and the via-points (C,).

        `number` (C,) are those of the candidates.
        """
        K, C = VIA_POINTS, len(number)
        every = np.arange(C)
        found = np.full((len(FIGURES), K, C), np.nan)
        found[0] = 0.0
        calls = [workers.call(self._least, task, k, number, ROUGHLY) for k in range(K)]
        for k, call in enumerate(calls):
            if self._late():
                break
            rough = call.result()
            found[:, k, : rough.shape[1]] = rough
            report(_ROUGH_TIME_SHARE * (k + 1) / K)
        # Without a posture at half of the via-points it is left at that.
        closely = np.tile(2 * np.isinf(found[0]).sum(axis=0) >= K, (K, 1))
        while True:
            # What is not the largest may be as large as it is: only where most is asked it pays to look
            # closely, and only in a stance that may be among the best, or that has no posture there yet.
            worst = found[0].argmax(axis=0)
            value = found[0, worst, every]
            least = np.sort(value)[:_PROMISING_STANCES][-1]
            open_ = ~closely[worst, every] & ((value <= _PROMISING_RATIO * least) | np.isinf(value))
            if self._late() or not open_.any():
                return found[:, worst, every], worst
            each = [np.flatnonzero(open_ & (worst == k)) for k in range(K)]
            calls = [workers.call(self._least, task, k, number[some], CLOSELY) for k, some in enumerate(each)]
            for k, (some, call) in enumerate(zip(each, calls, strict=True)):
                again = call.result()
                some = some[: again.shape[1]]
                better = again[0] < found[0, k, some]
                found[:, k, some[better]] = again[:, better]
                closely[k, some] = True
            report(_ROUGH_TIME_SHARE + (1 - _ROUGH_TIME_SHARE) * float(1 - open_.mean()))

    def _least(self, task: ToolTask, via_point: int, number: IntArray, effort: Effort) -> FloatArray:
        """Figures of candidates at a via-point, (8, k); of the first ones where it is late."""
        time = float(times_of(task)[via_point])
        at_once = max(_POSTURES_PER_BATCH // (effort.tried * (1 + 2 * effort.walked)), 1)
        parts = [np.empty((len(FIGURES), 0))]
        for first in range(0, len(number), at_once):
            if self._late():
                break
            part = number[first : first + at_once]
            parts.append(self.arm.least(task, time, self._bases[part], self.loads, part, effort))
        return np.concatenate(parts, axis=1)


def _within_reach(task: ToolTask, bases: FloatArray, robot: Robot) -> BoolArray:
    """Which bases (C, 4, 4) have all places of a stroke within reach of the arm's links."""
    points = task.path.position(times_of(task))
    away = np.linalg.norm(points[:, None] - bases[:, :3, 3], axis=2)
    return np.asarray(((away <= robot.reach) & (away >= robot.inner_reach)).all(axis=0))


def times_of(task: ToolTask) -> FloatArray:
    """Return the times of the via-points from the beginning of a stroke to its end, s."""
    return np.linspace(0.0, task.path.duration, VIA_POINTS)
