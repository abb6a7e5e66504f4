"""The paper's experiments with our robot, beside what the paper measured."""

from __future__ import annotations

from cmbot.reproduction.agreement import findings, reasons
from cmbot.reproduction.experiment import FACTORS, QUICK_FACTORS, Reproduction, reproduce
from cmbot.reproduction.goals import goals
from cmbot.reproduction.report import as_json, comparison, require_room, save_reproduction, verdict_rows
from cmbot.reproduction.tables import cells

__all__ = [
    "FACTORS",
    "QUICK_FACTORS",
    "Reproduction",
    "as_json",
    "cells",
    "comparison",
    "findings",
    "goals",
    "reasons",
    "reproduce",
    "require_room",
    "save_reproduction",
    "verdict_rows",
]
