"""Options of the elastic simulation: the same names in Python and in ``tracking.json``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from cmbot.common.errors import InputError
from cmbot.common.reading.validation import CheckedFields, refusal
from cmbot.common.representation import ShortRepr

Bandwidth = Annotated[float, Field(ge=0.1, le=200)]
Factor = Annotated[float, Field(ge=1e-6, le=1e6)]


def _share(ratio: object) -> object:
    """A damping below the critical one; what is more is likely in per cent, as it is printed."""
    if isinstance(ratio, float | int) and ratio >= 1:
        raise refusal(f"a share of what is critical, less than 1: {ratio / 100:g} is {ratio:g} %", got=ratio)
    return ratio


@dataclass(frozen=True, kw_only=True)
class SimulationOptions(CheckedFields, ShortRepr):
    """How a motion is simulated; every option has a default.

    Attributes
    ----------
    step_s : float
        Longest step of the integrator, s; up to eight times that where it changes hardly anything: by 1e-10 m
        a step.
    output_step_s : float
        Step of the tracking errors, s.
    settle_s : float
        Simulated time after the joints have stopped, s.
    damping : float or None
        Ratio of every mode in the motion's first posture; None: as identified, otherwise 0.01. The paper
        gives none.
    initial : str
        ``equilibrium``: the arm starts at rest, bent under its weight. ``undeformed``: it starts straight.
    segments : int
        Elastic joints per link tube.
    guardrail_factor, link_factor, joint_factor : float
        Of the stiffness of the guardrail, of the links and of the joints.
    stiffness_share : float
        By which all stiffness may be more or less: both motions are simulated at both ends of this interval,
        too. 0: at the stated stiffness alone.
    payload_kg : float or None
        Point mass at the tool in place of the scene's; the motion stays the same.
    set_point_rate_hz : float or None
        At which a controller is given set-points; None: it knows the motion at all times.
    set_points : str
        Between them the command is ``interpolated``, linearly, or ``held``.
    servo_bandwidth_hz : tuple of float or None
        One for all joints, or one for each: a Butterworth filter of second order. None: joints follow
        exactly.
    delay_s : float
        By which the joints follow late, s.
    spectral_radius : float
        rho_inf of the generalized-alpha method: the factor by which a step damps what it cannot resolve.
    corrections : int
        Newton corrections a step at most: steps in which a second one gains nothing have one.
    """

    step_s: Annotated[float, Field(ge=1e-5, le=0.02)] = 0.002
    output_step_s: Annotated[float, Field(ge=1e-4, le=0.02)] = 0.005
    settle_s: Annotated[float, Field(ge=0, le=60)] = 2.0
    damping: Annotated[float, Field(ge=0, lt=1), BeforeValidator(_share)] | None = None
    initial: Literal["equilibrium", "undeformed"] = "equilibrium"
    segments: Annotated[int, Field(ge=1, le=8)] = 1
    guardrail_factor: Factor = 1.0
    link_factor: Factor = 1.0
    joint_factor: Factor = 1.0
    stiffness_share: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    payload_kg: Annotated[float, Field(ge=0, le=1e4)] | None = None
    set_point_rate_hz: Annotated[float, Field(ge=1, le=1e4)] | None = None
    set_points: Literal["interpolated", "held"] = "interpolated"
    servo_bandwidth_hz: Annotated[tuple[Bandwidth, ...], Field(min_length=1, max_length=100)] | None = None
    delay_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    spectral_radius: Annotated[float, Field(ge=0, le=1)] = 0.8
    corrections: Annotated[int, Field(ge=1, le=10)] = 2

    def damping_or(self, ratio: float) -> float:
        """Return the damping asked for; where none is, the `ratio` of the robot."""
        return ratio if self.damping is None else self.damping

    def _check(self) -> None:
        if self.set_point_rate_hz is not None and self.servo_bandwidth_hz is None:
            expected = "a number beside set_point_rate_hz: without a servo the joints would jump"
            raise InputError("SimulationOptions", "servo_bandwidth_hz", "nothing", expected)
