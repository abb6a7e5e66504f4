"""Where to stand: candidates along the guardrail, screened and ranked, the best planned."""

from cmbot.siting.candidates import Candidate, candidates_of
from cmbot.siting.screening import Screening, screen
from cmbot.siting.standing import (
    Standing,
    StandOptions,
    Stood,
    best_scene,
    in_words,
    stances_csv,
    stand,
)

__all__ = [
    "Candidate",
    "Screening",
    "StandOptions",
    "Standing",
    "Stood",
    "best_scene",
    "candidates_of",
    "in_words",
    "screen",
    "stances_csv",
    "stand",
]
