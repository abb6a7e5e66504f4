"""Balance: the loads of holding on to one foot at rest, with the arm as a counterweight.

The arm is locked while the climber moves. All that its posture changes is where its centre of mass is, so
many postures of the arm are judged at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.hold import Foot, Holding
from cmbot.planning import FreeSpace, robot_of
from cmbot.robot import Climber, ClimberBodies, Postures, Robot, Side
from cmbot.scene import FootholdFile, Scene, StanceFile, feet_at
from cmbot.stances import Candidate, bare_climber, scene_at

# Counterweights grow from the arm's posture and the nearest to it of so many random ones: rounds, random
# postures in each, their distance in a joint, rad, and how many are kept: with centres of mass far apart.
_SEEDS, _GROWTH_ROUNDS, _DRAWN, _STEP, _KEPT = 20_000, 20, 1500, 0.35, 800
# Neighbours of each to which straight ways may lead, and ways that are tried from one to another.
_NEIGHBOURS, _MOST_WAYS = 10, 300
SPARE = 0.9
"""Share of the bounds of joints and feet that both ends of a step may use; the rest is for the motion."""
# Shares of a straight swing at which the loads at rest are known, beside its ends.
_ON_THE_WAY = np.linspace(0.0, 1.0, 7)[1:-1]
# Share of their torques that the arm's joints use at rest at most, the base turned by up to this, rad.
_HELD, _TILT = 0.95, np.radians(35.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class StepLoad:
    """The loads of holding on to one foot, with each of K postures of the arm.

    Attributes
    ----------
    use : (K,)
        The largest share of a bound, of climbing joints and foot; infinite where this foot holds nothing.
    effort : (K,)
        The largest share of a climbing joint's effort.
    joint : (K,)
        Number of that joint, from 1.
    adhesion : (K,), N
        That the foot needs; 0 without a flat contact.
    """

    use: FloatArray
    effort: FloatArray
    joint: FloatArray
    adhesion: FloatArray


class Balance:
    """Counterweights, and the loads of stances with them.

    Parameters
    ----------
    scene : Scene
        Of the shipped robot.
    first : (7,), rad
        Where the arm is.

    Attributes
    ----------
    arms : (K, 7), rad
        Postures of the arm, `first` and those grown from it, each from an earlier one.
    """

    def __init__(self, scene: Scene, first: FloatArray) -> None:
        self._scene, self._climber = scene, Climber()
        self._holdings = dict[tuple[Any, ...], Holding]()
        robot = robot_of(scene).tool_off
        X = robot.model.frames[robot.model.getFrameId("arm_base")].placement.homogeneous
        postures = Postures(robot)
        clearances, rng = Clearances(robot, scene.all_obstacles), np.random.default_rng(0)
        margin, drawn = 2 * scene.planner.safety_margin_m, robot.limits.drawn(rng, _SEEDS)
        drawn = drawn[_held(postures, drawn, robot.limits.torque, np.full(_SEEDS, _TILT))]
        drawn = drawn[clearances.query(drawn, margin).distance >= margin]
        nearest = int(robot.metric.lengths(drawn - first).argmin())
        self.arms, parent = np.vstack([first, drawn[[nearest]]]), np.zeros(2, dtype=np.intp)
        # What grows from where the arm is need not be held in tilted stances: else it may be caught there.
        tilt = np.array([0.0, _TILT])
        for _ in range(_GROWTH_ROUNDS):
            origin = rng.integers(len(self.arms), size=_DRAWN)
            new = self.arms[origin] + rng.normal(0.0, _STEP, (_DRAWN, robot.dof))
            good = robot.limits.contain(new)
            for share in (1.0, 0.5):
                q = self.arms[origin] + share * (new - self.arms[origin])
                good[good] = _held(postures, q[good], robot.limits.torque, tilt[origin[good]])
                good[good] = clearances.query(q[good], margin).distance >= margin
            kept = np.flatnonzero(good)
            both = self._centres(postures, X, np.vstack([self.arms, new[kept]]))
            chosen = _furthest_apart(both, len(self.arms), len(self.arms) + _KEPT // _GROWTH_ROUNDS)
            added = kept[np.array(chosen[len(self.arms) :], dtype=np.intp) - len(self.arms)]
            parent, tilt = np.append(parent, origin[added]), np.append(tilt, tilt[origin[added]])
            self.arms = np.vstack([self.arms, new[added]])
        self._roadmap(robot, parent)
        self._arm_centre = self._centres(postures, X, self.arms)
        self._arm_mass, self._gravity = robot.arm_mass, np.array(robot.model.gravity.linear)

    def _centres(self, postures: Postures, X_WB: FloatArray, arms: FloatArray) -> FloatArray:
        """Centres of mass (K, 3), m, of the arm in the base's frame."""
        at = postures.at(arms)
        centre = np.einsum("b,kbi->ki", at.arm.mass, at.centre) / at.arm.mass.sum()
        return np.asarray((centre - X_WB[:3, 3]) @ X_WB[:3, :3])

    def _roadmap(self, robot: Robot, parent: IntArray) -> None:
        """Note between which postures straight ways may lead, pairs (E, 2), and how long they are."""
        places = robot.metric.coordinates(self.arms)
        near = KDTree(places).query(places, min(_NEIGHBOURS + 1, len(places)))[1]
        every = np.arange(len(places))
        pairs = np.vstack(
            [
                np.column_stack([every, parent]),
                *(np.column_stack([every, column]) for column in near[:, 1:].T),
            ]
        )
        self._pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
        self._lengths = np.linalg.norm(np.subtract(*places[self._pairs.T]), axis=1)

    def roadmap(self, possible: BoolArray, space: FreeSpace) -> Roadmap:
        """Return the ways of the arm through its `possible` postures (K,) in a stance."""
        return Roadmap(
            self.arms, self._pairs, np.where(possible[self._pairs].all(axis=1), self._lengths, np.inf), space
        )

    def step_load(self, node: Candidate, foot: Side) -> StepLoad:
        """Return the loads of a stance when one of its feet lets go and the other, `foot`, holds."""
        K = len(self.arms)
        place = node.stance.places[foot - 1]
        if place is None:
            never = np.full(K, np.inf)
            return StepLoad(use=never, effort=never, joint=np.ones(K), adhesion=never)
        bodies, R = self._climber.bodies(node.climber), node.root[:3, :3]
        effort = self._torques(bodies, foot, R) / self._climber.effort
        holding, wrench = self._holding(place, foot), self._wrench(bodies, foot, R)
        # The share asks for it of the same wrenches.
        adhesion = holding(wrench)[0] if holding.adhesive else np.zeros(K)
        largest = effort.max(axis=1)
        return StepLoad(
            use=np.maximum(largest, holding.share(wrench)[0]),
            effort=largest,
            joint=effort.argmax(axis=1) + 1.0,
            adhesion=adhesion,
        )

    def swing_use(self, before: Candidate, after: Candidate, foot: Side) -> FloatArray:
        """Return the largest shares (K,) of bounds on the way of a straight swing, while `foot` holds."""
        use, X = np.zeros(len(self.arms)), before.foot_pose(foot)
        for share in _ON_THE_WAY:
            angles = before.climber + share * (after.climber - before.climber)
            root = X if foot == 1 else X @ np.linalg.inv(self._climber.poses(angles)[0])
            use = np.maximum(use, self.step_load(replace(before, climber=angles, root=root), foot).use)
        return use

    def impossible(self, scene: Scene, node: Candidate) -> BoolArray:
        """Which postures of the arm come too near to something in a stance, or its joints cannot hold.

        Parameters
        ----------
        scene : Scene
            As `in_world` returns it.
        node : Candidate
        """
        robot, margin = robot_of(scene_at(scene, node, None)), scene.planner.safety_margin_m
        climber = bare_climber(node.root, scene.all_obstacles, foot_2=2 not in node.feet)
        if climber.query(node.climber[None], margin).distance[0] < margin:
            return np.ones(len(self.arms), dtype=np.bool_)
        # A step needs some room beside the margin.
        least = 1.5 * margin
        near = Clearances(robot, scene.all_obstacles).query(self.arms, least).distance < least
        torque = np.abs(Postures(robot).at(self.arms).joint_torque)
        return near | (torque > SPARE * robot.limits.torque).any(axis=1)

    def leads_away(self, scene: Scene, node: Candidate) -> bool:
        """Whether one of the feet can be lifted in a stance, as far as that is known at rest."""
        use = np.minimum(*(self.step_load(node, foot).use for foot in (1, 2)))
        return bool((use <= SPARE).any()) and bool(((use <= SPARE) & ~self.impossible(scene, node)).any())

    def _holding(self, place: FootholdFile, foot: Side) -> Holding:
        key = (foot, place.member, place.along_m, place.face)
        if key not in self._holdings:
            self._holdings[key] = Holding((foot_at(self._scene, place, foot),), np.zeros(6))
        return self._holdings[key]

    def _torques(self, bodies: ClimberBodies, foot: Side, R: FloatArray) -> FloatArray:
        """Torques (K, 5), Nm, of the climbing joints at rest, without signs."""
        arm = self._arm_centre @ bodies.base[:3, :3].T + bodies.base[:3, 3]
        joint, body = np.arange(len(bodies.origin))[:, None], np.arange(len(bodies.mass))
        # A joint carries what is on the other side of it; the arm is on the body that joint 2 moves.
        mass = np.where((body > joint) == (foot == 1), bodies.mass, 0.0)
        arm_mass = np.where((joint[:, 0] < 2) == (foot == 1), self._arm_mass, 0.0)
        # The torque about an axis is that of the weight: axis . (lever x weight) = (weight x axis) . lever.
        slope = np.cross(R.T @ self._gravity, bodies.axis)
        first = mass @ bodies.centre - (mass.sum(axis=1) + arm_mass)[:, None] * bodies.origin
        still = (slope * first).sum(axis=1)
        return np.asarray(np.abs(still + arm_mass * (arm @ slope.T)))

    def _wrench(self, bodies: ClimberBodies, foot: Side, R: FloatArray) -> FloatArray:
        """Wrenches (K, 6) of the robot's weight about the foot, in W."""
        centre = self._arm_centre @ bodies.base[:3, :3].T + bodies.base[:3, 3]
        first = bodies.mass @ bodies.centre + self._arm_mass * centre
        mass = bodies.mass.sum() + self._arm_mass
        origin = np.zeros(3) if foot == 1 else bodies.foot_2[:3, 3]
        moment = np.cross((first - mass * origin) @ R.T, self._gravity)
        return np.hstack([np.broadcast_to(mass * self._gravity, moment.shape), moment])


class Roadmap:
    """Ways of the arm between counterweights in a stance: a lazy roadmap (Bohlin and Kavraki 2000).

    Straight ways are checked only where the shortest path has them, and left out where they are not free.

    Parameters
    ----------
    arms : (K, 7), rad
    pairs : (E, 2)
        Numbers of postures between which straight ways may lead.
    lengths : (E,)
        Of these; infinite where they do not lead.
    space : FreeSpace
    """

    def __init__(self, arms: FloatArray, pairs: IntArray, lengths: FloatArray, space: FreeSpace) -> None:
        self._arms, self._pairs, self._lengths, self._space = arms, pairs, lengths, space
        self._free = set[tuple[int, int]]()

    def way(self, start: int, end: int) -> FloatArray | None:
        """Return postures (k, 7) that lead from one counterweight to another; None where none were found."""
        K = len(self._arms)
        for _ in range(_MOST_WAYS):
            way = shortest_way(csr_array((self._lengths, self._pairs.T), shape=(K, K)), start, end)
            if way is None:
                return None
            blocked = next((pair for pair in pairwise(way) if not self._is_free(min(pair), max(pair))), None)
            if blocked is None:
                return np.asarray(self._arms[way])
            self._lengths[(self._pairs == sorted(blocked)).all(axis=1)] = np.inf
        return None

    def _is_free(self, start: int, end: int) -> bool:
        if (start, end) not in self._free and self._space.straight(self._arms[start], self._arms[end]):
            self._free.add((start, end))
        return (start, end) in self._free


def shortest_way(graph: csr_array, start: int, end: int) -> list[int] | None:
    """Return the nodes of the shortest way through a graph; None where none leads there."""
    cost, came = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
    if np.isinf(cost[end]):
        return None
    way = [end]
    while way[-1] != start:
        way.append(int(came[way[-1]]))
    return way[::-1]


def foot_at(scene: Scene, place: FootholdFile, foot: Side) -> Foot:
    """Return a foot that holds alone.

    Parameters
    ----------
    scene : Scene
    place : FootholdFile
    foot : int
        Its number.
    """
    file, holds = scene.guardrail, scene.guardrail.hold
    if holds:
        file = file.changed(hold=holds[min(foot, len(holds)) - 1])
    stance = StanceFile(foot_1=place)
    (held,) = feet_at(file, stance, scene.elastic_guardrail, (np.eye(6),))
    return held


def _held(postures: Postures, q: FloatArray, torque: FloatArray, tilt: FloatArray) -> BoolArray:
    """Which postures (N, 7) the joints can hold, also where the base is turned by up to `tilt` (N,), rad."""
    at = postures.at(q)
    moment = np.cross(at.axis, at.carried_moment.transpose(2, 0, 1))
    size, g = np.linalg.norm(moment, axis=2), np.linalg.norm(at.arm.gravity)
    along = np.abs(moment @ at.arm.gravity) / np.maximum(size * g, 1e-9)
    away = np.arccos(np.clip(along, 0.0, 1.0))
    carried = size * g * np.cos(np.maximum(away - tilt[:, None], 0.0))
    return np.asarray((carried <= _HELD * torque).all(axis=1))


def _furthest_apart(points: FloatArray, first: int, number: int) -> list[int]:
    """Indices of points (N, 3) that are far apart, the `first` ones among them."""
    kept = list(range(first))
    away = np.linalg.norm(points[:, None] - points[:first], axis=2).min(axis=1)
    while len(kept) < min(number, len(points)):
        kept.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(points - points[kept[-1]], axis=1))
    return kept
