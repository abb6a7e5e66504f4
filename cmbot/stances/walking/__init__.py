"""How the robot walks from one stance to another: steps, each certified, the arm as a counterweight."""

from cmbot.stances.walking.files import WalkSamples, walk_csv, walk_data, walk_samples
from cmbot.stances.walking.steps import Kind, Move, Step, blocked_end, certified_move
from cmbot.stances.walking.tour import Tour, part_data, tour, tour_data
from cmbot.stances.walking.verification import second_opinion_of
from cmbot.stances.walking.walk import Walk, WalkOptions, goal_stance, load_goal, stance_of, walk

__all__ = [
    "Kind",
    "Move",
    "Step",
    "Tour",
    "Walk",
    "WalkOptions",
    "WalkSamples",
    "blocked_end",
    "certified_move",
    "goal_stance",
    "load_goal",
    "part_data",
    "second_opinion_of",
    "stance_of",
    "tour",
    "tour_data",
    "walk",
    "walk_csv",
    "walk_data",
    "walk_samples",
]
