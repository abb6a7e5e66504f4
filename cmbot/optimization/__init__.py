"""Semi-infinite min-max programs over splines: nothing of robots.

Read `program`, what is to be solved, then `exchange`, how: `separation` finds violated constraints,
`constraint_set` keeps them, `evaluation` gives a program's derivatives, `sqp` and `slsqp` step.
"""

from cmbot.optimization.constraint_set import OBJECTIVE as OBJECTIVE, ConstraintSet as ConstraintSet
from cmbot.optimization.exchange import (
    ExchangeOptions as ExchangeOptions,
    ExchangeReport as ExchangeReport,
    meet_constraints as meet_constraints,
    minimize_peak as minimize_peak,
)
from cmbot.optimization.least_distance import nearest as nearest
from cmbot.optimization.linearization import linearize as linearize
from cmbot.optimization.program import (
    KinematicBound as KinematicBound,
    Linearization as Linearization,
    StateFunction as StateFunction,
    StateSamples as StateSamples,
)
from cmbot.optimization.qp import piqp_module as piqp_module
from cmbot.optimization.separation import Separation as Separation, find_violations as find_violations
from cmbot.optimization.sqp import SqpOptions as SqpOptions
