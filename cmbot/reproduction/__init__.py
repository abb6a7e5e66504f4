"""The paper's experiments with our robot, beside what the paper measured."""

from __future__ import annotations

from cmbot.reproduction.agreement import Finding, findings, reasons
from cmbot.reproduction.experiment import (
    FACTORS,
    QUICK_FACTORS,
    Experiment,
    Reproduction,
    Run,
    Variant,
    reproduce,
)
from cmbot.reproduction.goals import goals
from cmbot.reproduction.paper import PAPER, PaperError, PaperExperiment
from cmbot.reproduction.report import (
    as_json,
    comparison,
    markdown,
    require_room,
    save_reproduction,
    verdict_rows,
)
from cmbot.reproduction.tables import GoalRow, GoalTable, Verdict, cells

__all__ = [
    "FACTORS",
    "PAPER",
    "QUICK_FACTORS",
    "Experiment",
    "Finding",
    "GoalRow",
    "GoalTable",
    "PaperError",
    "PaperExperiment",
    "Reproduction",
    "Run",
    "Variant",
    "Verdict",
    "as_json",
    "cells",
    "comparison",
    "findings",
    "goals",
    "markdown",
    "reasons",
    "reproduce",
    "require_room",
    "save_reproduction",
    "verdict_rows",
]
