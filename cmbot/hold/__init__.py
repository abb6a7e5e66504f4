"""How the feet hold: the contact of a foot, what it bears, the adhesion that it needs."""

from cmbot.hold.contact import MAGNET_PRESSURE as MAGNET_PRESSURE, Contact as Contact, Gap as Gap
from cmbot.hold.foot import Foot as Foot
from cmbot.hold.holding import (
    ADHESION as ADHESION,
    CLAMP_LOAD as CLAMP_LOAD,
    LOADS as LOADS,
    AdhesionPeak as AdhesionPeak,
    FootUse as FootUse,
    Holding as Holding,
    bears as bears,
    needed_all_over as needed_all_over,
    needed_by_load as needed_by_load,
    share_of_bounds as share_of_bounds,
)
