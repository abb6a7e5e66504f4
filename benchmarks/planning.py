"""What planning a shipped scene costs, from the command to its stages, and simulating it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace

from measure import command, process_time, wall_time
from solvers.cases import way_of

from cmbot import load_scene
from cmbot.planning import plan
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import sliding_guess
from cmbot.planning.torque.decomposition import optimise
from cmbot.simulation import simulate

__all__ = ["Planned", "planned", "start_up"]


@dataclass(frozen=True, kw_only=True)
class Planned:
    """One scene; seconds of processor time but for the command's.

    Attributes
    ----------
    scene, solver : str
        The solver that the command takes.
    motion : float, s
        What the motion takes.
    command : float, s
        Wall time of ``cmbot plan``, imports and pages included.
    plan : float
        `cmbot.plan` in a process that has done it before.
    way : float
        Charts of self-motion and the global stage.
    polish, polish_slsqp : float
        The sliding problem as plans have it, by the sparse solver and by SLSQP.
    peak, peak_slsqp : float, Nm
        Where these end.
    simulate : float
    simulated : float, s
        Motion that is simulated.
    """

    scene: str
    solver: str
    motion: float
    command: float
    plan: float
    way: float
    polish: float
    polish_slsqp: float
    peak: float
    peak_slsqp: float
    simulate: float
    simulated: float


def planned(name: str, repeats: int = 3) -> Planned:
    """Measure a shipped scene."""
    scene = load_scene(name)
    seconds, found = process_time(lambda: plan(scene), repeats)
    way, _ = process_time(lambda: way_of(scene, "sliding"), repeats)
    polish, peak = _polished(name, "sqp", repeats)
    polish_slsqp, peak_slsqp = _polished(name, "slsqp", repeats)
    simulating, tracking = process_time(lambda: simulate(found), repeats)
    with tempfile.TemporaryDirectory() as folder:
        words = ("-m", "cmbot", "plan", name, "-o", f"{folder}/{name}", "--force")
        whole, _ = wall_time(command(*words), repeats)
    return Planned(
        scene=name,
        solver=found.options.solver,
        motion=found.trajectory.duration,
        command=whole,
        plan=seconds,
        way=way,
        polish=polish,
        polish_slsqp=polish_slsqp,
        peak=peak,
        peak_slsqp=peak_slsqp,
        simulate=simulating,
        simulated=float(tracking.baseline.t[-1] + tracking.planned.t[-1]),
    )


def _polished(name: str, solver: str, repeats: int) -> tuple[float, float]:
    scene = load_scene(name)
    context = build_context(scene, replace(scene.planner, knots="sliding", solver=solver))
    way = sliding_guess(context)
    seconds, optimised = process_time(lambda: optimise(way.problem), repeats)
    return seconds, optimised.passes[-1].peak_torque


def start_up(repeats: int = 3) -> dict[str, float]:
    """Wall times of fresh processes that import and end, s."""
    calls = {
        "python": "pass",
        "import cmbot": "import cmbot",
        "import cmbot.planning": "import cmbot.planning",
    }
    return {name: wall_time(command("-c", code), repeats)[0] for name, code in calls.items()}
