"""Whether a path exists, by another way than the planner's: layers of postures at dense points of the path.

From a layer, Newton steps lead to the next point; beside them, random steps in the self-motion and random
postures spread out. An edge is a move that keeps the velocity bounds, is in range and clear, and near whose
middle a posture holds the tool on its path. A path that is found is one, apart from accelerations; that none
is found is no proof.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from suite.task import TimedPath, read_scene
from suite.world import FloatArray, World

__all__ = ["Oracle", "find_paths"]

_SPACING = 0.02  # m, of the points along the path for an arm of 1 m
_WIDTHS = (60, 240)  # postures in a layer, in the first attempt and in the second
_RANDOM = 40  # random postures at each point, and ...
_AT_START = 200  # ... at the first
_FLOOD = 400  # steps by which the self-motion at the start is explored
_STEP = 0.3  # rad
_LONG, _OFF_THE_MIDDLE = 0.3, 0.3  # rad, and of it: longer moves are looked at in their middle
_CELL = 0.1  # rad: postures in one cell count as one
_SHARE = 0.95  # of the velocity bounds


@dataclass(frozen=True)
class _Layer:
    """Postures (m, n) at a point, and the number of each one's posture in the layer before."""

    q: FloatArray
    before: list[int]


class Oracle:
    """Searches for a path in one scene."""

    def __init__(self, world: World, path: TimedPath, R: FloatArray, keep: str, seed: int = 0) -> None:
        self.world, self.path, self.R, self.keep = world, path, R, keep
        self.rng = np.random.default_rng(seed)
        self.times = path.dense_times(_SPACING)
        self.points = [path.point(t) for t in self.times]

    def search(self, starts: list[FloatArray], width: int) -> tuple[float, list[FloatArray] | None]:
        """How far, s, a path leads on from any of the `starts`, and its postures if it leads to the end."""
        layers = [_Layer(np.array(starts).reshape(-1, self.world.n), [-1] * len(starts))]
        for k in range(1, len(self.times)):
            layer = self._next(layers[-1].q, k, width)
            if len(layer.q) == 0:
                return float(self.times[k - 1]), None
            layers.append(layer)
        found, which = [], 0
        for layer in reversed(layers):
            found.append(layer.q[which])
            which = layer.before[which]
        return float(self.times[-1]), found[::-1]

    def _next(self, population: FloatArray, k: int, width: int) -> _Layer:
        """Postures at point k that moves from a population at the point before lead to."""
        bound = _SHARE * self.world.velocity * (self.times[k] - self.times[k - 1])
        p, found = self.points[k], dict[tuple[int, ...], tuple[FloatArray, int]]()

        def offer(q: FloatArray | None, parent: int) -> None:
            if q is None or not (np.abs(q - population[parent]) <= bound).all():
                return
            cell = tuple(np.round(q / _CELL).astype(int).tolist())
            if (
                cell not in found
                and self._moves(population[parent], q)
                and self._holds(population[parent], q, k)
            ):
                found[cell] = (q, parent)

        order = self.rng.permutation(len(population))
        for parent in order:
            offer(self.world.solve(population[parent], p, self.R, self.keep), int(parent))
        slides = self.world.n > {"pose": 6, "axis": 5, "position": 3}[self.keep]
        for _ in range(width if slides else 0):
            if len(found) >= width:
                break
            parent = int(self.rng.integers(len(population)))
            step = self.rng.uniform(-1.0, 1.0, self.world.n) * np.minimum(bound, _STEP)
            offer(self.world.slid(population[parent], step, p, self.R, self.keep), parent)
        for q in self.anywhere(p, _RANDOM if slides else 0):
            offer(q, int(np.abs((population - q) / bound).max(axis=1).argmin()))
        chosen = list(found.values())
        if len(chosen) > width:
            chosen = [chosen[i] for i in self.rng.choice(len(chosen), width, replace=False)]
        return _Layer(np.array([q for q, _ in chosen]).reshape(-1, self.world.n), [i for _, i in chosen])

    def _moves(self, q: FloatArray, other: FloatArray) -> bool:
        """Whether the straight move from an admissible posture to another is admissible."""
        return self.world.admissible(other) and self.world.clear(0.5 * (q + other))

    def _holds(self, q: FloatArray, other: FloatArray, k: int) -> bool:
        """Whether a move to point k from the one before keeps the tool on its path, or leaps to a branch."""
        length = float(np.abs(other - q).max())
        if length <= _LONG:
            return True
        middle, p = 0.5 * (q + other), self.path.point(0.5 * (self.times[k - 1] + self.times[k]))
        near = self.world.solve(middle, p, self.R, self.keep)
        return near is not None and float(np.abs(near - middle).max()) <= _OFF_THE_MIDDLE * length

    def anywhere(self, p: FloatArray, tries: int) -> list[FloatArray]:
        """Admissible postures with the tool at a point, from random ones."""
        found = []
        for _ in range(tries):
            q = self.world.solve(self.world.random(self.rng), p, self.R, self.keep)
            q = None if q is None else self.world.wrapped(q)
            if q is not None and self.world.admissible(q):
                found.append(q)
        return found

    def in_range_somewhere(self, p: FloatArray, tries: int) -> FloatArray | None:
        """A posture within the ranges, near obstacles or not, with the tool at a point; None: none found."""
        for _ in range(tries):
            q = self.world.solve(self.world.random(self.rng), p, self.R, self.keep)
            q = None if q is None else self.world.wrapped(q)
            if q is not None:
                return q
        return None

    def flooded(self, q: FloatArray) -> list[FloatArray]:
        """Postures that self-motion leads to from a posture, with itself as the first."""
        p, _ = self.world.pose(q)
        found = [q]
        for _ in range(_FLOOD):
            target = self.world.random(self.rng)
            nearest = min(found, key=lambda x: float(np.abs(x - target).sum()))
            step = target - nearest
            step *= min(1.0, 2 * _STEP / np.abs(step).max())
            other = self.world.slid(nearest, step, p, self.R, self.keep)
            if other is None or np.abs(other - nearest).max() > 3 * _STEP:
                continue
            apart = min(float(np.abs(other - x).max()) for x in found)
            if apart > _CELL and self._moves(nearest, other):
                found.append(other)
        return found

    def least_gravity_torque(
        self, p: FloatArray, seeds: list[FloatArray], tries: int = 200
    ) -> tuple[float, FloatArray | None]:
        """The smallest torque of the weight, Nm, of admissible postures with the tool at a point, and one."""
        placed = [self.world.solve(seed, p, self.R, self.keep) for seed in seeds]
        known = [q for q in placed if q is not None and self.world.admissible(q)] + self.anywhere(p, tries)
        known.sort(key=self.world.gravity_torque)
        best, posture = np.inf, None
        for q in known[:4]:
            value, length = self.world.gravity_torque(q), _STEP
            for _ in range(60):
                other = self.world.slid(q, length * self.rng.normal(size=self.world.n), p, self.R, self.keep)
                lower = other is not None and self.world.gravity_torque(other) < value
                if lower and self.world.admissible(other):
                    q, value = other, self.world.gravity_torque(other)
                else:
                    length *= 0.9
            if value < best:
                best, posture = value, q
        return best, posture


def find_paths(folder: str) -> dict[str, Any]:
    """Whether a path leads on from the scene's posture, from one that self-motion leads to, from any."""
    scene, world, path, R = read_scene(folder)
    oracle, q = Oracle(world, path, R, scene.strokes[0].keep), np.array(scene.posture)
    found: dict[str, Any] = {"points": len(oracle.times), "start_admissible": world.admissible(q)}
    slides = world.n > {"pose": 6, "axis": 5, "position": 3}[scene.strokes[0].keep]
    postures = None
    for kind in ("scene", "connected", "any"):
        if postures is None:
            if kind == "scene":
                starts = [q] if found["start_admissible"] else []
            elif kind == "connected":
                starts = oracle.flooded(q) if slides and starts else starts
            else:
                starts += oracle.anywhere(path.corners[0], _AT_START)
            reached = 0.0
            for width in _WIDTHS:
                if postures is None and starts:
                    time, postures = oracle.search(starts, max(width, len(starts)))
                    reached = max(reached, time)
            found[f"{kind}_until"] = reached
        found[kind] = postures is not None
    # Where all starts fail: whether every point can be reached at all.
    if postures is None:
        missing = [k for k, p in enumerate(oracle.points) if oracle.in_range_somewhere(p, 60) is None]
        found["unreached_at"] = float(oracle.times[missing[0]]) if missing else None
    else:
        found["times"] = oracle.times.tolist()
        found["path_deg"] = np.degrees(postures).round(4).tolist()
    return found
