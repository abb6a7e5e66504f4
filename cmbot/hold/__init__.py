"""How the feet hold: the contact of a foot, what it bears, the adhesion that it needs."""

from cmbot.hold.adhesion import AdhesionPeak, Holding
from cmbot.hold.foot import Foot, mean_distance

__all__ = ["AdhesionPeak", "Foot", "Holding", "mean_distance"]
