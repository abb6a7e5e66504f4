"""What shakes an arm: the deck under it, trains over it, wind; how its tool sways, and what helps."""

from cmbot.excitation.excite import Excitation, Shaken, excite
from cmbot.excitation.ground import require_inputs
from cmbot.excitation.summary import (
    PASSAGE_HEADINGS,
    excitation_rows,
    excitation_sentences,
    passage_rows,
    random_inputs,
)
from cmbot.excitation.sway import RandomSway, sway_mm_per_m_s2
