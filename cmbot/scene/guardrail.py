"""The guardrail as data: for the boxes that can be hit, and for the frame that bends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import cast

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.scene.guardrail_schema import GuardrailFile, Matrix6, SectionFile
from cmbot.scene.obstacles import Box, Obstacle, pose

__all__ = [
    "AngleSection",
    "BarSection",
    "Guardrail",
    "GuardrailMaterial",
    "Post",
    "Rail",
    "guardrail_from_file",
    "guardrail_obstacles",
]


@dataclass(frozen=True, kw_only=True)
class AngleSection:
    """Equal-leg angle steel.

    Attributes
    ----------
    leg, thickness : float
        m.
    """

    leg: float
    thickness: float


@dataclass(frozen=True, kw_only=True)
class BarSection:
    """A round bar.

    Attributes
    ----------
    diameter : float
        m.
    """

    diameter: float


Section = AngleSection | BarSection


@dataclass(frozen=True, kw_only=True)
class Post:
    """What every post is like; its axis runs along z at y = 0.

    Attributes
    ----------
    section : AngleSection or BarSection
    roll : float
        Turn of the section about z, rad; at 0 the legs of an angle point along +x and +y.
    bottom, clamp, top : float
        z of the lower end, of the end of the rigid hold, of the upper end, m.
    box : tuple of float
        (2,), collision box along x and y, m.
    """

    section: Section
    roll: float
    bottom: float
    clamp: float
    top: float
    box: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class Rail:
    """A member along x at y = 0, from the first post to the last.

    Attributes
    ----------
    name : str
    section : AngleSection or BarSection
    roll : float
        Turn of the section about x, rad; at 0 the legs of an angle point along +y and +z.
    height : float
        z, m.
    box : tuple of float
        (2,), collision box along y and z, m.
    """

    name: str
    section: Section
    roll: float
    height: float
    box: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class GuardrailMaterial:
    """What the members are made of.

    Attributes
    ----------
    young, shear : float
        Moduli, Pa.
    density : float
        kg/m3.
    """

    young: float
    shear: float
    density: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Guardrail:
    """A row of posts with rails; the foot holds it at the origin of W.

    Attributes
    ----------
    post_positions : tuple of float
        (bays + 1,), x of each post in W, m; empty: there is no guardrail to hit.
    post : Post
    rails : tuple of Rail
    material : GuardrailMaterial
    stiffness : array or None
        (6, 6), at the origin of W, in W, linear then angular (N/m, N/rad, Nm/rad), in place of the frame's
        own; read-only. None: the frame's, and where there are no posts the hold is rigid.
    mass : array or None
        (6, 6), moves with the foot beside a given `stiffness`; read-only. None: no such mass.
    """

    post_positions: tuple[float, ...]
    post: Post
    rails: tuple[Rail, ...]
    material: GuardrailMaterial
    stiffness: FloatArray | None
    mass: FloatArray | None


def guardrail_from_file(file: GuardrailFile) -> Guardrail:
    """Return the guardrail that a scene file describes, in SI units and radians."""
    first = -(file.foot_post - 1) * file.post_spacing_m - file.foot.offset_m
    count = file.bays + 1 if file.bays else 0
    post, material = file.post, file.material
    return Guardrail(
        post_positions=tuple(first + index * file.post_spacing_m for index in range(count)),
        post=Post(
            section=_section(post.section),
            roll=math.radians(post.roll_deg),
            bottom=post.bottom_m,
            clamp=post.clamp_m,
            top=post.top_m,
            box=post.box_m,
        ),
        rails=tuple(
            Rail(
                name=rail.name,
                section=_section(rail.section),
                roll=math.radians(rail.roll_deg),
                height=rail.height_m,
                box=rail.box_m,
            )
            for rail in (file.rails if count else ())
        ),
        material=GuardrailMaterial(
            young=material.young_pa, shear=material.shear_pa, density=material.density_kg_m3
        ),
        stiffness=_matrix(file.stiffness),
        mass=_matrix(file.mass),
    )


def guardrail_obstacles(guardrail: Guardrail) -> tuple[Obstacle, ...]:
    """Return the boxes of the rails, by their names, and of the posts ``post_1``, ``post_2``, … along x."""
    positions, post = guardrail.post_positions, guardrail.post
    if not positions:
        return ()
    middle, length = (positions[0] + positions[-1]) / 2, positions[-1] - positions[0]
    rails = (
        Obstacle(name=rail.name, shape=Box(size=(length, *rail.box)), X_WO=pose((middle, 0.0, rail.height)))
        for rail in guardrail.rails
    )
    size, height = (*post.box, post.top - post.bottom), (post.top + post.bottom) / 2
    posts = (
        Obstacle(name=f"post_{number}", shape=Box(size=size), X_WO=pose((x, 0.0, height)))
        for number, x in enumerate(positions, start=1)
    )
    return (*rails, *posts)


def _section(file: SectionFile) -> Section:
    if file.angle is not None:
        return AngleSection(leg=file.angle[0], thickness=file.angle[1])
    return BarSection(diameter=cast("float", file.bar))  # the schema lets exactly one through


def _matrix(rows: Matrix6 | None) -> FloatArray | None:
    if rows is None:
        return None
    matrix = np.array(rows)
    matrix.setflags(write=False)
    return matrix
