"""A frame of straight beams in space: stiffness, mass, condensation to one node, natural frequencies."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import ArpackError, LinearOperator, SuperLU, eigsh, splu

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.elastic.beam import SectionConstants, beam_mass, beam_stiffness
from cmbot.elastic.guardrail import GuardrailMaterial

# Sine of the angle to the member's axis below which a first axis does not define the section's orientation.
_PARALLEL_SINE = 1e-6
# Largest asymmetry of a compliance, relative to its diagonal, that is accepted as rounding.
_MAX_ASYMMETRY = 1e-6
# Up to this many coordinates all modes are computed: ARPACK needs more vectors than the modes asked for.
_MAX_DENSE_COORDINATES = 60


@dataclass(frozen=True, kw_only=True)
class Member:
    """A straight beam, rigidly joined to two nodes.

    `first_axis` is the section's first axis in W; its component along the member is ignored. The second axis
    is the cross product of the member's direction, from node `start` to node `end`, and the first.
    """

    start: int
    end: int
    section: SectionConstants
    first_axis: tuple[float, float, float]
    material: GuardrailMaterial


class Condensed(NamedTuple):
    """A frame condensed to k of its nodes, one after the other: linear then angular, in W, SI.

    The stiffness (6 k, 6 k) is exact for loads at the nodes; the mass (6 k, 6 k) is Guyan's, of the static
    deflections under loads at the nodes.
    """

    stiffness: FloatArray
    mass: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """Euler-Bernoulli frame in space: `nodes` (k, 3), m, in W, some of them clamped; displacements are small.

    It is refused when a member has no length, no section orientation or no positive constants, or when the
    frame or a part of it is not held.
    """

    nodes: FloatArray
    members: Sequence[Member]
    fixed: Sequence[int]

    def __post_init__(self) -> None:
        if self.nodes.ndim != 2 or self.nodes.shape[1] != 3 or not np.isfinite(self.nodes).all():
            raise _refusal("nodes", f"shape {self.nodes.shape}", "finite rows of x, y, z")
        for index, node in enumerate(self.fixed):
            if node not in range(len(self.nodes)):
                raise _refusal(f"fixed[{index}]", node, f"one of the {len(self.nodes)} nodes")
        for index, member in enumerate(self.members):
            self._check(f"members[{index}]", member)
        self._check_hold()

    @cached_property
    def stiffness(self) -> sparse.csc_array:
        """Stiffness (f, f) of the free coordinates: six a node that is not fixed, in the nodes' order."""
        return self._assembled(self._matrices[0])

    @cached_property
    def mass(self) -> sparse.csc_array:
        """Consistent mass (f, f) of the free coordinates."""
        return self._assembled(self._matrices[1])

    def coordinates(self, node: int) -> IntArray:
        """Indices (6,) of a node's displacement and rotation among the free coordinates."""
        if node not in range(len(self.nodes)) or node in self.fixed:
            raise _refusal("node", node, f"one of the {len(self.nodes)} nodes that is not fixed")
        return np.asarray(self._free_index[node])

    def compliance(self, *nodes: int) -> FloatArray:
        """Return the displacements (6 k, 6 k) of `nodes`, which are not fixed, under unit loads at them."""
        return self._loaded(*nodes)[1]

    def condense(self, *nodes: int) -> Condensed:
        """Condense the frame to `nodes`, which are not fixed and differ."""
        shapes, K = self._condensed(*nodes)
        M = shapes.T @ (self.mass @ shapes)
        return Condensed(stiffness=K, mass=(M + M.T) / 2)

    def shapes(self, *nodes: int) -> FloatArray:
        """Displacements and rotations (k, 6, 6 m) of all nodes by those of m `nodes`, for loads at these."""
        moved = self._condensed(*nodes)[0]
        moved = np.vstack([moved, np.zeros(moved.shape[1])])
        return np.asarray(moved[self._free_index])  # the last row, for -1, is that of fixed nodes

    def _condensed(self, *nodes: int) -> tuple[FloatArray, FloatArray]:
        """Static displacements (f, 6 m) by unit displacements of m nodes, and the stiffness there."""
        moved, compliance = self._loaded(*nodes)
        K = _inverse(compliance)
        return moved @ K, K

    def _loaded(self, *nodes: int) -> tuple[FloatArray, FloatArray]:
        """Static displacements (f, 6 m) under unit loads at m nodes, and those of these nodes (6 m, 6 m)."""
        index = np.concatenate([self.coordinates(node) for node in nodes])
        loads = np.zeros((self.stiffness.shape[0], len(index)))
        loads[index, np.arange(len(index))] = 1.0
        moved = np.asarray(self._factor.solve(loads))
        return moved, moved[index]

    def frequencies(self, count: int) -> FloatArray:
        """Lowest natural frequencies, Hz: see `natural_frequencies`."""
        return natural_frequencies(self.stiffness, self.mass, count, factor=self._factor)

    def _check(self, key: str, member: Member) -> None:
        for end in (member.start, member.end):
            if end not in range(len(self.nodes)):
                raise _refusal(key, end, f"one of the {len(self.nodes)} nodes")
        x, y, z = (
            end - start for start, end in zip(*self.nodes[[member.start, member.end]].tolist(), strict=True)
        )
        length = math.hypot(x, y, z)
        if length == 0:
            raise _refusal(key, "length 0", "two nodes at different places")
        a, b, c = member.first_axis
        across = math.hypot(y * c - z * b, z * a - x * c, x * b - y * a)
        # Negated so that NaN is refused.
        if not across > _PARALLEL_SINE * length * math.hypot(a, b, c):
            expected = "a direction that is not along the member"
            raise _refusal(f"{key}.first_axis", member.first_axis, expected)
        section, steel = member.section, member.material
        positive = (section.area, section.major, section.minor, section.torsion, steel.young, steel.shear)
        if not all(0 < value < np.inf for value in positive) or not 0 <= steel.density < np.inf:
            expected = "positive section constants and moduli and a density that is not negative"
            raise _refusal(key, (*positive, steel.density), expected)

    def _check_hold(self) -> None:
        starts, ends = self._ends
        count = len(self.nodes)
        joined = sparse.coo_array((np.ones(len(starts)), (starts, ends)), shape=(count, count))
        _, group = connected_components(joined, directed=False)
        # Joints are rigid, so one clamped node holds everything connected to it.
        loose = np.flatnonzero(~np.isin(group, group[np.array(self.fixed, dtype=np.intp)]))
        if len(loose):
            raise _refusal("fixed", list(self.fixed), f"a fixed node that members join to node {loose[0]}")

    @cached_property
    def _ends(self) -> tuple[IntArray, IntArray]:
        starts = np.array([member.start for member in self.members], dtype=np.intp)
        return starts, np.array([member.end for member in self.members], dtype=np.intp)

    @cached_property
    def _free_index(self) -> IntArray:
        """Index (k, 6) of every node's coordinates among the free ones; -1 where the node is fixed."""
        free = np.ones((len(self.nodes), 6), dtype=bool)
        free[np.array(self.fixed, dtype=np.intp)] = False
        return np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)

    @cached_property
    def axes(self) -> tuple[FloatArray, FloatArray]:
        """The members' own axes as columns (m, 3, 3), in W, and their lengths (m,), m."""
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
        return np.stack([x, y, np.cross(x, y)], axis=-1), length

    @cached_property
    def _matrices(self) -> tuple[FloatArray, FloatArray]:
        """Stiffness and consistent mass matrices (m, 12, 12) of the members."""
        R, length = self.axes
        materials, sections = [m.material for m in self.members], [m.section for m in self.members]
        moduli = [(m.young, m.shear, m.density) for m in materials]
        young, shear, density = np.array(moduli).reshape(-1, 3).T
        constants = [(s.area, s.major, s.minor, s.torsion) for s in sections]
        area, major, minor, torsion = np.array(constants).reshape(-1, 4).T
        mass, inertia = density * area * length, density * (major + minor) * length
        stiffness = beam_stiffness(R, length, young * area, shear * torsion, young * major, young * minor)
        return stiffness, beam_mass(R, length, mass, inertia)

    def _assembled(self, matrices: FloatArray) -> sparse.csc_array:
        """Sum of beams' matrices (m, 12, 12) over the free coordinates."""
        starts, ends = self._ends
        index = np.concatenate([self._free_index[starts], self._free_index[ends]], axis=1)
        rows, columns = np.repeat(index, 12, axis=1).ravel(), np.tile(index, 12).ravel()
        free = (rows >= 0) & (columns >= 0)
        size = int(self._free_index.max(initial=-1)) + 1
        entries = (matrices.ravel()[free], (rows[free], columns[free]))
        return sparse.csc_array(sparse.coo_array(entries, shape=(size, size)))

    @cached_property
    def _factor(self) -> SuperLU:
        return _factorised(self.stiffness)


def natural_frequencies(
    stiffness: sparse.csc_array, mass: sparse.csc_array, count: int, *, factor: SuperLU | None = None
) -> FloatArray:
    """Return the lowest natural frequencies, at most `count` and one a coordinate with mass, ascending, Hz.

    The stiffness is positive definite, the mass at least semi-definite; `factor` is that of the stiffness.
    """
    size = stiffness.shape[0]
    if count < 1 or mass.count_nonzero() == 0:
        return np.zeros(0)
    if size <= max(_MAX_DENSE_COORDINATES, 4 * count):
        # The roles of mass and stiffness are exchanged because the mass may be singular.
        try:
            squares = linalg.eigh(mass.toarray(), stiffness.toarray(), eigvals_only=True)[::-1][:count]
        except linalg.LinAlgError as error:
            raise _ill_conditioned() from error
        moving = squares > size * np.finfo(float).eps * squares[0]
        return np.asarray(1 / (2 * np.pi * np.sqrt(squares[moving])))
    solve = (factor or _factorised(stiffness)).solve
    try:
        squares = eigsh(
            stiffness,
            count,
            mass,
            sigma=0.0,
            OPinv=LinearOperator(stiffness.shape, matvec=solve, dtype=float),
            # The start vector has to be repeatable and without symmetries.
            v0=np.random.default_rng(0).normal(size=size),
            return_eigenvectors=False,
        )
    except ArpackError as error:  # such as masses that vanish beside the stiffness
        raise _ill_conditioned() from error
    if not squares.min() > 0:
        raise _ill_conditioned()
    return np.sort(np.sqrt(squares)) / (2 * np.pi)


def _factorised(stiffness: sparse.csc_array) -> SuperLU:
    options = {"SymmetricMode": True}
    try:
        return splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:  # SuperLU's "exactly singular"
        raise _ill_conditioned() from error


def _inverse(compliance: FloatArray) -> FloatArray:
    """Exactly symmetric inverse of a compliance that is positive definite and nearly symmetric."""
    if not np.all(np.diag(compliance) > 0):
        raise _ill_conditioned()
    scale = np.sqrt(np.diag(compliance))
    scaled = compliance / scale[:, None] / scale  # metres and radians on one scale
    # Symmetric by Maxwell and Betti's theorem: any asymmetry is rounding.
    if not np.abs(scaled - scaled.T).max() < _MAX_ASYMMETRY:
        raise _ill_conditioned()
    try:
        factor = linalg.cho_factor((scaled + scaled.T) / 2, lower=True)
    except linalg.LinAlgError as error:
        raise _ill_conditioned() from error
    inverse = linalg.cho_solve(factor, np.eye(len(scaled))) / scale[:, None] / scale
    return np.asarray((inverse + inverse.T) / 2)


def _refusal(key: str, got: object, expected: str) -> InputError:
    return InputError("Frame", key, got, expected)


def _ill_conditioned() -> InputError:
    """Error of matrices that are definite on paper but not in floating point."""
    got = "stiffnesses or masses that floating-point numbers cannot hold side by side"
    return _refusal("members", got, "members of comparable stiffness, mass and length")
