"""The paper's experiments with our robot: planned and simulated, twice each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PlanningError
from cmbot.planning import Plan, Progress, plan
from cmbot.reproduction.paper import PAPER, PaperExperiment
from cmbot.reproduction.steps import Steps
from cmbot.scene import PlannerOptions, Scene, load_scene
from cmbot.simulation import MotionTracking, SimulationOptions, Tracking, simulate

__all__ = [
    "FACTORS",
    "QUICK_FACTORS",
    "Experiment",
    "Reproduction",
    "Run",
    "Variant",
    "axes",
    "reduction",
    "reproduce",
]

FACTORS = (1.0, 0.9, 1.1, 0.8, 1.2, 0.7, 1.3)
"""Of the stiffness of guardrail and links, with which a compensated plan is simulated."""
QUICK_FACTORS = (1.0, 0.7, 1.3)
"""The least that shows how far it goes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """One plan and its simulations.

    Attributes
    ----------
    plan : Plan
    equilibrium, undeformed : Tracking
        Started hanging at rest, and started straight and let go.
    """

    plan: Plan
    equilibrium: Tracking
    undeformed: Tracking

    @property
    def torque_difference(self) -> float:
        """Largest difference of the torque on the guardrail, baseline less planned, Nm."""
        return self.plan.largest_torque_difference[0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Variant:
    """The scene planned with another option.

    Attributes
    ----------
    plan : Plan or None
        None where there is no such plan.
    trackings : tuple of Tracking
        All of them started in equilibrium.
    why_not : str
        Why there is no plan.
    """

    plan: Plan | None
    trackings: tuple[Tracking, ...]
    why_not: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """One experiment: the paper's figures and ours.

    Attributes
    ----------
    paper : PaperExperiment
    planned : Run
        As the shipped scene says: via-points that slide along the self-motion.
    fixed : Run or None
        With the via-points fixed, as the paper's Eq. (30) has it; None where there is no such plan.
    why_not : str
        Why there is none.
    compensated : Variant
        With the predicted sag compensated, simulated with other stiffnesses, too.
    loud : Variant
        With no elastic mode quieted.
    least_sag : Variant or None
        With the sag made small in place of the torque; None where it was left out.
    """

    paper: PaperExperiment
    planned: Run
    fixed: Run | None
    why_not: str
    compensated: Variant
    loud: Variant
    least_sag: Variant | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Reproduction:
    """Both experiments.

    Attributes
    ----------
    experiments : tuple of Experiment
    options : SimulationOptions
        Of the simulations that start in equilibrium.
    """

    experiments: tuple[Experiment, ...]
    options: SimulationOptions


def reproduce(
    options: SimulationOptions | None = None,
    *,
    factors: Sequence[float] = FACTORS,
    least_sag: bool = True,
    tell: Callable[[str, str, float], None] | None = None,
    progress: Callable[[str, Progress], None] | None = None,
) -> Reproduction:
    """Plan and simulate both of the paper's experiments.

    Parameters
    ----------
    options : SimulationOptions, optional
        Every run is also simulated with ``initial="undeformed"``.
    factors : sequence of float
        Of the stiffness of guardrail and links together, in place of the options', with which the
        compensated plan and the baseline are simulated.
    least_sag : bool
        Plan with the sag as the objective, too.
    tell : callable, optional
        Called with the scene's name, what is being done, and the share of all steps that is done.
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
    softer = tuple(replace(options, guardrail_factor=x, link_factor=x) for x in factors)
    # Plans and simulations: sliding, fixed, compensated, loud, of least sag.
    steps = Steps(tell or (lambda *_: None), len(PAPER) * (3 + 3 + (1 + len(softer)) + 2 + 2 * least_sag))
    experiments = []
    for paper in PAPER:
        scene = load_scene(paper.scene)
        report = None if progress is None else _about(progress, paper.scene)
        bench = _Bench(scene=scene, steps=steps, report=report)
        with steps.run(paper.scene, "via-points that slide", 3):
            planned = bench.run(scene.planner, options)
        fixed, why_not = None, ""
        try:
            with steps.run(paper.scene, "via-points that are fixed", 3):
                fixed = bench.run(replace(scene.planner, knots="fixed"), options)
        except PlanningError as error:
            why_not = str(error)
        compensated = bench.variant("sag compensated", replace(scene.planner, compensate=True), softer)
        loud = bench.variant("no mode quieted", replace(scene.planner, quiet_modes=0), (options,))
        sagging = replace(scene.planner, objective="sag")
        experiments.append(
            Experiment(
                paper=paper,
                planned=planned,
                fixed=fixed,
                why_not=why_not,
                compensated=compensated,
                loud=loud,
                least_sag=bench.variant("least sag", sagging, (options,)) if least_sag else None,
            )
        )
    return Reproduction(experiments=tuple(experiments), options=options)


def reduction(without: FloatArray, planned: FloatArray) -> FloatArray:
    """Return by how much magnitudes (k,) become smaller, per cent."""
    return np.asarray(100 * (1 - np.abs(planned) / np.abs(without)))


@dataclass(frozen=True, kw_only=True)
class _Bench:
    """One scene, planned with some options and simulated with others."""

    scene: Scene
    steps: Steps
    report: Callable[[Progress], None] | None

    def run(self, planner: PlannerOptions, options: SimulationOptions) -> Run:
        planned = plan(self.scene, options=planner, progress=self.report)
        equilibrium = self._simulated(planned, options, "simulating")
        released = replace(options, initial="undeformed")
        undeformed = self._simulated(planned, released, "simulating, let go undeformed")
        return Run(plan=planned, equilibrium=equilibrium, undeformed=undeformed)

    def variant(
        self, about: str, planner: PlannerOptions, simulated: tuple[SimulationOptions, ...]
    ) -> Variant:
        try:
            with self.steps.run(self.scene.name, about, 1 + len(simulated)):
                planned = plan(self.scene, options=planner, progress=self.report)
                trackings = tuple(
                    self._simulated(planned, options, f"simulating, stiffness times {options.link_factor:g}")
                    for options in simulated
                )
        except PlanningError as error:
            return Variant(plan=None, trackings=(), why_not=str(error))
        return Variant(plan=planned, trackings=trackings, why_not="")

    def _simulated(self, planned: Plan, options: SimulationOptions, what: str) -> Tracking:
        self.steps.next(what)
        return simulate(planned, options, progress=self.steps.within)


def _about(progress: Callable[[str, Progress], None], scene: str) -> Callable[[Progress], None]:
    return lambda step: progress(scene, step)


def axes(motion: MotionTracking) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of a motion's error along x, y and z, both (3,), m."""
    total = motion.figures.total
    return total.mean[:3], total.standard_deviation[:3]
