"""The route: a graph of stances, in which every edge is a step that one foot can hold at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra, minimum_spanning_tree

from cmbot.common.arrays import BoolArray, FloatArray, IntArray
from cmbot.robot import Climber, Side
from cmbot.scene import FootholdFile, Scene, foothold_face, foothold_pose
from cmbot.stances import APART, REACH, Candidate, bare_climber, candidate_at, places_of
from cmbot.stances.walking.balance import SPARE, Balance

# Places this far beyond both stances are looked at, m.
_BEYOND_M = 0.8
# A metre that a foot goes costs as much as so many steps.
_STEPS_PER_METRE = 0.5

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
    ends = [place for node in (first, last) for place in (node.stance.foot_1, node.stance.foot_2) if place]
    xs = [float(node.root[0, 3]) for node in (first, last)]
    places, climber = list[FootholdFile](), Climber()
    for place in (*ends, *places_of(scene, spacing)):
        x = float(foothold_pose(scene.elastic_guardrail, place)[0, 3])
        # On round bars a foot holds only where a scene wants it to.
        flat = place in ends or not foothold_face(scene.elastic_guardrail, place).held_by_clamps_alone
        if flat and min(xs) - _BEYOND_M <= x <= max(xs) + _BEYOND_M and place not in places:
            places.append(place)
    poses = [foothold_pose(scene.elastic_guardrail, place) for place in places]
    points, normals = np.array([X[:3, 3] for X in poses]), np.array([X[:3, 1] for X in poses])
    nodes = [first, last]
    for place, X in zip(places, poses, strict=True):
        away = np.linalg.norm(points - X[:3, 3], axis=1)
        near = (away >= APART) & (away <= REACH) & (normals @ X[:3, 1] > 0.999)
        for other in np.flatnonzero(near):
            for angles in climber.reaching(np.linalg.inv(X) @ poses[other]):
                node = candidate_at(place, places[int(other)], X, angles, climber)
                if (node.base[:3, 3] - X[:3, 3]) @ X[:3, 1] > 0:
                    nodes.append(node)
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
        self.nodes = nodes
        self.use = {foot: np.array([balance.step_load(node, foot).use for node in nodes]) for foot in _FEET}
        numbers = dict[Key | None, int]()
        # Of the places of each foot; they are equal where the places are.
        self._place = {
            foot: np.array([numbers.setdefault(_key(_place(node, foot)), len(numbers)) for node in nodes])
            for foot in _FEET
        }
        self._free = numbers.get(None, -1)
        each = [self._edges(foot) for foot in _FEET]
        self._ends = np.vstack(each)
        self._goes = np.repeat(_FEET, [len(part) for part in each])
        self._closed = np.zeros(len(self._ends), dtype=np.bool_)
        base = np.array([node.base[:3, 3] for node in nodes])
        way = np.linalg.norm(base[self._ends[:, 0]] - base[self._ends[:, 1]], axis=1)
        self._cost = 1.0 + _STEPS_PER_METRE * way

    def _edges(self, foot: Side) -> IntArray:
        """Pairs (E, 2) of nodes between which a foot goes while the other one holds."""
        goes, stays = self._place[foot], self._place[_other(foot)]
        held = self.use[_other(foot)] <= SPARE
        found = [np.zeros((0, 2), dtype=np.intp)]
        for place in np.unique(stays[stays != self._free]):
            group = np.flatnonzero(stays == place)
            good = held[group].astype(np.float32)
            common = (good @ good.T > 0) & (goes[group][:, None] != goes[group])
            found.append(group[np.argwhere(np.triu(common))])
        return np.vstack(found)

    def close(self, edge: Edge) -> None:
        """Leave a step out from now on, in both directions."""
        same = (np.sort(self._ends, axis=1) == sorted((edge.before, edge.after))).all(axis=1)
        self._closed |= same & (self._goes == edge.foot)

    def leave_out(self, node: int, weights: BoolArray) -> None:
        """Leave out the postures (K,) of the arm that are not possible in a node."""
        for foot in _FEET:
            self.use[foot][node, weights] = np.inf
            here = (self._ends == node).any(axis=1) & (self._goes == _other(foot))
            ends = self._ends[here]
            use = np.maximum(self.use[foot][ends[:, 0]], self.use[foot][ends[:, 1]])
            self._closed[here] |= ~(use <= SPARE).any(axis=1)

    def counterweights(self, edge: Edge, before: int) -> IntArray:
        """Numbers of the arm's postures with which both ends of a step hold, the best first.

        That in which the arm is `before` comes first where it will do.
        """
        shares = self.use[_other(edge.foot)]
        use = np.maximum(shares[edge.before], shares[edge.after])
        order = np.argsort(use, kind="stable")
        order = order[use[order] <= SPARE]
        return np.concatenate([order[order == before], order[order != before]])

    def shortest(self, start: int, goal: int = 1) -> list[Edge] | None:
        """Return the steps from one node to another of least cost; None where none lead there."""
        use, N = ~self._closed, len(self.nodes)
        first, second = self._ends[use].T
        graph = sparse.csr_array((self._cost[use], (first, second)), shape=(N, N))
        cost, came = dijkstra(graph, directed=False, indices=start, return_predecessors=True)
        if np.isinf(cost[goal]):
            return None
        edges, k = list[Edge](), goal
        while k != start:
            before = int(came[k])
            pair = (np.sort(self._ends, axis=1) == sorted((before, k))).all(axis=1) & use
            edges.append(Edge(before=before, after=k, foot=_FEET[int(self._goes[pair][0]) - 1]))
            k = before
        return edges[::-1]

    def easiest_way(self, start: int, goal: int = 1, *, tried: bool = False) -> tuple[Edge, float] | None:
        """Return the hardest step of the way whose hardest step uses least of the bounds, and its share.

        Also of ways that use more than there is, and where `tried` says so of steps that were tried in vain;
        None where there is none at all.
        """
        ends, share, foot = (np.concatenate(part) for part in zip(*self._all_steps(), strict=True))
        closed = {tuple(pair) for pair in self._ends[self._closed].tolist()}
        in_vain = (share <= SPARE) & [tuple(pair) in closed for pair in ends.tolist()]
        possible = np.isfinite(share) & (tried | ~in_vain)
        ends, share, foot = ends[possible], share[possible], foot[possible]
        N = len(self.nodes)
        tree = minimum_spanning_tree(sparse.csr_array((share, ends.T), shape=(N, N)))
        cost, came = dijkstra(tree, directed=False, indices=start, return_predecessors=True)
        if np.isinf(cost[goal]):
            return None
        number = {tuple(pair): k for k, pair in enumerate(ends.tolist())}
        way, k = list[tuple[int, int, int]](), goal
        while k != start:
            before = int(came[k])
            way.append((number[min(before, k), max(before, k)], before, k))
            k = before
        hardest, before, after = max(way, key=lambda step: share[step[0]])
        return Edge(before=before, after=after, foot=_FEET[int(foot[hardest]) - 1]), float(share[hardest])

    def _all_steps(self) -> Iterator[tuple[IntArray, FloatArray, IntArray]]:
        """Pairs (E, 2) of nodes between which a foot goes, shares (E,) of bounds, and that foot (E,)."""
        for foot in _FEET:
            goes, stays, use = self._place[foot], self._place[_other(foot)], self.use[_other(foot)]
            for place in np.unique(stays[stays != self._free]):
                group = np.flatnonzero(stays == place)
                pairs = group[np.argwhere(np.triu(goes[group][:, None] != goes[group]))]
                least = [np.maximum(use[first], use[second]).min() for first, second in pairs]
                yield pairs.reshape(-1, 2), np.array(least), np.full(len(pairs), foot)


_FEET: tuple[Side, Side] = (1, 2)


def _other(foot: Side) -> Side:
    return 2 if foot == 1 else 1


def _place(node: Candidate, foot: Side) -> FootholdFile | None:
    return node.stance.foot_1 if foot == 1 else node.stance.foot_2


def _key(place: FootholdFile | None) -> Key | None:
    return (
        None if place is None else (place.member, round(place.along_m, 4), place.face, place.turn_deg % 360)
    )
