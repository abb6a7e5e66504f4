"""Elasticity of the guardrail under the foot and of the links of the arm.

The arm's elasticity needs the robot, and pinocchio with it: it is imported from its own modules,
`cmbot.elastic.arm`, `cmbot.elastic.sag` and `cmbot.elastic.modes`, so that a scene is read without them.
"""

from cmbot.elastic.base import ElasticBase, SharedFrame, elastic_base, shares, with_legs
from cmbot.elastic.guardrail import (
    AngleSection,
    BarSection,
    Guardrail,
    GuardrailMaterial,
    Post,
    Rail,
    Section,
)

__all__ = [
    "AngleSection",
    "BarSection",
    "ElasticBase",
    "Guardrail",
    "GuardrailMaterial",
    "Post",
    "Rail",
    "Section",
    "SharedFrame",
    "elastic_base",
    "shares",
    "with_legs",
]
