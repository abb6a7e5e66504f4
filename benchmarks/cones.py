"""Plans whose tool may lean in a cone, against a sampled dynamic programme over leaning postures.

    python benchmarks/cones.py --seed 390711 [--count 20] [--first 0] [--draws 2000]

Random scenes of the suite, of the shipped arm, a Panda and a UR10 in turn: one or two legs of 0.1 to 0.4 m, a
cone of 5 to 40 degrees, a payload. Both sides minimise the largest torque at rest on the base over the same
via-points, may start anywhere in the cone, and keep ranges, joint torques and clearances. The programme has
its own inverse kinematics, from random postures with random leaning axes; it uses no charts of the planner.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console
from scipy.spatial.distance import cdist
from suite.arms import ARMS, arm_named
from suite.scenes import make_scene
from threadpoolctl import threadpool_limits

from cmbot import PlanningError, load_scene, plan
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.request import StrokeRequest, build_request

__all__ = ["Programme", "cone_scene"]

_ARMS = ("cmbot", "panda", "ur10")
_HEAVIEST = (4.0, 2.0, 5.0)  # kg
_CONES, _LEGS, _SPEEDS, _VIA_POINTS = (5.0, 40.0), (0.1, 0.4), (0.03, 0.1), 12  # deg, m, m/s
# Within this share of the programme's least a plan is as good.
_SHARE = 0.05
# Newton steps, their damping and the error that counts as none; postures of a via-point that are carried to
# the next; rounds of refinement, postures around each in a round, their first distance, rad, and its factor.
_STEPS, _DAMPING, _EXACT, _CARRIED = 30, 1e-6, 1e-8, 200
_ROUNDS, _AROUND, _FAR, _NEARER = 25, 60, 0.4, 0.85


def cone_scene(seed: int, number: int, folder: str) -> tuple[dict[str, Any], StrokeRequest]:
    """Return the content of a scene, the first whose start bears its payload, and its request."""
    place = ARMS.index(arm_named(_ARMS[number % len(_ARMS)]))
    for again in count():
        data = _changed(seed, place + len(ARMS) * (number + 1000 * again), folder)
        scene = load_scene(Path(folder, "scene.yaml"))
        request = build_request(scene, scene.planner)
        if request.cell.admissible(request.first[None])[0]:
            return data, request
    raise AssertionError


def _changed(seed: int, number: int, folder: str) -> dict[str, Any]:
    """Write a scene of the suite with a cone, other legs and a payload; its content."""
    make_scene(seed, number, folder)
    file, rng = Path(folder, "scene.yaml"), np.random.default_rng([seed, number])
    data: dict[str, Any] = yaml.safe_load(file.read_text(encoding="utf-8"))
    legs = []
    for leg in data["tool_path"]["legs"][:2]:
        length = float(rng.uniform(*_LEGS))
        by = length * np.array(leg["by"]) / np.linalg.norm(leg["by"])
        seconds = max(round(length / float(rng.uniform(*_SPEEDS)), 1), leg["seconds"])
        legs.append({"by": by.round(3).tolist(), "seconds": seconds})
    keep = {"axis_within_deg": round(float(rng.uniform(*_CONES)), 1)}
    data["tool_path"] |= {"legs": legs, "keep": keep, "via_points": _VIA_POINTS}
    heaviest = _HEAVIEST[_ARMS.index(ARMS[number % len(ARMS)].name)]
    data["robot"]["payload_kg"] = round(float(rng.uniform(0.0, heaviest)), 1)
    data["planner"] = {"compensate": False, "time_limit_s": 600.0}
    file.write_text(json.dumps(data), encoding="utf-8")
    return data


@dataclass(frozen=True, eq=False)
class Programme:
    """Dynamic programming over sampled postures of a request at its via-points."""

    request: StrokeRequest
    rng: np.random.Generator
    draws: int

    def least(self) -> float:
        """The least peak at rest that was found, Nm; infinite where no sequence was."""
        each = [self._sampled(k) for k in range(len(self.request.times))]
        last = len(each) - 1
        for ks, beside in ((range(1, last + 1), -1), (range(last - 1, -1, -1), 1)):
            for k in ks:
                some, values = each[k + beside]
                chosen = np.argsort(values)[: _CARRIED // 2]
                if len(some):
                    chosen = np.append(chosen, self.rng.integers(len(some), size=_CARRIED // 2))
                each[k] = _joined(each[k], self._held(k, some[chosen]))
        best, far = self._best(each), _FAR
        for _ in range(_ROUNDS):
            if not best:
                return np.inf
            each = []
            for k, q in enumerate(best):
                near = np.vstack([best[max(k - 1, 0) : k + 2], np.tile(q, (_AROUND, 1))])
                near[-_AROUND:] += (
                    far * self.rng.uniform(size=(_AROUND, 1)) * self.rng.normal(size=(_AROUND, len(q)))
                )
                each.append(_joined(self._held(k, near), (q[None], self._values(q[None]))))
            best, far = self._best(each), far * _NEARER
        return float(self._values(np.array(best)).max())

    def _values(self, q: FloatArray) -> FloatArray:
        return self.request.cell.objective.at_rest(self.request.cell.postures.at(q))

    def _sampled(self, k: int) -> tuple[FloatArray, FloatArray]:
        """Admissible postures at a via-point from random ones, with random axes, and their values."""
        return self._held(k, self.request.cell.robot.limits.drawn(self.rng, self.draws), drawn=True)

    def _held(self, k: int, q: FloatArray, *, drawn: bool = False) -> tuple[FloatArray, FloatArray]:
        """Admissible postures near `q` (N, n) with the tool at via-point `k`, and their values.

        The axis leans as it does in them, or anyhow where they are `drawn`; no further than the cone.
        """
        goal, cone, cell = self.request.goals[k], self.request.task.cone or 0.0, self.request.cell
        middle = goal.rotation[0, :, 2]
        z = cell.postures.tool_at(q).tool_rotation[:, :, 2]
        across = z - (z @ middle)[:, None] * middle
        across /= np.maximum(np.linalg.norm(across, axis=1), 1e-12)[:, None]
        angle = np.minimum(np.arccos(np.clip(z @ middle, -1, 1)), cone * (1 - 1e-9))
        if drawn:
            angle = cone * (1 - 1e-9) * np.minimum(1.2 * np.sqrt(self.rng.uniform(size=len(q))), 1.0)
        axis = np.cos(angle)[:, None] * middle + np.sin(angle)[:, None] * across
        q, reached = self._solved(q, goal.point[0], axis)
        q = q[reached]
        q = q[cell.admissible(q)]
        return q, self._values(q) if len(q) else np.empty(0)

    def _solved(self, q: FloatArray, point: FloatArray, axis: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Newton's method from `q` (N, n) to a tool point (3,) and axes (N, 3); which of them are there."""
        for _ in range(_STEPS):
            at = self.request.cell.postures.tool_at(q)
            z, J = at.tool_rotation[:, :, 2], at.jacobian
            error = np.hstack([point - at.tool_point, np.cross(z, axis)])
            turns = J[:, 3:] - z[:, :, None] * (z[:, None] @ J[:, 3:])
            J = np.concatenate([J[:, :3], turns], axis=1)
            gram = J @ J.transpose(0, 2, 1) + _DAMPING * np.eye(6)
            step = (J.transpose(0, 2, 1) @ np.linalg.solve(gram, error[:, :, None]))[:, :, 0]
            q = q + step / np.maximum(np.abs(step).max(axis=1, keepdims=True) / 0.5, 1.0)
        q = self.request.cell.robot.limits.turned_to_middle(q)
        at = self.request.cell.postures.tool_at(q)
        away = np.hstack([at.tool_point - point, at.tool_rotation[:, :, 2] - axis])
        return q, np.abs(away).max(axis=1) < _EXACT

    def _best(self, each: list[tuple[FloatArray, FloatArray]]) -> list[FloatArray]:
        """The sequence with the smallest peak, then the shortest, within the joints' speeds; empty: none."""
        if not all(len(q) for q, _ in each):
            return []
        options, limits = self.request.cell.options, self.request.cell.robot.limits
        steps = options.step_share * limits.velocity * np.diff(self.request.times)[:, None]
        lengths = []
        for ((q_a, _), (q_b, _)), step in zip(pairwise(each), steps, strict=True):
            moves, largest = cdist(q_a / step, q_b / step), cdist(q_a / step, q_b / step, "chebyshev")
            lengths.append(np.where(largest <= 1, moves**2, np.inf))
        peak = each[0][1]
        for length, (_, value) in zip(lengths, each[1:], strict=True):
            peak = np.maximum(np.where(np.isfinite(length), peak[:, None], np.inf).min(axis=0), value)
        if not np.isfinite(peak.min()):
            return []
        cost, origins = np.where(each[0][1] <= peak.min(), 0.0, np.inf), []
        for length, (_, value) in zip(lengths, each[1:], strict=True):
            through = cost[:, None] + length
            origins.append(through.argmin(axis=0))
            cost = np.where(value <= peak.min(), through.min(axis=0), np.inf)
        chosen = [int(cost.argmin())]
        for origin in reversed(origins):
            chosen.append(int(origin[chosen[-1]]))
        return [q[i] for (q, _), i in zip(each, reversed(chosen), strict=True)]


def _joined(
    one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    return np.vstack([one[0], other[0]]), np.append(one[1], other[1])


def main() -> int:
    """Plan, compare, print; the exit status is 1 where a search is not within the share."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--draws", type=int, default=2000, help="random postures at each via-point")
    options = parser.parse_args()
    console, ratios = Console(soft_wrap=True), list[tuple[float, float]]()
    for number in range(options.first, options.first + options.count):
        with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
            data, request = cone_scene(options.seed, number, folder)
            scene = load_scene(Path(folder, "scene.yaml"))
            rng = np.random.default_rng([options.seed, number])
            least, searched, planned, why = Programme(request, rng, options.draws).least(), np.inf, np.inf, ""
            try:
                choice = initial_guess(request).choice
                searched = (choice and choice.free) or 0.0
                q = plan(scene, progress=False).trajectory.evaluate(request.times)
                planned = float(request.cell.objective.at_rest(request.cell.postures.at(q)).max())
            except PlanningError as error:
                why = f"; {str(error)[:150]}"
        legs = ", ".join(f"{np.linalg.norm(leg['by']):.2f} m" for leg in data["tool_path"]["legs"])
        console.print(
            f"{number} {_ARMS[number % len(_ARMS)]} {data['robot']['payload_kg']} kg, "
            f"{data['tool_path']['keep']['axis_within_deg']} deg, {legs}: least {least:.1f}, searched "
            f"{searched:.1f} ({searched / least:.3f}), planned {planned:.1f} Nm ({planned / least:.3f}){why}"
        )
        if least < np.inf:
            ratios.append((searched / least, planned / least))
    both = np.array(ratios)
    within, moves = (both <= 1 + _SHARE).sum(axis=0), np.isfinite(both[:, 1]).sum()
    console.print(
        f"{within[0]} of {len(both)} searches, {within[1]} of {moves} plans within {_SHARE:.0%} of the least"
    )
    return 0 if within[0] == len(both) else 1


if __name__ == "__main__":
    sys.exit(main())
