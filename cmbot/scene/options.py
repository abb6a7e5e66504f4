"""Options of the planner: the same names in a scene file's ``planner:`` block and in Python."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field

from cmbot.common.reading.fields import MILLIMETRES, no_thousands
from cmbot.common.reading.validation import CheckedFields, refusal, shown
from cmbot.common.representation import ShortRepr
from cmbot.toolpath import AUTO

MOST_SAMPLES = 400
"""Samples per segment at most."""


def _not_all_zero(weights: tuple[float, ...]) -> tuple[float, ...]:
    if max(weights) <= 0:
        raise refusal("a list with at least one number above 0", got=list(weights))
    return weights


AxisWeight = Annotated[float, Field(ge=0, le=1e6)]
AxisWeights = Annotated[tuple[AxisWeight, AxisWeight, AxisWeight], AfterValidator(_not_all_zero)]


def _auto_or_bool(value: object) -> object:
    if value == AUTO or isinstance(value, bool):
        return value
    raise refusal("auto, true or false", got=shown(value))


AutoOrBool = Annotated[Literal["auto"] | bool, BeforeValidator(_auto_or_bool)]


@dataclass(frozen=True, kw_only=True)
class PlannerOptions(CheckedFields, ShortRepr):
    """How a motion is planned; every option has a default.

    Attributes
    ----------
    knots : str
        ``sliding``: the via-points move in the null space of the task to where the objective is least.
        ``fixed``: they stay on the gradient-projection path (Chang 2021, Eq. (30) to the letter).
    start : str
        With sliding knots. ``free``: the arm first goes to a better posture with the same tool pose, where
        that gains `min_gain`. The peak of that approach may be at most as much above that of the whole job
        from the scene's posture. ``pinned``: the arm begins in the scene's posture, as long as a path leads
        on from there.
    objective : str
        What is minimised. ``torque``: the norm of the torque on the base, Eq. (12); ``sag``: the tool's
        sag at rest; ``hold``: the largest adhesion that a foot needs; ``sway``: the tool's RMS by 1 m/s2 of
        the deck. ``travel``: nothing of the base, but
        how far the joints travel between via-points, and their jerk.
    moment_about : str
        The point about which the torque is taken. ``foot``: O0, n_0. ``base``: the origin of the arm's base
        frame, n_1 without the lever of Eq. (12).
    axis_weights : three floats
        Factors of the torque's components along x, y and z of W in its norm.
    compensate : bool or str
        The tool that is held to the path is the bent arm's, by its predicted sag. ``auto``: wherever
        something bends. A plan's options name what was used.
    deviation_sigmas : float
        With `compensate` and an identified stiffness: the bent tool keeps its deviation even if its sag is
        off by this many standard deviations.
    quiet_modes : int
        With sliding knots: number of elastic modes, the slowest first, that are brought to rest at the ends
        of legs, where that pays.
    quiet_stiffness_share : float
        Share by which all stiffness may differ from the modelled one there. With an identified stiffness it
        is at most two standard deviations.
    baseline : str
        The motion without optimisation that the plan is compared with. ``paper``: Chang 2021, Eq. (22), from
        the scene's posture, by the paper's trapezoid in the same time where the plan's law is quiet: it
        cruises at another speed. ``straight``: least-norm steps along the same path, timed there as the plan,
        which is Eq. (22) without its part in the null space. ``none``: the figures stand alone.
    avoidance : str
        ``smooth``: the clearance gradient fades in, and blends from one near pair to the next. ``switch``:
        Eq. (17) to the letter; joint rates jump.
    avoidance_distance_m : float
        d_s of Eq. (17), m.
    avoidance_gain : float
        beta of Eqs. (16) and (22), rad/s.
    centre_of_gravity_weight : float
        Weight of the second term of H, which pulls the arm's centre of mass towards the foot.
    damping_max : float
        lambda_0 of Eq. (21).
    damping_threshold : float
        s_h of Eq. (21): smallest singular value below which damping sets in.
    drift_gain : float
        Feedback from the tool's pose error to its commanded velocity along the path, 1/s.
    path_step_s : float
        Step at which Eq. (22) is integrated, s.
    other_starts : int
        Where no path leads on from the scene's posture: most other postures with the same tool pose that are
        tried; 0 keeps the scene's.
    chart_spacing : float
        Distance between neighbouring postures of a chart of self-motion, rad.
    chart_seeds : int
        Random postures from which the first chart is grown.
    step_share : float
        Share of the velocity bounds that the global search lets joints use between via-points; smaller ones
        are tried where no trajectory follows.
    safety_margin_m : float
        Smallest clearance that a plan may have, m.
    max_tool_deviation_m : float
        Largest distance of the tool point from the leg of its time, m.
    max_tool_rotation_deg : float
        Largest angle by which the tool may miss its prescribed orientation or axis between via-points.
    max_tool_lag_m : float
        Largest distance of the tool point from its timed place along the leg, between via-points.
    solver : str
        ``sqp``: sequential quadratic programming on sparse matrices; needs the extra ``fast``.
        ``slsqp``: SciPy's, on dense ones. ``auto``: ``sqp``, and ``slsqp`` where PIQP is not installed or
        ``sqp`` fails.
    samples_per_segment : int
        Samples per spline segment at which nonlinear constraints are checked for violations.
    smoothing_weight : float
        Weight of half the mean squared jerk and velocity beside half the mean square of the objective, all
        relative; decides between motions of nearly equal torque. The larger it is, the less the tool sways at
        work, for a mean torque that is larger by less than 1 % as a rule.
    peak_tolerance : float
        The peak may exceed its lower bound by this share; the mean square is minimised below that.
    least_peak_tolerance : float
        Where the lower bound is missed the peak may exceed the least that was found by this share.
    min_gain : float
        The arm leaves the scene's posture only where that lowers the peak or the mean along the path, at
        rest, by this share.
    constraint_tolerance : float
        Relative violation below which the optimiser takes a constraint for met.
    time_limit_s : float
        Time after which nothing new is begun; the best motion so far is returned.
    max_passes : int
        Most exchange iterations.
    max_iterations : int
        Most iterations of the solver in each of them (the paper's bound).

    Raises
    ------
    InputError
        When an option is of another type, or out of its bounds.
    """

    knots: Literal["sliding", "fixed"] = "sliding"
    start: Literal["free", "pinned"] = "free"
    objective: Literal["torque", "sag", "hold", "sway", "travel"] = "torque"
    moment_about: Literal["foot", "base"] = "foot"
    axis_weights: AxisWeights = (1.0, 1.0, 1.0)
    compensate: AutoOrBool = "auto"
    deviation_sigmas: Annotated[float, Field(ge=0, le=10)] = 0.0
    quiet_modes: Annotated[int, Field(ge=0, le=10)] = 2
    quiet_stiffness_share: Annotated[float, Field(ge=0, le=0.9)] = 0.3
    baseline: Literal["paper", "straight", "none"] = "none"
    avoidance: Literal["smooth", "switch"] = "smooth"
    avoidance_distance_m: Annotated[float, Field(ge=1e-4, le=10)] = 0.15
    avoidance_gain: Annotated[float, Field(ge=0, le=1000)] = 2.0
    centre_of_gravity_weight: Annotated[float, Field(ge=0, le=1000)] = 0.0
    damping_max: Annotated[float, Field(ge=0, le=1000)] = 0.5
    damping_threshold: Annotated[float, Field(ge=0, le=1000)] = 0.1
    drift_gain: Annotated[float, Field(ge=0, le=1000)] = 10.0
    path_step_s: Annotated[float, Field(ge=1e-4, le=0.1)] = 0.01
    other_starts: Annotated[int, Field(ge=0, le=10_000)] = 60
    chart_spacing: Annotated[float, Field(ge=0.01, le=0.5)] = 0.15
    chart_seeds: Annotated[int, Field(ge=1, le=10_000)] = 200
    step_share: Annotated[float, Field(ge=1e-6, le=1)] = 0.6
    safety_margin_m: Annotated[float, Field(ge=0, le=1e3), no_thousands(1, MILLIMETRES)] = 0.02
    max_tool_deviation_m: Annotated[float, Field(ge=1e-7, le=0.1)] = 0.0002
    max_tool_rotation_deg: Annotated[float, Field(ge=1e-5, le=180)] = 1.0
    max_tool_lag_m: Annotated[float, Field(ge=1e-7, le=1)] = 0.02
    solver: Literal["auto", "sqp", "slsqp"] = "auto"
    samples_per_segment: Annotated[int, Field(ge=4, le=MOST_SAMPLES)] = 40
    smoothing_weight: Annotated[float, Field(ge=1e-9, le=100)] = 3.0
    peak_tolerance: Annotated[float, Field(ge=1e-9, le=0.1)] = 1e-4
    least_peak_tolerance: Annotated[float, Field(ge=1e-9, le=0.1)] = 2e-3
    min_gain: Annotated[float, Field(ge=0, le=100)] = 0.02
    constraint_tolerance: Annotated[float, Field(ge=1e-9, le=1e-4)] = 1e-5
    time_limit_s: Annotated[float, Field(ge=1e-3, le=1e6)] = 60.0
    max_passes: Annotated[int, Field(ge=1, le=10_000)] = 80
    max_iterations: Annotated[int, Field(ge=1, le=100_000)] = 1000

    @property
    def stays(self) -> bool:
        """Whether the work begins in the scene's posture; else the arm may only wait there, its tool off."""
        return self.start == "pinned" or self.knots == "fixed"
