"""Where to stand: candidates along the guardrail, screened and ranked, the best planned."""

from cmbot.siting.candidates import APART, REACH, Candidate, candidate_at, candidates_of, places_of
from cmbot.siting.footholds import in_the_way, lift_height
from cmbot.siting.screening import Screening, screen
from cmbot.siting.standing import (
    Standing,
    StandOptions,
    Stood,
    best_scene,
    in_words,
    in_world,
    scene_at,
    stances_csv,
    stand,
)

__all__ = [
    "APART",
    "REACH",
    "Candidate",
    "Screening",
    "StandOptions",
    "Standing",
    "Stood",
    "best_scene",
    "candidate_at",
    "candidates_of",
    "in_the_way",
    "in_words",
    "in_world",
    "lift_height",
    "places_of",
    "scene_at",
    "screen",
    "stances_csv",
    "stand",
]
