"""The paper's experiments with our robot: planned with several options, and simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from chang2021.paper import PAPER, AxisErrors, PaperExperiment
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError, PlanningError
from cmbot.planning import MotionMetrics, Plan, Progress, plan
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.simulation import MotionTracking, SimulationOptions, Tracking, simulate
from cmbot.toolpath import SpeedProfile

# Of the stiffness of guardrail and links, with which plans are simulated.
FACTORS = (1.0, 0.9, 1.1, 0.8, 1.2, 0.7, 1.3)
QUICK_FACTORS = (1.0, 0.7, 1.3)  # the modelled stiffness and the extremes


def unoptimised(tracking: Tracking) -> MotionTracking:
    """The motion without optimisation that was simulated; the study's scenes ask for it."""
    if tracking.baseline is None:
        raise InputError("tracking", "baseline", "none", "the paper's motion: planner.baseline: paper")
    return tracking.baseline


def unoptimised_figures(plan: Plan) -> MotionMetrics:
    """The figures of the motion without optimisation at work; the study's scenes ask for it."""
    if plan.baseline is None:
        raise InputError(plan.scene.source, "planner.baseline", "none", "paper")
    return plan.baseline.figures


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One plan and its simulations: started in static equilibrium, and released undeformed.

    `others` start in equilibrium with another stiffness than the modelled one.
    """

    plan: Plan
    equilibrium: Tracking
    undeformed: Tracking
    others: tuple[Tracking, ...] = ()

    @property
    def torque_difference(self) -> float:
        """Largest difference of the torque on the guardrail, baseline less planned, Nm."""
        difference = self.plan.largest_torque_difference
        return np.nan if difference is None else difference[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """The scene planned with another option, and its simulations; without a plan `why_not` has the reason."""

    plan: Plan | None
    trackings: tuple[Tracking, ...]
    why_not: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """One experiment: the paper's figures and ours."""

    paper: PaperExperiment
    planned: Run  # as the shipped scene has it: via-points that slide along the self-motion
    fixed: Run | None  # with fixed via-points, the paper's Eq. (30); None where there is no such plan
    why_not: str  # why there is none
    compensated: Variant  # with the predicted sag compensated, simulated with several stiffnesses
    quiet: Variant  # with quiet time laws in place of the paper's, simulated with several stiffnesses
    least_sag: Variant | None  # the sag as the objective in place of the torque; None where left out


@dataclass(frozen=True, kw_only=True, eq=False)
class Reproduction:
    """Both experiments, and the options of the simulations that start in equilibrium."""

    experiments: tuple[Experiment, ...]
    options: SimulationOptions


def reproduce(
    options: SimulationOptions | None = None,
    *,
    factors: Sequence[float] = FACTORS,
    least_sag: bool = True,
    on_step: Callable[[str, str, float], None] | None = None,
    progress: Callable[[str, Progress], None] | None = None,
) -> Reproduction:
    """Plan and simulate both of the paper's experiments.

    Parameters
    ----------
    options : SimulationOptions, optional
        Every run is also simulated with ``initial="undeformed"``.
    factors : sequence of float
        Of the stiffness of guardrail and links together, in place of the options', with which the
        baseline, the sliding plan, the compensated and the quiet one are simulated.
    least_sag : bool
        Plan with the sag as the objective, too.
    on_step : callable, optional
        Called with the scene's name, the present step, and the share of all steps that is done.
    progress : callable, optional
        Called with the scene's name and the planner's progress.

    Raises
    ------
    PlanningError
        When a shipped scene has no plan.
    SimulationDiverged
        When a motion cannot be integrated.
    """
    options = replace(options or SimulationOptions(), initial="equilibrium")
    starts = (options, replace(options, initial="undeformed"))
    stiffnesses = tuple(replace(options, guardrail_factor=x, link_factor=x) for x in factors)
    # Plans and simulations: sliding, fixed, compensated, quiet, of least sag.
    others = tuple(each for each in stiffnesses if each.guardrail_factor != 1.0)
    total = len(PAPER) * (3 + len(others) + 3 + 2 * (1 + len(stiffnesses)) + 2 * least_sag)
    bench = _Bench(on_step=on_step or (lambda *_: None), progress=progress, total=total)
    experiments = []
    for paper in PAPER:
        scene = load_scene(paper.scene_file)
        sliding = bench.run(scene, "sliding via-points", (*starts, *others), scene.planner)
        variant = partial(bench.variant, scene)
        fixed = variant("fixed via-points", starts, knots="fixed")
        experiments.append(
            Experiment(
                paper=paper,
                planned=_released(*sliding),
                fixed=None if fixed.plan is None else _released(fixed.plan, fixed.trackings),
                why_not=fixed.why_not,
                compensated=variant("sag compensation", stiffnesses, compensate=True),
                quiet=bench.variant(_quiet(scene), "quiet time laws", stiffnesses),
                least_sag=variant("least sag", (options,), objective="sag") if least_sag else None,
            )
        )
    return Reproduction(experiments=tuple(experiments), options=options)


def _quiet(scene: Scene) -> Scene:
    """The scene with quiet time laws in the same seconds."""
    law = SpeedProfile(kind="quiet", ramp=0.3)
    return scene.with_path(speed_profile=law)


def _released(planned: Plan, trackings: tuple[Tracking, ...]) -> Run:
    equilibrium, undeformed, *others = trackings
    return Run(plan=planned, equilibrium=equilibrium, undeformed=undeformed, others=tuple(others))


def reduction(without: FloatArray, planned: FloatArray) -> FloatArray:
    """Return the reduction of magnitudes (k,), per cent."""
    return np.asarray(100 * (1 - np.abs(planned) / np.abs(without)))


def axes(motion: MotionTracking) -> AxisErrors:
    """Return mean and standard deviation of a motion's error."""
    total = motion.metrics.total
    return AxisErrors(mean=total.mean[:3], standard_deviation=total.standard_deviation[:3])


@dataclass(kw_only=True)
class _Bench:
    """Plans and simulates scenes, and reports the share of all steps, `total` plans and simulations."""

    on_step: Callable[[str, str, float], None]
    progress: Callable[[str, Progress], None] | None
    total: int
    done: int = 0

    def run(
        self, scene: Scene, about: str, simulated: tuple[SimulationOptions, ...], planner: PlannerOptions
    ) -> tuple[Plan, tuple[Tracking, ...]]:
        """Plan, then simulate with each of the options; all these steps count as done even after an error."""
        first = self.done
        self.done += 1 + len(simulated)
        self.on_step(scene.name, about, first / self.total)
        progress = None if self.progress is None else partial(self.progress, scene.name)
        planned = plan(scene, options=planner, progress=progress)
        trackings = []
        for number, options in enumerate(simulated, start=first + 1):
            released = ", released undeformed" if options.initial == "undeformed" else ""
            what = f"{about}: simulating, stiffness times {options.link_factor:g}{released}"

            def share(done: float, before: int = number, what: str = what) -> None:
                self.on_step(scene.name, what, (before + done) / self.total)

            share(0.0)
            trackings.append(simulate(planned, options, progress=share))
        return planned, tuple(trackings)

    def variant(
        self, scene: Scene, about: str, simulated: tuple[SimulationOptions, ...], **changes: Any
    ) -> Variant:
        """Do the same with changed planner options, where a plan may be impossible."""
        try:
            planned, trackings = self.run(scene, about, simulated, replace(scene.planner, **changes))
        except PlanningError as error:
            return Variant(plan=None, trackings=(), why_not=str(error))
        return Variant(plan=planned, trackings=trackings, why_not="")
