"""How the robot walks from one stance to another: steps, each certified, the arm as a counterweight."""

from cmbot.walking.files import WalkSamples, walk_csv, walk_data, walk_samples
from cmbot.walking.steps import Move, Step
from cmbot.walking.walk import Walk, WalkOptions, load_goal, stance_of, walk

__all__ = [
    "Move",
    "Step",
    "Walk",
    "WalkOptions",
    "WalkSamples",
    "load_goal",
    "stance_of",
    "walk",
    "walk_csv",
    "walk_data",
    "walk_samples",
]
