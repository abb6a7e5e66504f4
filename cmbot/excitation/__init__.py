"""What shakes an arm: the deck under it, trains over it, wind; how its tool sways, and what helps."""

from cmbot.excitation.excite import Excitation as Excitation, excite as excite
from cmbot.excitation.ground import require_inputs as require_inputs
from cmbot.excitation.summary import (
    PASSAGE_HEADINGS as PASSAGE_HEADINGS,
    excitation_rows as excitation_rows,
    excitation_sentences as excitation_sentences,
    passage_rows as passage_rows,
    random_inputs as random_inputs,
)
from cmbot.excitation.sway import sway_mm_per_m_s2 as sway_mm_per_m_s2
