"""What bends: the guardrail under the foot, and the links of the arm."""

from __future__ import annotations

from cmbot.elastic.guardrail import AngleSection, BarSection, Guardrail, GuardrailMaterial, Post, Rail

__all__ = ["AngleSection", "BarSection", "Guardrail", "GuardrailMaterial", "Post", "Rail"]
