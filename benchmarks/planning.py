"""What planning a shipped scene costs, from the command to its stages, and simulating it."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass

from measure import command, process_time, wall_time
from solvers.cases import guess_of

from cmbot import load_scene
from cmbot.planning import plan
from cmbot.planning.torque.decomposition import optimise
from cmbot.scene import Scene
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
        The problem with sliding via-points, all stages, by the sparse solver and by SLSQP.
    peak, peak_slsqp : float, Nm
        Of their trajectories.
    core : float
        The problem with fixed via-points, all stages, by the sparse solver.
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
    core: float
    simulate: float
    simulated: float


def planned(name: str, repeats: int = 3) -> Planned:
    """Measure a shipped scene."""
    scene = load_scene(name)
    seconds, found = process_time(lambda: plan(scene), repeats)
    way, _ = process_time(lambda: guess_of(scene, "sliding"), repeats)
    polish, peak = _optimised(scene, "sliding", "sqp", repeats)
    polish_slsqp, peak_slsqp = _optimised(scene, "sliding", "slsqp", repeats)
    core, _ = _optimised(scene, "fixed", "sqp", repeats)
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
        core=core,
        simulate=simulating,
        simulated=sum(float(motion.t[-1]) for _, motion in tracking.motions),
    )


def _optimised(scene: Scene, knots: str, solver: str, repeats: int) -> tuple[float, float]:
    """Time and peak, Nm, of a scene's torque problem, from its initial guess."""
    solved = scene.with_options(solver=solver)
    _, guess = guess_of(solved, knots)
    seconds, found = process_time(lambda: optimise(guess.problem), repeats)
    return seconds, found.passes[-1].peak_torque


def start_up(repeats: int = 3) -> dict[str, float]:
    """Wall times of fresh processes that import and end, s."""
    calls = {
        "python": "pass",
        "import cmbot": "import cmbot",
        "import cmbot.planning": "import cmbot.planning",
    }
    return {name: wall_time(command("-c", code), repeats)[0] for name, code in calls.items()}
