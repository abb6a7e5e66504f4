"""How the feet hold: the contact of a foot, what it bears, the adhesion that it needs."""

from cmbot.hold.contact import MAGNET_PRESSURE, Contact, Gap
from cmbot.hold.foot import Foot
from cmbot.hold.holding import ADHESION, CLAMP_LOAD, AdhesionPeak, Holding, needed_by_load

__all__ = [
    "ADHESION",
    "CLAMP_LOAD",
    "MAGNET_PRESSURE",
    "AdhesionPeak",
    "Contact",
    "Foot",
    "Gap",
    "Holding",
    "needed_by_load",
]
