"""Elasticity of the guardrail under the foot and of the links of the arm.

The arm's elasticity needs the robot, and pinocchio with it: it is imported from its own modules,
`cmbot.elastic.arm`, `cmbot.elastic.sag` and `cmbot.elastic.modes`, so that a scene is read without them.
"""

from cmbot.elastic.base import (
    ElasticBase as ElasticBase,
    SharedFrame as SharedFrame,
    elastic_base as elastic_base,
    shares as shares,
    with_legs as with_legs,
)
from cmbot.elastic.beam import (
    beam_mass as beam_mass,
    beam_stiffness as beam_stiffness,
    yield_moments as yield_moments,
)
from cmbot.elastic.guardrail import (
    AngleSection as AngleSection,
    BarSection as BarSection,
    FlatSection as FlatSection,
    Guardrail as Guardrail,
    GuardrailMaterial as GuardrailMaterial,
    Post as Post,
    Rail as Rail,
    Section as Section,
)
