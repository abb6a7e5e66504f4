"""The torque problem (Chang 2021, Section 3.2): read `problem`, then `decomposition`."""

from cmbot.planning.torque.decomposition import Optimised, optimise
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through

__all__ = ["Optimised", "TorqueProblem", "optimise", "parametrization_through"]
