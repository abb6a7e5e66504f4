"""Which solver a plan is made with."""

from __future__ import annotations

from typing import Literal

from cmbot.common.errors import MissingExtra
from cmbot.optimization import piqp_module
from cmbot.scene import PlannerOptions

__all__ = ["solver_of"]


def solver_of(options: PlannerOptions) -> Literal["sqp", "slsqp"]:
    """Return the solver that the options ask for, or with ``auto`` the best that is installed.

    Raises
    ------
    MissingExtra
        When it is ``sqp`` and PIQP is not installed.
    """
    if options.solver == "slsqp":
        return "slsqp"
    try:
        piqp_module()
    except MissingExtra:
        if options.solver == "auto":
            return "slsqp"
        raise
    return "sqp"
