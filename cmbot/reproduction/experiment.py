"""The paper's experiments with our robot: planned and simulated, twice each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np

from cmbot.arrays import FloatArray
from cmbot.errors import PlanningError
from cmbot.planning import Plan, Progress, plan
from cmbot.reproduction.paper import PAPER, PaperExperiment
from cmbot.scene import load_scene
from cmbot.simulation import MotionTracking, SimulationOptions, Tracking, simulate

__all__ = ["Experiment", "Reproduction", "Run", "axes", "reduction", "reproduce"]


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
    """

    paper: PaperExperiment
    planned: Run
    fixed: Run | None
    why_not: str


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
    tell: Callable[[str, str, float], None] | None = None,
    progress: Callable[[str, Progress], None] | None = None,
) -> Reproduction:
    """Plan and simulate both of the paper's experiments.

    Parameters
    ----------
    options : SimulationOptions, optional
        Every run is also simulated with ``initial="undeformed"``.
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
    steps, experiments = _Steps(tell or (lambda *_: None)), []
    for paper in PAPER:
        scene = load_scene(paper.scene)
        report = None if progress is None else _about(progress, paper.scene)
        with steps.run(paper.scene, "via-points that slide"):
            planned = _run(plan(scene, progress=report), options, steps)
        fixed, why_not = None, ""
        try:
            with steps.run(paper.scene, "via-points that are fixed"):
                fixed_plan = plan(scene, options=replace(scene.planner, knots="fixed"), progress=report)
                fixed = _run(fixed_plan, options, steps)
        except PlanningError as error:
            why_not = str(error)
        experiments.append(Experiment(paper=paper, planned=planned, fixed=fixed, why_not=why_not))
    return Reproduction(experiments=tuple(experiments), options=options)


def reduction(without: FloatArray, planned: FloatArray) -> FloatArray:
    """Return by how much magnitudes (k,) become smaller, per cent."""
    return np.asarray(100 * (1 - np.abs(planned) / np.abs(without)))


def _run(planned: Plan, options: SimulationOptions, steps: _Steps) -> Run:
    steps.next("simulating")
    equilibrium = simulate(planned, options, progress=steps.within)
    steps.next("simulating, let go undeformed")
    undeformed = simulate(planned, replace(options, initial="undeformed"), progress=steps.within)
    return Run(plan=planned, equilibrium=equilibrium, undeformed=undeformed)


class _Steps:
    """How much of a reproduction is done: each run is a plan and two simulations, and all count the same."""

    _A_RUN = 3

    def __init__(self, tell: Callable[[str, str, float], None]) -> None:
        self._tell, self._runs, self._step = tell, 0, 0
        self._scene, self._about, self._what = "", "", ""

    @contextmanager
    def run(self, scene: str, about: str) -> Iterator[None]:
        """Begin a run with its plan; it ends with all its steps done, even if some were left out."""
        self._scene, self._about, self._step = scene, about, -1
        self.next("")
        try:
            yield
        finally:
            self._runs += 1

    def next(self, what: str) -> None:
        """Begin the next step of a run."""
        self._step += 1
        self._what = ": ".join(filter(None, (self._about, what)))
        self.within(0.0)

    def within(self, share: float) -> None:
        """Tell the share of the present step that is done."""
        done = self._A_RUN * self._runs + self._step + share
        self._tell(self._scene, self._what, done / (2 * self._A_RUN * len(PAPER)))


def _about(progress: Callable[[str, Progress], None], scene: str) -> Callable[[Progress], None]:
    return lambda step: progress(scene, step)


def axes(motion: MotionTracking) -> tuple[FloatArray, FloatArray]:
    """Return mean and standard deviation of a motion's error along x, y and z, both (3,), m."""
    total = motion.figures.total
    return total.mean[:3], total.standard_deviation[:3]
