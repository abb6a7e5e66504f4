"""Where to stand: candidates along the guardrail, screened and ranked, the best planned."""

from cmbot.stances.candidates import (
    APART,
    REACH,
    Candidate,
    candidate_at,
    candidates_of,
    own_candidate,
    places_of,
)
from cmbot.stances.footholds import bare_climber, in_the_way, lift_height, without_links
from cmbot.stances.placed_scene import in_world, joined, scene_at
from cmbot.stances.screening import Screening, screen
from cmbot.stances.search import StandOptions, Stood
from cmbot.stances.standing import (
    Standing,
    best_scene,
    require_on_guardrail,
    require_planned,
    require_standing,
    stand,
)
from cmbot.stances.table import bounds_table, in_words, planned_table, shared_out, stances_csv

__all__ = [
    "APART",
    "REACH",
    "Candidate",
    "Screening",
    "StandOptions",
    "Standing",
    "Stood",
    "bare_climber",
    "best_scene",
    "bounds_table",
    "candidate_at",
    "candidates_of",
    "in_the_way",
    "in_words",
    "in_world",
    "joined",
    "lift_height",
    "own_candidate",
    "places_of",
    "planned_table",
    "require_on_guardrail",
    "require_planned",
    "require_standing",
    "scene_at",
    "screen",
    "shared_out",
    "stances_csv",
    "stand",
    "without_links",
]
