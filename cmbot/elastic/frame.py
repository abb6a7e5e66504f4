"""A frame of straight beams in space: its stiffness and mass, all of it or seen from one node."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.elastic.beam import Beams
from cmbot.elastic.frame_modes import factorised, natural_frequencies, too_far_apart
from cmbot.elastic.sections import SectionConstants

__all__ = ["Condensed", "Frame", "Member"]

# A direction nearer than this to its member's axis says nothing about how the section is turned.
_PARALLEL = 1e-6

# So much asymmetry of a compliance, as a share of its diagonal, is rounding that can be borne.
_ASYMMETRY = 1e-6


@dataclass(frozen=True, kw_only=True)
class Member:
    """A straight beam between two nodes, stiffly joined to both.

    Attributes
    ----------
    start, end : int
        Its nodes.
    section : SectionConstants
    first_axis : tuple of float
        (3,), in W, the section's first axis; what of it lies along the member does not count. The second
        axis is that of the member, from start to end, times the first.
    young, shear : float
        Moduli, Pa.
    density : float
        kg/m3.
    """

    start: int
    end: int
    section: SectionConstants
    first_axis: tuple[float, float, float]
    young: float
    shear: float
    density: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Condensed:
    """A frame as one of its nodes feels it: linear then angular, in W.

    Attributes
    ----------
    stiffness : (6, 6), N/m, N/rad, Nm/rad
        Exact for loads at the node.
    mass : (6, 6), kg, kg m, kg m2
        Guyan's: that of the shapes into which loads at the node bend the frame.
    """

    stiffness: FloatArray
    mass: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """Euler-Bernoulli frame in space, small displacements, clamped at some nodes.

    Attributes
    ----------
    nodes : (k, 3), m
        In W.
    members : sequence of Member
    fixed : sequence of int
        Nodes that neither move nor turn.

    Raises
    ------
    InputError
        When a member leads nowhere or has no direction of its section, or when something could move freely.
    """

    nodes: FloatArray
    members: Sequence[Member]
    fixed: Sequence[int]

    def __post_init__(self) -> None:
        if self.nodes.ndim != 2 or self.nodes.shape[1] != 3 or not np.isfinite(self.nodes).all():
            raise _refusal("nodes", f"shape {self.nodes.shape}", "finite rows of x, y, z")
        known = range(len(self.nodes))
        for index, node in enumerate(self.fixed):
            if node not in known:
                raise _refusal(f"fixed[{index}]", node, f"one of the {len(self.nodes)} nodes")
        for index, member in enumerate(self.members):
            self._check(index, member)
        self._check_hold()

    @cached_property
    def stiffness(self) -> sparse.csc_array:
        """Stiffness (f, f) of the free coordinates: six a node that is not fixed, in the nodes' order."""
        return self._assembled(self._beams.stiffness())

    @cached_property
    def mass(self) -> sparse.csc_array:
        """Consistent mass (f, f) of the free coordinates."""
        return self._assembled(self._beams.mass())

    def coordinates(self, node: int) -> IntArray:
        """Places (6,) of a node's displacement and rotation among the free coordinates.

        Raises
        ------
        InputError
            When there is no such node or it is fixed.
        """
        if node not in range(len(self.nodes)) or node in self.fixed:
            raise _refusal("node", node, f"one of the {len(self.nodes)} nodes that is not fixed")
        return np.asarray(self._places[6 * node : 6 * node + 6])

    def condense(self, node: int) -> Condensed:
        """Return the frame as `node` feels it.

        Raises
        ------
        InputError
            When there is no such node, it is fixed, or the frame's stiffnesses are too far apart to be told.
        """
        where = self.coordinates(node)
        loads = np.zeros((self.stiffness.shape[0], 6))
        loads[where, np.arange(6)] = 1.0
        shapes = self._factor.solve(loads)
        K = _inverse(shapes[where])
        shapes = shapes @ K
        M = shapes.T @ (self.mass @ shapes)
        return Condensed(stiffness=K, mass=(M + M.T) / 2)

    def frequencies(self, count: int) -> FloatArray:
        """Lowest natural frequencies, ascending, Hz: `count` of them or as many as the frame has.

        None where the frame has no mass.

        Raises
        ------
        InputError
            When the frame's stiffnesses are too far apart to be told.
        """
        return natural_frequencies(self.stiffness, self.mass, count, factor=self._factor)

    def _check(self, index: int, member: Member) -> None:
        key = f"members[{index}]"
        for end in (member.start, member.end):
            if end not in range(len(self.nodes)):
                raise _refusal(key, end, f"one of the {len(self.nodes)} nodes")
        along = self.nodes[member.end] - self.nodes[member.start]
        length = float(np.linalg.norm(along))
        if length == 0:
            raise _refusal(key, "length 0", "two nodes at different places")
        first = np.array(member.first_axis, dtype=float)
        size = float(np.linalg.norm(first))
        across = np.linalg.norm(np.cross(along, first))
        # Written so that NaN is refused.
        if not across > _PARALLEL * length * size:
            expected = "a direction that is not along the member"
            raise _refusal(f"{key}.first_axis", member.first_axis, expected)
        section = member.section
        firm = (section.area, section.major, section.minor, section.torsion, member.young, member.shear)
        if not all(0 < value < np.inf for value in firm) or not 0 <= member.density < np.inf:
            expected = "positive section constants and moduli and a density that is not negative"
            raise _refusal(key, (*firm, member.density), expected)

    def _check_hold(self) -> None:
        starts, ends = self._ends
        count = len(self.nodes)
        joined = sparse.coo_array((np.ones(len(starts)), (starts, ends)), shape=(count, count))
        _, group = connected_components(joined, directed=False)
        # Members are stiffly joined, so a single clamped node holds all that hangs together with it.
        loose = np.flatnonzero(~np.isin(group, group[np.array(self.fixed, dtype=np.intp)]))
        if len(loose):
            raise _refusal("fixed", list(self.fixed), f"a fixed node that members join to node {loose[0]}")

    @cached_property
    def _ends(self) -> tuple[IntArray, IntArray]:
        starts = np.array([member.start for member in self.members], dtype=np.intp)
        return starts, np.array([member.end for member in self.members], dtype=np.intp)

    @cached_property
    def _places(self) -> IntArray:
        """Where each of the six coordinates of every node is among the free ones; -1 where it is fixed."""
        free = np.ones(len(self.nodes), dtype=bool)
        free[np.array(self.fixed, dtype=np.intp)] = False
        free = np.repeat(free, 6)
        return np.where(free, np.cumsum(free) - 1, -1)

    @cached_property
    def _beams(self) -> Beams:
        starts, ends = self._ends
        along = (self.nodes[ends] - self.nodes[starts]).reshape(-1, 3)
        length = np.linalg.norm(along, axis=1)
        x = along / length[:, None]
        first = np.array([member.first_axis for member in self.members], dtype=float).reshape(-1, 3)
        first = first - x * np.sum(first * x, axis=1, keepdims=True)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(x, first)
        tilt = np.array([member.section.tilt for member in self.members])[:, None]
        y = np.cos(tilt) * first + np.sin(tilt) * second
        sections = [member.section for member in self.members]
        young, shear, density = (
            np.array([(m.young, m.shear, m.density) for m in self.members]).reshape(-1, 3).T
        )
        area, major, minor, torsion = (
            np.array([(s.area, s.major, s.minor, s.torsion) for s in sections]).reshape(-1, 4).T
        )
        return Beams(
            rotation=np.stack([x, y, np.cross(x, y)], axis=-1),
            length=length,
            stretch=young * area,
            bend_y=young * major,
            bend_z=young * minor,
            twist=shear * torsion,
            line_mass=density * area,
            line_inertia=density * (major + minor),
        )

    def _assembled(self, matrices: FloatArray) -> sparse.csc_array:
        """Sum of beams' matrices (m, 12, 12) over the free coordinates."""
        places = self._places.reshape(-1, 6)
        starts, ends = self._ends
        index = np.concatenate([places[starts], places[ends]], axis=1)
        rows, columns = np.repeat(index, 12, axis=1).ravel(), np.tile(index, 12).ravel()
        free = (rows >= 0) & (columns >= 0)
        size = int(self._places.max(initial=-1)) + 1
        entries = (matrices.ravel()[free], (rows[free], columns[free]))
        return sparse.csc_array(sparse.coo_array(entries, shape=(size, size)))

    @cached_property
    def _factor(self) -> SuperLU:
        return factorised(self.stiffness)


def _inverse(compliance: FloatArray) -> FloatArray:
    """Exactly symmetric inverse (6, 6) of a compliance that is positive definite and nearly symmetric."""
    if not np.all(np.diag(compliance) > 0):
        raise too_far_apart()
    scale = np.sqrt(np.diag(compliance))
    scaled = compliance / scale[:, None] / scale  # metres and radians on one scale
    # By Maxwell and Betti it is symmetric. What is not has been lost to rounding.
    if not np.abs(scaled - scaled.T).max() < _ASYMMETRY:
        raise too_far_apart()
    try:
        factor = linalg.cho_factor((scaled + scaled.T) / 2, lower=True)
    except linalg.LinAlgError as error:
        raise too_far_apart() from error
    inverse = linalg.cho_solve(factor, np.eye(6)) / scale[:, None] / scale
    return np.asarray((inverse + inverse.T) / 2)


def _refusal(key: str, got: object, expected: str) -> InputError:
    return InputError("Frame", key, got, expected)
