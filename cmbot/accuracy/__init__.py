"""Where the tool is: the budget of what moves it from its path, over a whole job."""

from __future__ import annotations

from cmbot.accuracy.budget import Accuracy, AccuracyPart, Remedy, Shaking, Work, WorkPath, accuracy_of
from cmbot.accuracy.parts import Part, parts_of
from cmbot.accuracy.quietness import Quietness, quietness_of
from cmbot.accuracy.sway import Sway, stroke_sway, sway_along

__all__ = [
    "Accuracy",
    "AccuracyPart",
    "Part",
    "Quietness",
    "Remedy",
    "Shaking",
    "Sway",
    "Work",
    "WorkPath",
    "accuracy_of",
    "parts_of",
    "quietness_of",
    "stroke_sway",
    "sway_along",
]
