"""Options of the elastic simulation: the same names in Python and in ``tracking.json``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from pydantic import ConfigDict, Field

__all__ = ["SimulationOptions"]

Factor = Annotated[float, Field(ge=1e-6, le=1e6)]


@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """How a motion is simulated; every option has a default.

    The bounds in the annotations are checked by `cmbot.simulate`.

    Attributes
    ----------
    step_s : float
        Longest step of the integrator, s.
    output_step_s : float
        Step of the tracking errors, s.
    settle_s : float
        Simulated time after the joints have stopped, s.
    damping : float
        Ratio of every mode in the motion's first posture. The paper gives none.
    initial : str
        ``equilibrium``: the arm starts at rest, bent under its weight. ``undeformed``: it starts straight.
    segments : int
        Elastic joints per link tube.
    guardrail_factor, link_factor, joint_factor : float
        Of the stiffness of the guardrail, of the links and of the joints.
    payload_kg : float or None
        Point mass at the tool in place of the scene's; the motion stays the same.
    spectral_radius : float
        rho_inf of the generalized-alpha method: the factor by which a step damps what it cannot resolve.
    corrections : int
        Newton corrections a step at most: steps in which a second one gains nothing have one.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    step_s: Annotated[float, Field(ge=1e-5, le=0.02)] = 0.002
    output_step_s: Annotated[float, Field(ge=1e-4, le=0.02)] = 0.005
    settle_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    damping: Annotated[float, Field(ge=0, lt=1)] = 0.01
    initial: Literal["equilibrium", "undeformed"] = "equilibrium"
    segments: Annotated[int, Field(ge=1, le=8)] = 1
    guardrail_factor: Factor = 1.0
    link_factor: Factor = 1.0
    joint_factor: Factor = 1.0
    payload_kg: Annotated[float, Field(ge=0, le=1e4)] | None = None
    spectral_radius: Annotated[float, Field(ge=0, le=1)] = 0.8
    corrections: Annotated[int, Field(ge=1, le=10)] = 2
