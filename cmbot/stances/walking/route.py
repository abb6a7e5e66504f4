"""The route: a graph of stances, in which every edge is a step that one foot can hold at rest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import minimum_spanning_tree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import Climber, Side, other_foot
from cmbot.scene import FootholdFile, Scene, foothold_face, foothold_pose
from cmbot.stances import Candidate, bare_climber, on_two_feet, places_of
from cmbot.stances.walking.balance import SPARE, Balance, shortest_way

# Places this far beyond both stances are looked at, m.
_BEYOND_M = 0.8
# A metre that a foot goes costs as much as so many steps; so much dearer are all of a kind for each in vain.
_STEPS_PER_METRE, _IN_VAIN = 0.5, 1.0
# Steps whose shares are in memory at once.
_STEPS_AT_ONCE = 1000

Key = tuple[str, float, str, float]


@dataclass(frozen=True, kw_only=True)
class Edge:
    """A step from one node of the graph to another.

    Attributes
    ----------
    before, after : int
        Numbers of the nodes.
    foot : int
        That goes.
    """

    before: int
    after: int
    foot: Side


def nodes_between(scene: Scene, first: Candidate, last: Candidate, spacing: float) -> list[Candidate]:
    """Return stances on two feet between two others, which come first and second.

    Parameters
    ----------
    scene : Scene
    first, last : Candidate
    spacing : float, m
        Between places along members.
    """
    ends = [place for node in (first, last) for place in node.stance.held]
    xs = [float(node.root[0, 3]) for node in (first, last)]
    places, climber = list[FootholdFile](), Climber()
    for place in (*ends, *places_of(scene, spacing)):
        x = float(foothold_pose(scene.elastic_guardrail, place)[0, 3])
        # On round bars a foot holds only where a scene wants it to.
        flat = place in ends or not foothold_face(scene.elastic_guardrail, place).held_by_clamps_alone
        if flat and min(xs) - _BEYOND_M <= x <= max(xs) + _BEYOND_M and place not in places:
            places.append(place)
    nodes = [first, last, *on_two_feet(scene, places, places, climber)]
    angles = np.array([node.climber for node in nodes])
    margin = scene.planner.safety_margin_m
    near = bare_climber(np.eye(4)).query(angles, margin).distance < margin
    return [node for k, node in enumerate(nodes) if k < 2 or not near[k]]


class Route:
    """Shortest ways through the graph of stances, less what turned out impossible.

    Parameters
    ----------
    nodes : sequence of Candidate
        As `nodes_between` returns them.
    balance : Balance

    Attributes
    ----------
    use : dict of int to (N, K) array
        By the foot that holds: largest shares of bounds that the nodes use with each posture of the arm.
    """

    def __init__(self, nodes: list[Candidate], balance: Balance) -> None:
        self.nodes, self._balance = nodes, balance
        # What the straight swings of steps use with each posture of the arm, where it is known.
        self._swings = dict[int, FloatArray]()
        self.use = {foot: np.array([balance.step_load(node, foot).use for node in nodes]) for foot in _FEET}
        numbers = dict[Key | None, int]()
        # Of the places of each foot; they are equal where the places are.
        places = np.array(
            [
                [numbers.setdefault(_key(place), len(numbers)) for place in node.stance.places]
                for node in nodes
            ]
        ).T
        free = numbers.get(None, -1)
        each = [_pairs(places[foot - 1], places[other_foot(foot) - 1], free) for foot in _FEET]
        self._ends = np.vstack(each)
        self._goes = np.repeat(_FEET, [len(part) for part in each])
        self._share = self._shares(np.arange(len(self._ends)))
        self._closed = np.zeros(len(self._ends), dtype=np.bool_)
        base = np.array([node.base[:3, 3] for node in nodes])
        way = np.linalg.norm(base[self._ends[:, 0]] - base[self._ends[:, 1]], axis=1)
        self._cost = 1.0 + _STEPS_PER_METRE * way
        # Steps of a kind are the same but for where they are: where one is impossible others may be, too.
        climber = np.array([node.climber for node in nodes]).round(3)
        kinds = np.column_stack([*(climber[ends] for ends in self._ends.T), self._goes])
        self._kind = np.unique(kinds, axis=0, return_inverse=True)[1].ravel()

    def _shares(self, steps: IntArray) -> FloatArray:
        """Shares (E,) of the bounds that steps use at both ends, with the best posture of the arm."""
        share = np.empty(len(steps))
        for foot in _FEET:
            use, rows = self.use[other_foot(foot)], np.flatnonzero(self._goes[steps] == foot)
            for part in np.array_split(rows, len(rows) // _STEPS_AT_ONCE + 1):
                first, second = self._ends[steps[part]].T
                share[part] = np.maximum(use[first], use[second]).min(axis=1)
        for k, number in enumerate(steps.tolist()):
            if number in self._swings:
                share[k] = self._use_of(number).min()
        return share

    def _use_of(self, number: int) -> FloatArray:
        """Known shares (K,) of the bounds that a step uses with each posture of the arm."""
        use, (first, second) = self.use[other_foot(_FEET[self._goes[number] - 1])], self._ends[number]
        return np.asarray(np.maximum(np.maximum(use[first], use[second]), self._swings.get(number, 0.0)))

    def swings(self, edge: Edge) -> bool:
        """Whether the straight swing of a step holds at rest with some posture of the arm."""
        number = self._number(edge.before, edge.after)
        ends = self.nodes[edge.before], self.nodes[edge.after]
        if number not in self._swings:
            self._swings[number] = self._balance.swing_use(*ends, other_foot(edge.foot))
            self._share[number] = self._use_of(number).min()
        return bool(self._share[number] <= SPARE)

    def _number(self, before: int, after: int) -> int:
        """The number of the step between two nodes."""
        return int(np.flatnonzero((self._ends == sorted((before, after))).all(axis=1))[0])

    def _edge(self, before: int, after: int) -> Edge:
        goes = self._goes[self._number(before, after)]
        return Edge(before=before, after=after, foot=_FEET[int(goes) - 1])

    def close(self, edge: Edge) -> None:
        """Leave a step out from now on, in both directions."""
        number = self._number(edge.before, edge.after)
        self._closed[number] = True
        self._cost[self._kind == self._kind[number]] += _IN_VAIN

    def reopen(self, edges: list[Edge]) -> None:
        """Take steps that were left out in again, whatever their straight swings use."""
        for number in (self._number(edge.before, edge.after) for edge in edges):
            self._closed[number] = False
            self._swings.pop(number, None)
            self._share[number] = self._use_of(number).min()

    def leave_out(self, node: int, weights: BoolArray) -> None:
        """Leave out the postures (K,) of the arm that are not possible in a node."""
        for use in self.use.values():
            use[node, weights] = np.inf
        steps = np.flatnonzero((self._ends == node).any(axis=1))
        self._share[steps] = self._shares(steps)

    def counterweights(self, edge: Edge, before: int) -> IntArray:
        """Numbers of the arm's postures with which both ends of a step hold, the best first.

        That in which the arm is `before` comes first where it will do.
        """
        use = self._use_of(self._number(edge.before, edge.after))
        order = np.argsort(use, kind="stable")
        order = order[use[order] <= SPARE]
        return np.concatenate([order[order == before], order[order != before]])

    def shortest(self, start: int, goal: int = 1) -> list[Edge] | None:
        """Return the steps from one node to another of least cost; None where none lead there."""
        open_, N = ~self._closed & (self._share <= SPARE), len(self.nodes)
        graph = sparse.csr_array((self._cost[open_], self._ends[open_].T), shape=(N, N))
        way = shortest_way(graph, start, goal)
        return None if way is None else [self._edge(*pair) for pair in pairwise(way)]

    def easiest_way(self, start: int, goal: int = 1, *, tried: bool = False) -> Edge | None:
        """Return the hardest step of the way whose hardest step uses least of the bounds.

        Also of ways that use more than there is, and where `tried` says so of steps that were tried in vain;
        None where there is none at all.
        """
        in_vain = self._closed & (self._share <= SPARE)
        possible, N = np.isfinite(self._share) & (tried | ~in_vain), len(self.nodes)
        shares = sparse.csr_array((self._share[possible], self._ends[possible].T), shape=(N, N))
        way = shortest_way(minimum_spanning_tree(shares), start, goal)
        if way is None:
            return None
        hardest = max(pairwise(way), key=lambda pair: self._share[self._number(*pair)])
        return self._edge(*hardest)


_FEET: tuple[Side, Side] = (1, 2)


def _pairs(goes: IntArray, stays: IntArray, free: int) -> IntArray:
    """Pairs (E, 2) of nodes between which a foot goes while the other one holds, by their places (N,)."""
    found = [np.zeros((0, 2), dtype=np.intp)]
    for place in np.unique(stays[stays != free]):
        group = np.flatnonzero(stays == place)
        found.append(group[np.argwhere(np.triu(goes[group][:, None] != goes[group]))])
    return np.vstack(found)


def _key(place: FootholdFile | None) -> Key | None:
    return (
        None if place is None else (place.member, round(place.along_m, 4), place.face, place.turn_deg % 360)
    )
