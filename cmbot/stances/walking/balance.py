"""Balance: the loads of holding on to one foot at rest, with the arm as a counterweight.

The arm is locked while the climber moves. All that its posture changes is where its centre of mass is, so
many postures of the arm are judged at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.hold import Foot, Holding
from cmbot.planning import robot_of
from cmbot.robot import Climber, ClimberBodies, Postures, Side
from cmbot.scene import FootholdFile, Scene, StanceFile, feet_at
from cmbot.stances import Candidate, bare_climber, scene_at

# Counterweights grow from the nearest to the arm's posture of so many random ones: rounds, random postures in
# each, their distance in a joint, rad, and how many are kept: those of the furthest centres of mass.
_SEEDS, _ROUNDS, _DRAWN, _STEP, _KEPT = 20_000, 20, 1500, 0.35, 800
SPARE = 0.9
"""Share of the bounds of joints and feet that both ends of a step may use; the rest is for the motion."""
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
        Postures of the arm, each grown from an earlier one.
    """

    def __init__(self, scene: Scene, first: FloatArray) -> None:
        self._scene, self._climber = scene, Climber()
        self._holdings = dict[tuple[Any, ...], Holding]()
        robot = robot_of(scene).tool_off
        X = robot.model.frames[robot.model.getFrameId("arm_base")].placement.homogeneous
        postures = Postures(robot)
        clearances, rng = Clearances(robot, scene.all_obstacles), np.random.default_rng(0)
        margin, drawn = 2 * scene.planner.safety_margin_m, robot.limits.drawn(rng, _SEEDS)
        drawn = drawn[_held(postures, drawn, robot.limits.torque)]
        drawn = drawn[clearances.query(drawn, margin).distance >= margin]
        nearest = int(robot.metric.lengths(drawn - first).argmin())
        self.arms, self._parent = drawn[[nearest]], [-1]
        for _ in range(_ROUNDS):
            origin = rng.integers(len(self.arms), size=_DRAWN)
            new = self.arms[origin] + rng.normal(0.0, _STEP, (_DRAWN, robot.dof))
            good = robot.limits.contain(new)
            for share in (1.0, 0.5):
                q = self.arms[origin] + share * (new - self.arms[origin])
                good[good] = _held(postures, q[good], robot.limits.torque)
                good[good] = clearances.query(q[good], margin).distance >= margin
            kept = np.flatnonzero(good)
            both = self._centres(postures, X, np.vstack([self.arms, new[kept]]))
            chosen = _furthest_apart(both, len(self.arms), len(self.arms) + _KEPT // _ROUNDS)
            added = kept[np.array(chosen[len(self.arms) :], dtype=np.intp) - len(self.arms)]
            self._parent += origin[added].tolist()
            self.arms = np.vstack([self.arms, new[added]])
        self._arm_centre = self._centres(postures, X, self.arms)
        self._arm_mass, self._gravity = robot.arm_mass, np.array(robot.model.gravity.linear)

    def _centres(self, postures: Postures, X_WB: FloatArray, arms: FloatArray) -> FloatArray:
        """Centres of mass (K, 3), m, of the arm in the base's frame."""
        at = postures.at(arms)
        centre = np.einsum("b,kbi->ki", at.mass, at.centre) / at.mass.sum()
        return np.asarray((centre - X_WB[:3, 3]) @ X_WB[:3, :3])

    def between(self, start: int, end: int) -> FloatArray:
        """Postures (k, 7) that lead from one counterweight to another, clear where they were grown."""
        first, second = self._to_root(start), self._to_root(end)
        while len(first) > 1 and len(second) > 1 and first[-2] == second[-2]:
            first.pop()
            second.pop()
        return np.asarray(self.arms[[*first, *second[-2::-1]]])

    def _to_root(self, number: int) -> list[int]:
        way = [number]
        while self._parent[way[-1]] >= 0:
            way.append(self._parent[way[-1]])
        return way

    def step_load(self, node: Candidate, foot: Side) -> StepLoad:
        """Return the loads of a stance when one of its feet lets go and the other, `foot`, holds."""
        K = len(self.arms)
        place = node.stance.foot_1 if foot == 1 else node.stance.foot_2
        if place is None:
            never = np.full(K, np.inf)
            return StepLoad(use=never, effort=never, joint=np.ones(K), adhesion=never)
        bodies, R = self._climber.bodies(node.climber), node.root[:3, :3]
        effort = self._torques(bodies, foot, R) / self._climber.effort
        holding, wrench = self._holding(place, foot), self._wrench(bodies, foot, R)
        adhesion = holding.each(wrench)[:, 0] if holding.adhesive else np.zeros(K)
        largest = effort.max(axis=1)
        return StepLoad(
            use=np.maximum(largest, holding.share(wrench)[0]),
            effort=largest,
            joint=effort.argmax(axis=1) + 1.0,
            adhesion=adhesion,
        )

    def impossible(self, scene: Scene, node: Candidate) -> BoolArray:
        """Which postures of the arm come too near to something in a stance, or its joints cannot hold.

        Parameters
        ----------
        scene : Scene
            As `in_world` returns it.
        node : Candidate
        """
        robot, margin = robot_of(scene_at(scene, node, None)), scene.planner.safety_margin_m
        climber = bare_climber(node.root, scene.all_obstacles, foot_2=node.stance.foot_2 is None)
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


def _held(postures: Postures, q: FloatArray, torque: FloatArray) -> BoolArray:
    """Which postures (N, 7) the joints can hold, also where the base is turned a little."""
    at = postures.at(q)
    moment = np.cross(at.axis, at.carried_moment.transpose(2, 0, 1))
    size, g = np.linalg.norm(moment, axis=2), np.linalg.norm(at.gravity)
    along = np.abs(moment @ at.gravity) / np.maximum(size * g, 1e-9)
    away = np.arccos(np.clip(along, 0.0, 1.0))
    carried = size * g * np.cos(np.maximum(away - _TILT, 0.0))
    return np.asarray((carried <= _HELD * torque).all(axis=1))


def _furthest_apart(points: FloatArray, first: int, number: int) -> list[int]:
    """Indices of points (N, 3) that are far apart, the `first` ones among them."""
    kept = list(range(first))
    away = np.linalg.norm(points[:, None] - points[:first], axis=2).min(axis=1)
    while len(kept) < min(number, len(points)):
        kept.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(points - points[kept[-1]], axis=1))
    return kept
