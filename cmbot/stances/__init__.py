"""Where to stand: candidates along the guardrail, screened and ranked, the best planned."""

from cmbot.stances.bounds import NO_FIGURES, Bounds, StanceFigures, StanceObjective
from cmbot.stances.candidates import (
    AnyCandidate,
    Candidate,
    MountCandidate,
    bare_climber,
    candidate_at,
    candidates_of,
    in_the_way,
    lift_height,
    on_two_feet,
    own_candidate,
    place_in_words,
    places_of,
    without_links,
)
from cmbot.stances.placed_scene import in_world, joined, put_away, scene_at
from cmbot.stances.ranking import (
    StanceRanking,
    best_scene,
    require_on_guardrail,
    require_planned,
    require_standing,
    stand,
)
from cmbot.stances.screening import Screener
from cmbot.stances.search import Rejection, StanceResult, StandOptions
from cmbot.stances.table import bounds_table, in_words, planned_table, shared_out, stances_csv

__all__ = [
    "NO_FIGURES",
    "AnyCandidate",
    "Bounds",
    "Candidate",
    "MountCandidate",
    "Rejection",
    "Screener",
    "StanceFigures",
    "StanceObjective",
    "StanceRanking",
    "StanceResult",
    "StandOptions",
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
    "on_two_feet",
    "own_candidate",
    "place_in_words",
    "places_of",
    "planned_table",
    "put_away",
    "require_on_guardrail",
    "require_planned",
    "require_standing",
    "scene_at",
    "shared_out",
    "stances_csv",
    "stand",
    "without_links",
]
