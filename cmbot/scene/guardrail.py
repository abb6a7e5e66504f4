"""The guardrail of a scene: from the file to data, and as boxes that can be hit."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.guardrail import (
    AngleSection,
    BarSection,
    Guardrail,
    GuardrailMaterial,
    Post,
    Rail,
    Section,
)
from cmbot.scene.guardrail_schema import GuardrailFile, Matrix6, SectionFile
from cmbot.scene.obstacles import Box, Obstacle, pose

__all__ = ["guardrail_from_file", "guardrail_obstacles"]


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
