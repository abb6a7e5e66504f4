"""Where the tool is: the budget of what moves it from its path, over a whole job."""

from __future__ import annotations

from cmbot.accuracy.budget import (
    Accuracy as Accuracy,
    Shaking as Shaking,
    Work as Work,
    WorkPath as WorkPath,
    accuracy_of as accuracy_of,
)
from cmbot.accuracy.parts import (
    Part as Part,
    assumed_in_words as assumed_in_words,
    parts_of as parts_of,
)
from cmbot.accuracy.quietness import Quietness as Quietness, quietness_of as quietness_of
from cmbot.accuracy.sway import (
    Sway as Sway,
    ramped as ramped,
    stroke_sway as stroke_sway,
    sway_along as sway_along,
)
