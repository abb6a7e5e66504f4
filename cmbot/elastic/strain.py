"""Strain of rails, posts and links: that of bending and stretching at the outer fibres of their sections.

The shear of torsion and what a beam bears between its ends, such as its own weight, are left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.beam import Outline, beam_strain
from cmbot.elastic.frame import Frame


@dataclass(frozen=True, kw_only=True, eq=False)
class BeamStrains:
    """The strains of m beams at both ends, linear in coordinates, and linear between the ends.

    Attributes
    ----------
    rows : (m, 2, 3, k)
        The rows of `beam_strain` by a beam's k coordinates.
    first : (m,)
        Where these begin among all coordinates.
    outlines : tuple of Outline
        (m,), of the beams' sections.
    """

    rows: FloatArray
    first: IntArray
    outlines: tuple[Outline, ...]

    def largest(self, u: FloatArray) -> FloatArray:
        """Return the largest strain, in magnitude, at both ends of all beams, (N, m, 2), from `u` (N, f)."""
        own = u[:, self.first[:, None] + np.arange(self.rows.shape[-1])]
        stretch, *curvatures = np.moveaxis(np.einsum("meck,nmk->nmec", self.rows, own, optimize=True), -1, 0)
        v, w = curvatures
        largest = np.empty(stretch.shape)
        for outline in set(self.outlines):
            of = np.array([each == outline for each in self.outlines])
            at = [stretch[:, of] - y * v[:, of] - z * w[:, of] for y, z in outline.corners]
            largest[:, of] = np.abs(at).max(axis=0) + outline.radius * np.hypot(v[:, of], w[:, of])
        return largest


def frame_strains(frame: Frame, shapes: FloatArray) -> BeamStrains:
    """Return the strains of a frame's members by coordinates that move its k nodes by `shapes` (k, 6, c)."""
    starts, ends = (
        np.array([getattr(m, end) for m in frame.members], dtype=np.intp) for end in ("start", "end")
    )
    moved = np.concatenate([shapes[starts], shapes[ends]], axis=1)
    return BeamStrains(
        rows=np.einsum("mecd,mdk->meck", beam_strain(*frame.axes), moved, optimize=True),
        first=np.zeros(len(starts), dtype=np.intp),
        outlines=tuple(member.section.outline for member in frame.members),
    )


def tube_strains(arm: ElasticArm) -> BeamStrains:
    """Return the strains of the segments of an arm's tubes, link by link, by its elastic coordinates.

    Tubes do not stretch. A segment's slopes are its curvature times its length; its deflections are those of
    a curvature that changes from end to end and is zero in the middle.
    """
    rows, first, outlines = [], [], []
    count = arm.options.segments
    for link, tube in arm.robot.elasticity.items():
        L = tube.length / count
        own = np.zeros((2, 3, 5))
        own[:, 1, 0] = own[:, 2, 1] = 6 / L**2 * np.array([1.0, -1.0])
        own[:, 1, 4], own[:, 2, 3] = 1 / L, -1 / L
        rows += [own] * count
        first += arm.springs["link", link][::5].tolist()
        outlines += [Outline(radius=tube.outer_diameter / 2)] * count
    return BeamStrains(
        rows=np.array(rows).reshape(-1, 2, 3, 5),
        first=np.array(first, dtype=np.intp),
        outlines=tuple(outlines),
    )
