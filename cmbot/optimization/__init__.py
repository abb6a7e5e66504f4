"""Semi-infinite min-max programs over splines: nothing of robots.

Read `program`, what is to be solved, then `exchange`, how: `separation` finds violated constraints,
`constraint_set` keeps them, `evaluation` gives a program's derivatives, `sqp` and `slsqp` step.
"""

from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet, Violation
from cmbot.optimization.exchange import ExchangeOptions, ExchangeReport, Result, minimize_peak
from cmbot.optimization.least_distance import nearest
from cmbot.optimization.linearization import linearize
from cmbot.optimization.program import KinematicBound, Linearization, Program, StateFunction, StateSamples
from cmbot.optimization.qp import piqp_module
from cmbot.optimization.separation import Separation, find_violations
from cmbot.optimization.sqp import SqpOptions, SqpStatus
