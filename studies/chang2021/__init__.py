"""The paper's experiments with our robot, beside what the paper measured."""

from __future__ import annotations

from chang2021.agreement import findings, reasons
from chang2021.experiment import FACTORS, QUICK_FACTORS, Reproduction, reproduce
from chang2021.goals import goals
from chang2021.report import as_json, comparison, require_room, save_reproduction, verdict_rows
from chang2021.tables import cells

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
