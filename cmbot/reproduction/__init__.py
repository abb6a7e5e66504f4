"""The paper's experiments with our robot, beside what the paper measured."""

from __future__ import annotations

from cmbot.reproduction.agreement import Finding, findings, reasons
from cmbot.reproduction.experiment import Experiment, Reproduction, Run, reproduce
from cmbot.reproduction.paper import PAPER, PaperError, PaperExperiment
from cmbot.reproduction.report import as_json, comparison, markdown
from cmbot.reproduction.writing import require_room, save_reproduction

__all__ = [
    "PAPER",
    "Experiment",
    "Finding",
    "PaperError",
    "PaperExperiment",
    "Reproduction",
    "Run",
    "as_json",
    "comparison",
    "findings",
    "markdown",
    "reasons",
    "reproduce",
    "require_room",
    "save_reproduction",
]
