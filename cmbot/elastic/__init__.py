"""What bends: the guardrail under the foot, and the links of the arm.

What needs the robot is imported from its own module, `cmbot.elastic.arm`, `cmbot.elastic.sag` and
`cmbot.elastic.arm_modes`: a scene is read without it.
"""

from __future__ import annotations

from cmbot.elastic.base import ElasticBase, elastic_base
from cmbot.elastic.guardrail import AngleSection, BarSection, Guardrail, GuardrailMaterial, Post, Rail
from cmbot.elastic.sections import SectionConstants, section_constants

__all__ = [
    "AngleSection",
    "BarSection",
    "ElasticBase",
    "Guardrail",
    "GuardrailMaterial",
    "Post",
    "Rail",
    "SectionConstants",
    "elastic_base",
    "section_constants",
]
