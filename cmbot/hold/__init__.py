"""How the feet hold: the contact of a foot, what it bears, the adhesion that it needs."""

from cmbot.hold.adhesion import ADHESION, CLAMP_LOAD, AdhesionPeak, FlatContact, Holding, needed_by_load
from cmbot.hold.foot import Foot, mean_distance

__all__ = [
    "ADHESION",
    "CLAMP_LOAD",
    "AdhesionPeak",
    "FlatContact",
    "Foot",
    "Holding",
    "mean_distance",
    "needed_by_load",
]
