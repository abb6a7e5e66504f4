"""Whether places of a path have postures: within the joint ranges, and on request clear and strong enough.

Inverse kinematics at many places at once: the squared task error is minimised over the joint ranges by
Levenberg and Marquardt's method with Sugihara's damping, projected onto the ranges, from a few postures at
each place and from more and more where these do not suffice (T. Sugihara, Solvability-unconcerned inverse
kinematics by the Levenberg-Marquardt method, IEEE T-RO 27(5), 2011; D. P. Bertsekas, Projected Newton
methods, 1982). Where none will do, the best one tells by how much the place is missed. That is no proof.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.planning.postures.projection import gram, solve_batch, task_jacobian
from cmbot.planning.task import ToolTask
from cmbot.robot import Postures, Robot
from cmbot.toolpath import ToolPoses

# Random postures at each place in the first rounds, and in the last one at the worst place.
_POSTURES_OF_ROUNDS, _LAST = (2, 30), 1000
# Steps from each posture, and more of them from the nearest one of the worst place.
_STEPS_PER_POSTURE, _MORE_STEPS = 40, 300
# There a posture that holds the tool is improved by copies of it, scattered less and less, rad.
_COPIES, _SCATTER = 64, (0.5, 0.3, 0.2, 0.15, 0.1, 0.07, 0.05, 0.03, 0.02, 0.01)
# Largest error of a posture that holds the tool, m, or rad: planning makes it smaller by Newton's method.
_HELD_TOLERANCE = 1e-6
# Least damping, and the longest step of a joint, rad.
_DAMPING, _MAX_JOINT_STEP_RAD = 1e-8, 0.8
# Violation of a posture that does not hold the tool.
_UNHELD_VIOLATION = 1e9

Violation = Callable[[FloatArray], FloatArray]
"""By how much postures (N, n) that hold the tool break what they have to keep, (N,); 0: not at all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MissedPlace:
    """A place for which no posture was found.

    Attributes
    ----------
    place : int
        Its number among all.
    found : (N,)
        For which of all places there is one.
    attempts : int
        Postures from which one was sought there.
    best : (n,), rad and m
        That in which least is missing.
    is_held : bool
        Whether it holds the tool.
    distance, angle : float
        Otherwise how far the tool is off its place, m, and off its orientation, rad.
    joint : str
        One that is at an end of its range then; empty where none is.
    """

    place: int
    found: BoolArray
    attempts: int
    best: FloatArray
    is_held: bool
    distance: float
    angle: float
    joint: str

    def off(self, kept: str) -> str:
        """Return how far the nearest posture has the tool off its place, where `kept` of it is kept."""
        off = f"{1e3 * self.distance:.3g} mm"
        if kept != "position":
            off += f" and {np.degrees(self.angle):.2g} deg"
        return f"the nearest is {off} off{f' ({self.joint} at an end)' if self.joint else ''}"


def worst_missed(
    robot: Robot, task: ToolTask, goals: ToolPoses, known: FloatArray, violation: Violation | None = None
) -> MissedPlace | None:
    """Return the place of `goals` (N,), in the order of a path, for which a posture is furthest from found.

    None where one is found for each. `known` (n,), rad and m, is a posture to begin with.
    """
    search = _Search(robot, task, goals, known, violation)
    # Mostly that is all.
    search.begin()
    for number in _POSTURES_OF_ROUNDS:
        if search.found.all():
            return None
        search.attempt(np.flatnonzero(~search.found), number)
    while not search.found.all():
        place = int(search.lack.argmax())
        search.attempt(np.array([place]), _LAST)
        search.improve(place)
        if not search.found[place]:
            return search.missed(place)
    return None


class _Search:
    """The best postures for the places of a path."""

    def __init__(
        self, robot: Robot, task: ToolTask, goals: ToolPoses, known: FloatArray, violation: Violation | None
    ) -> None:
        self._robot, self._task, self._violation = robot, task, violation
        number = len(goals.point)
        rotation = np.broadcast_to(goals.rotation, (number, 3, 3))
        self._goals = ToolPoses(point=goals.point, rotation=rotation)
        self._postures, self._rng = Postures(robot), np.random.default_rng(0)
        self._attempts = np.zeros(number, dtype=np.intp)
        # What is lacking in the best posture for each place: first what the tool misses, then the violation.
        self._q, self._miss = np.tile(known, (number, 1)), np.full(number, np.inf)
        self._broken = np.full(number, _UNHELD_VIOLATION)

    @property
    def found(self) -> BoolArray:
        """For which places there is a posture."""
        return np.asarray((self._miss < _HELD_TOLERANCE) & (self._broken <= 0.0))

    @property
    def lack(self) -> FloatArray:
        """How far each place is from one, (N,): those at which the tool is not held furthest."""
        held = self._miss < _HELD_TOLERANCE
        return np.where(held, self._broken / (1.0 + self._broken), 1.0 + self._miss)

    def begin(self) -> None:
        """Start at each place from the known posture."""
        self._seek(np.arange(len(self._q)), self._q.copy())

    def attempt(self, places: IntArray, number: int) -> None:
        """Start at places (k,) from so many random postures, then from those of places beside them."""
        self._seek(np.repeat(places, number), self._robot.limits.drawn(self._rng, number * len(places)))
        while True:
            found = self.found
            for way in (1, -1):
                beside = np.flatnonzero(~found)
                beside = beside[(beside - way >= 0) & (beside - way < len(found))]
                beside = beside[found[beside - way]]
                self._seek(beside, self._q[beside - way])
            if self.found.sum() == found.sum():
                return

    def improve(self, place: int) -> None:
        """Improve the best posture for a place: nearer to its goal, or with less violation."""
        self._seek(np.full(1, place), self._q[place][None], _MORE_STEPS)
        metric = self._postures.metric
        for scatter in _SCATTER if self._miss[place] < _HELD_TOLERANCE else ():
            moves = self._rng.normal(0.0, scatter, (_COPIES, self._q.shape[1]))
            self._seek(np.full(_COPIES, place), self._q[place] + metric.positions(moves))

    def _seek(self, places: IntArray, q: FloatArray, steps: int = _STEPS_PER_POSTURE) -> None:
        """Minimise the task error at places (k,) from postures `q` (k, n)."""
        if not len(places):
            return
        self._attempts += np.bincount(places, minlength=len(self._attempts))
        q, miss = _nearest_postures(self._robot, self._postures, self._task, q, self._goals[places], steps)
        held, broken = miss < _HELD_TOLERANCE, np.full(len(q), _UNHELD_VIOLATION)
        if held.any():
            broken[held] = 0.0 if self._violation is None else self._violation(q[held])
        miss = np.where(held, 0.0, miss)
        order = np.lexsort((broken, miss, places))
        k = order[np.unique(places[order], return_index=True)[1]]
        at = places[k]
        k = k[(miss[k] < self._miss[at]) | ((miss[k] == self._miss[at]) & (broken[k] < self._broken[at]))]
        self._q[places[k]], self._miss[places[k]], self._broken[places[k]] = q[k], miss[k], broken[k]

    def missed(self, place: int) -> MissedPlace:
        """What is known of a place for which no posture was found."""
        q, goal, limits = self._q[place], self._goals[place], self._robot.limits
        at = self._postures.tool_at(q[None])
        at_end = np.minimum(q - limits.lower, limits.upper - q) < _HELD_TOLERANCE
        beyond = float(self._task.rotation(at.tool_rotation, goal)[0]) - (self._task.cone or 0.0)
        return MissedPlace(
            place=place,
            found=self.found,
            attempts=int(self._attempts[place]),
            best=q,
            is_held=bool(self._miss[place] < _HELD_TOLERANCE),
            distance=float(np.linalg.norm(goal.point - at.tool_point)),
            angle=max(beyond, 0.0),
            joint=self._robot.joints[int(at_end.argmax())] if at_end.any() else "",
        )


def _nearest_postures(
    robot: Robot,
    postures: Postures,
    task: ToolTask,
    q: FloatArray,
    goals: ToolPoses,
    steps: int = _STEPS_PER_POSTURE,
) -> tuple[FloatArray, FloatArray]:
    """Minimise by how much the tool misses its goals, within the joint ranges, from postures `q` (N, n).

    Returns the postures, and by how much they miss, (N,), m: a radian counts as a metre.
    """
    metric, limits = postures.metric, robot.limits
    lower, upper = (metric.coordinates(each)[:, None] for each in (limits.lower, limits.upper))
    x = np.clip(metric.coordinates(q).T, lower, upper)
    miss, best = np.full(len(q), np.inf), x.copy()
    active = np.arange(len(q))
    for _ in range(steps):
        at = postures.tool_at(metric.positions(x[:, active].T))
        error = _error(task, at.tool_point, at.tool_rotation, goals[active]).T
        size = np.sqrt((error * error).sum(axis=0))
        better = size < miss[active]
        best[:, active[better]] = x[:, active[better]]
        miss[active[better]] = size[better]
        going = size >= _HELD_TOLERANCE
        active, error, size = active[going], error[:, going], size[going]
        if not len(active):
            break
        J = task_jacobian(task.on_axis, at, metric)[:, :, going]
        if task.cone is not None:
            J[3:] *= (error[3:] != 0).any(axis=0)
        now = x[:, active]
        slope = np.einsum("ikn,in->kn", J, error)
        stuck = ((now <= lower) & (slope < 0)) | ((now >= upper) & (slope > 0))
        J *= ~stuck
        G = gram(J)
        G[np.diag_indices(len(G))] += 0.5 * size**2 + _DAMPING
        step = np.einsum("ikn,in->kn", J, solve_batch(G, error[:, None])[:, 0])
        step *= np.minimum(1.0, _MAX_JOINT_STEP_RAD / np.maximum(np.abs(step).max(axis=0), 1e-30))
        x[:, active] = np.clip(now + step, lower, upper)
    return np.ascontiguousarray(metric.positions(best.T)), miss


def _error(task: ToolTask, p_WT: FloatArray, R_WT: FloatArray, goals: ToolPoses) -> FloatArray:
    """Task coordinates (N, m) to goals (N,), a radian as a metre; of a cone what is beyond it."""
    error = task.on_axis.errors(p_WT, R_WT, goals)
    if task.cone is not None:
        angle = np.linalg.norm(error[:, 3:], axis=1)
        error[:, 3:] *= np.maximum(1 - task.cone / np.maximum(angle, task.cone), 0.0)[:, None]
    return error
