"""Walks between neighbouring stances: which are found, and what a search of its own says of the others.

    python benchmarks/walk_pairs.py             # 20 pairs; prints the table
    python benchmarks/walk_pairs.py --pairs 5 --both

Stances on two feet on the top rail of the default guardrail, on the clamps of `two_brackets`, the arm in a
random posture that is clear and held. Of each pair both feet are at most 0.3 m further along. Of those that
`cmbot walk` refuses, with ``--both`` of all, a breadth-first search over steps seeks a sequence. It has its
own graph, postures of the arm and statics (pinocchio, whole robot). A step of it is a foot that is lifted,
goes straight in joint space, and is set down, clear by the safety margin, while joints and foot bear what
all postures on the way ask at rest. Before it the arm moves through a roadmap, clear, and its
joints bear that. The exit status is 1 where a sequence is found that was not walked.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

import cmbot
from cmbot.collision import Clearances
from cmbot.common.errors import PlanningError
from cmbot.common.installation import model_folder
from cmbot.planning import robot_of
from cmbot.robot import ARM_JOINTS, CLIMBING_JOINTS, Climber, Robot, Side
from cmbot.scene import LIFT_M, FootholdFile, Scene, StanceFile, foothold_pose
from cmbot.stances import (
    Candidate,
    bare_climber,
    candidate_at,
    in_world,
    places_of,
    scene_at,
    without_links,
)
from cmbot.stances.walking import stance_of
from cmbot.stances.walking.balance import foot_at
from cmbot.stances.walking.steps import swinging_robot

__all__ = ["Search", "neighbours"]

FloatArray = NDArray[np.float64]

SEED, PAIRS, AWAY_M = 2021, 20, 0.3
CLAMP = {"kind": "clamp", "force_n": [10000] * 3, "moment_nm": [2000] * 3}
_SCENE: dict[str, Any] = {
    "format": "cmbot-scene/2",
    "name": "rail",
    "start": {"stow": True},
    "tool_path": {
        "from": {"xyz": [1.8, 0.78, -2.06], "rpy_deg": [0, 180, 0]},
        "legs": [{"by": [0, -0.1, 0], "seconds": 5}],
    },
    "obstacles": [{"name": "slab", "box": [6, 1.2, 0.12], "xyz": [1, -0.8, -1.06]}],
}
# Places of feet, m; random postures of the arm beside one, by so much in a joint, rad, and how many are kept;
# postures of a swing and of a lift; stances that are gone on from, and postures of the arm of which a step is
# looked at in full.
_GRID_M, _DRAWN, _GROWN_RAD, _KEPT, _SWING, _LIFT, _NODES, _TRIED = 0.15, 40, 0.45, 300, 12, 4, 400, 3
# Of feet from each other, m.
_NEAREST_M, _FURTHEST_M = 0.16, 0.9
# Neighbours in the arm's roadmap, postures of a straight way there, and those drawn to begin in; joints turn
# by less between two heights of a lifted foot, rad.
_NEIGHBOURS, _ARM, _ARMS, _NEAR_RAD = 8, 12, 40, 0.5


def neighbours(number: int, seed: int) -> Iterator[tuple[Scene, StanceFile]]:
    """Yield pairs of stances; the arm begins in the first posture that is clear and that it can hold."""
    rng, scene = np.random.default_rng(seed), cmbot.load_scene({**_SCENE, "guardrail": {"hold": CLAMP}})
    places = [place for place in places_of(scene, 0.05) if place.member == "top_rail"]
    while number > 0:
        feet = [places[int(k)] for k in rng.integers(len(places), size=2)]
        first = _standing(scene, feet, rng)
        if first is None:
            continue
        near = [[other for other in places if abs(other.along_m - foot.along_m) <= AWAY_M] for foot in feet]
        second = _standing(scene, [close[int(rng.integers(len(close)))] for close in near], rng)
        if second is not None and _places(second[0]) != _places(first[0]):
            number -= 1
            yield scene_at(in_world(scene), first[0], first[1]), second[0].stance


def _standing(
    scene: Scene, feet: list[FootholdFile], rng: np.random.Generator
) -> tuple[Candidate, FloatArray] | None:
    """A stance with feet at two places, and a posture of the arm, where both are clear and held."""
    X, X_2 = (foothold_pose(scene.elastic_guardrail, foot) for foot in feet)
    postures = Climber().reaching(np.linalg.inv(X) @ X_2)
    if not _NEAREST_M <= np.linalg.norm(X_2[:3, 3] - X[:3, 3]) <= _FURTHEST_M or not postures:
        return None
    node = candidate_at(*feet, X, postures[int(rng.integers(len(postures)))], Climber())
    climber, margin = (
        bare_climber(node.root, scene.all_obstacles, foot_2=False),
        scene.planner.safety_margin_m,
    )
    if (node.base[:3, 3] - X[:3, 3]) @ X[:3, 1] <= 0:
        return None
    if climber.query(node.climber[None], margin).distance[0] < margin:
        return None
    there = scene_at(in_world(scene), node, None)
    robot = robot_of(there)
    arms = robot.limits.drawn(rng, _ARMS)
    good = np.flatnonzero(_bears(robot, there, arms))
    return (node, arms[good[0]]) if len(good) else None


def _bears(robot: Robot, scene: Scene, q: FloatArray) -> NDArray[np.bool_]:
    """In which postures (N, 7) the arm is clear, and its joints bear its weight."""
    margin, data = scene.planner.safety_margin_m, robot.model.createData()
    torque = np.abs([pin.computeGeneralizedGravity(robot.model, data, posture) for posture in q])
    near = Clearances(robot, scene.all_obstacles).query(q, margin).distance < margin
    return np.asarray(~near & (torque <= robot.limits.torque).all(axis=1))


class Search:
    """Breadth first over steps from a scene's stance to another one.

    Parameters
    ----------
    scene : Scene
    goal : StanceFile
    """

    def __init__(self, scene: Scene, goal: StanceFile) -> None:
        self._scene, self._margin = in_world(scene), scene.planner.safety_margin_m
        self._climber, self._statics = Climber(), _Statics()
        self._start, self._goal = stance_of(scene), stance_of(scene.with_stance(goal))
        self._parts = dict[int, NDArray[np.intp]]()
        self._rest = dict[tuple[int, Side], FloatArray]()
        self.arms = self._grown(np.array(scene.posture))
        self.nodes = [self._start, self._goal, *self._between()]

    def steps(self) -> int | None:
        """Return how many steps lead to the goal; None where none were found."""
        queue, seen = deque([(0, frozenset({0}), 0)]), {0}
        while queue and len(seen) < _NODES:
            number, arms, count = queue.popleft()
            for other in range(len(self.nodes)):
                if other in seen:
                    continue
                reached = self._step(number, other, arms)
                if reached:
                    if other == 1:
                        return count + 1
                    seen.add(other)
                    queue.append((other, reached, count + 1))
        return None

    def _grown(self, first: FloatArray) -> FloatArray:
        """Postures (K, 7) of the arm, each beside an earlier one, with centres of mass far apart."""
        robot, rng = robot_of(self._scene), np.random.default_rng(1)
        clearances, arms = Clearances(robot, ()), first[None]
        centres = np.array([self._statics.arm_centre(first)])
        while len(arms) < _KEPT:
            new = arms[rng.integers(len(arms), size=_DRAWN)] + rng.normal(0, _GROWN_RAD, (_DRAWN, robot.dof))
            new = new[robot.limits.contain(new)]
            new = new[clearances.query(new, self._margin).distance >= self._margin]
            points = np.array([self._statics.arm_centre(q) for q in new])
            # Every other one wherever it is, so that there are near ones to go through.
            away = np.linalg.norm(points[:, None] - centres, axis=2).min(axis=1)
            best = int(away.argmax()) if len(arms) % 2 else 0
            arms, centres = np.vstack([arms, new[best]]), np.vstack([centres, points[best]])
        return arms

    def _connected(self, number: int) -> NDArray[np.intp]:
        """By postures of the arm, what part of a roadmap they are in, in a stance; -1: it is in none."""
        if number not in self._parts:
            scene = scene_at(self._scene, self.nodes[number], None)
            robot = robot_of(scene)
            possible = _bears(robot, scene, self.arms)
            self._parts[number] = np.where(possible, 0, -1)
            some = np.flatnonzero(possible)
            if len(some) < 2:
                return self._parts[number]
            away = np.abs(self.arms[some][:, None] - self.arms[some]).max(axis=2)
            near = some[np.argsort(away, axis=1)[:, 1 : 1 + _NEIGHBOURS]]
            start, end = np.repeat(some, near.shape[1]), near.ravel()
            shares = np.linspace(0, 1, _ARM)[:, None, None]
            way = self.arms[start] + shares * (self.arms[end] - self.arms[start])
            free = _bears(robot, scene, way.reshape(-1, robot.dof)).reshape(_ARM, -1).all(axis=0)
            graph = csr_array((free[free], (start[free], end[free])), shape=(_KEPT, _KEPT))
            part = connected_components(graph, directed=False)[1].astype(np.intp)
            self._parts[number] = np.where(possible, part, -1)
        return self._parts[number]

    def _between(self) -> Iterator[Candidate]:
        """Stances on two feet about both ends."""
        ends = [place for node in (self._start, self._goal) for place in _places(node)]
        along = [place.along_m for place in ends]
        on_grid = [
            place
            for place in places_of(self._scene, _GRID_M)
            if place.member == "top_rail" and min(along) - AWAY_M <= place.along_m <= max(along) + AWAY_M
        ]
        places = [*dict.fromkeys(ends), *on_grid]
        for place in places:
            X = foothold_pose(self._scene.elastic_guardrail, place)
            for other in places:
                X_2 = foothold_pose(self._scene.elastic_guardrail, other)
                if not _NEAREST_M <= np.linalg.norm(X_2[:3, 3] - X[:3, 3]) <= _FURTHEST_M:
                    continue
                for angles in self._climber.reaching(np.linalg.inv(X) @ X_2):
                    node = candidate_at(place, other, X, angles, self._climber)
                    if (node.base[:3, 3] - X[:3, 3]) @ X[:3, 1] > 0:
                        yield node

    def _step(self, number: int, other: int, arms: frozenset[int]) -> frozenset[int]:
        """The postures of the arm with which a foot can go from one stance to another; few are looked at."""
        before, after = self.nodes[number], self.nodes[other]
        same = [one == two for one, two in zip(_places(before), _places(after), strict=True)]
        if sum(same) != 1:
            return frozenset()
        goes: Side = 2 if same[0] else 1
        use = np.maximum(self._at_rest(number, goes), self._at_rest(other, goes))
        if use.min() > 1 or (up := self._lifted(number, goes)) is None:
            return frozenset()
        if (down := self._lifted(other, goes)) is None:
            return frozenset()
        swing = up[-1] + np.linspace(0, 1, _SWING)[:, None] * (down[-1] - up[-1])
        part = self._connected(number)
        to = np.isin(part, part[sorted(arms)]) & (part >= 0) & (self._connected(other) >= 0)
        good = np.flatnonzero((use <= 1) & to)
        good = good[np.argsort(use[good])][:_TRIED]
        way = np.vstack([up, swing, down])
        return frozenset(
            int(k)
            for k in good
            if self._use(before, way, goes, [int(k)]).max() <= 1
            and self._swings(before, goes, self.arms[k], np.vstack([up, down]), swing)
        )

    def _at_rest(self, number: int, goes: Side) -> FloatArray:
        """Largest shares (K,) of bounds with each posture of the arm, foot `goes` lifted."""
        key = number, goes
        if key not in self._rest:
            node = self.nodes[number]
            self._rest[key] = self._use(node, node.climber[None], goes, range(len(self.arms))).max(axis=1)
        return self._rest[key]

    def _use(self, node: Candidate, way: FloatArray, goes: Side, arms: Sequence[int]) -> FloatArray:
        """Shares (K, N) of bounds that a way (N, 5) uses with postures of the arm, foot `goes` lifted."""
        holds: Side = 2 if goes == 1 else 1
        place = _places(node)[holds - 1]
        foot, X = foot_at(self._scene, place, holds), foothold_pose(self._scene.elastic_guardrail, place)
        bounds = np.array([*foot.force, *foot.moment]) / foot.safety
        use = np.empty((len(arms), len(way)))
        for n, angles in enumerate(way):
            for k, arm in enumerate(arms):
                torque, force, moment = self._statics.loads(angles, self.arms[arm], X, holds)
                # The contact is `centre` away from where the foot's frame is.
                load = np.hstack([foot.axes @ force, foot.axes @ (moment - np.cross(foot.centre, force))])
                use[k, n] = max((np.abs(torque) / self._climber.effort).max(), (np.abs(load) / bounds).max())
        return use

    def _lifted(self, number: int, foot: Side) -> FloatArray | None:
        """Postures (N, 5) of the climber as a foot is lifted off along the normal; None: it cannot be."""
        angles = self.nodes[number].climber
        place, way = self._climber.poses(angles)[0], [angles]
        for height in np.linspace(0, LIFT_M, _LIFT + 1)[1:]:
            X = place.copy()
            X[1, 3] += height if foot == 2 else -height
            near = [q for q in self._climber.reaching(X) if np.abs(q - way[-1]).max() < _NEAR_RAD]
            if not near:
                return None
            way.append(near[0])
        return np.array(way)

    def _swings(
        self, node: Candidate, goes: Side, arm: FloatArray, near: FloatArray, far: FloatArray
    ) -> bool:
        """Whether all is clear: beside the member, where the foot itself does not count, and away from it."""
        robot, turn = swinging_robot(self._scene, node, goes, arm), 1 if goes == 2 else -1
        bare = without_links(robot, lambda link: link == f"foot_{goes}")
        return all(
            Clearances(shapes, self._scene.all_obstacles).query(way[:, ::turn], self._margin).distance.min()
            >= self._margin
            for shapes, way in ((bare, near), (robot, far))
        )


class _Statics:
    """Loads at rest of the whole robot, by pinocchio; its root is foot 1."""

    def __init__(self) -> None:
        self._model = pin.buildModelFromUrdf(str(model_folder() / "urdf" / "cmbot.urdf"))
        self._data = self._model.createData()
        names = [*CLIMBING_JOINTS, *ARM_JOINTS]
        self._index = np.array([self._model.joints[self._model.getJointId(name)].idx_q for name in names])
        self._foot_2 = self._model.getFrameId("foot_2")

    def loads(
        self, climber: FloatArray, arm: FloatArray, X: FloatArray, holds: Side
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Torques (5,) of climbing joints; force and moment (3,) in W about the foot that holds, at `X`."""
        model, data, q = self._model, self._data, np.zeros(self._model.nq)
        q[self._index] = [*climber, *arm]
        pin.framesForwardKinematics(model, data, q)
        foot = pin.SE3.Identity() if holds == 1 else data.oMf[self._foot_2]
        weight = foot.rotation @ X[:3, :3].T @ [0, 0, -9.81]
        model.gravity.linear = weight
        centre = pin.centerOfMass(model, data, q)
        mass = pin.computeTotalMass(model)
        force, moment = mass * weight, np.cross(centre - foot.translation, mass * weight)
        torque = np.array(pin.computeGeneralizedGravity(model, data, q))
        if holds == 2:
            # The foot pushes back: it takes the whole weight.
            J = pin.computeFrameJacobian(model, data, q, self._foot_2, pin.LOCAL_WORLD_ALIGNED)
            torque = torque + J.T @ np.hstack([force, moment])
        R = X[:3, :3] @ foot.rotation.T
        return torque[self._index[: len(CLIMBING_JOINTS)]], R @ force, R @ moment

    def arm_centre(self, arm: FloatArray) -> FloatArray:
        """Centre of mass (3,), m, of the robot with its climber straight, which tells the arm's."""
        q = np.zeros(self._model.nq)
        q[self._index[len(CLIMBING_JOINTS) :]] = arm
        return np.array(pin.centerOfMass(self._model, self._data, q))


def _places(node: Candidate) -> tuple[FootholdFile, FootholdFile]:
    if node.stance.foot_2 is None:
        raise ValueError("a stance on one foot")
    return node.stance.foot_1, node.stance.foot_2


def main() -> None:
    """Walk, search, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=PAIRS)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--both", action="store_true", help="search where it is walked, too")
    asked = parser.parse_args()
    print(f"{asked.pairs} pairs of neighbouring stances on the top rail, seed {asked.seed}")
    print("| from | to | walked | s | found by the search | processor s | why not |")
    walked = missed = 0
    for scene, goal in neighbours(asked.pairs, asked.seed):
        start, steps, why = time.process_time(), None, ""
        try:
            walk = cmbot.walk(scene, goal)
            steps = len(walk.steps)
        except PlanningError as error:
            why = str(error)
        seconds = time.process_time() - start
        found = Search(scene, goal).steps() if steps is None or asked.both else None
        walked += steps is not None
        missed += steps is None and found is not None
        cells = [_words(scene.guardrail.stance), _words(goal), *(_count(n) for n in (steps, found))]
        cells.insert(3, f"{walk.seconds:.0f}" if steps is not None else "-")
        print("|", " | ".join([*cells, f"{seconds:.1f}", why]), "|", flush=True)
    print(f"{walked} of {asked.pairs} walked; {missed} of the others have a sequence of steps by the search")
    sys.exit(1 if missed else 0)


def _count(steps: int | None) -> str:
    return "-" if steps is None else str(steps)


def _words(stance: StanceFile | None) -> str:
    feet = () if stance is None else (stance.foot_1, stance.foot_2)
    return " and ".join(f"{foot.along_m:.2f} ({foot.turn_deg:.0f})" for foot in feet if foot is not None)


if __name__ == "__main__":
    main()
