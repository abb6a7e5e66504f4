"""The SQP and SLSQP are backends of one program: shipped scenes, small ones, an own objective, other arms'.

Both start at the same spline. Where they end in the same motion their objectives agree; where they end in
different ones the SQP's is no worse.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import pytest
from quadrature import gauss_points
from small_scenes import short_scene
from threadpoolctl import threadpool_limits
from urdf_arms import arm_scene, path_of, six_joint_scene

from cmbot.optimization.exchange import minimize_peak
from cmbot.optimization.program import StateSamples
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.request import build_request
from cmbot.planning.torque.decomposition import exchange_options
from cmbot.planning.torque.problem import TorqueProblem, parametrization_through
from cmbot.planning.workcell.objectives import WrenchFunction
from cmbot.scene import Scene, load_scene
from cmbot.trajectory.quintic import QuinticTrajectory

# The same optimum, as a share of it; peaks held so near to each other make objectives comparable; violations
# up to this count as met; two motions that never differ by more are the same, rad.
SAME, SAME_BOUND, MET, SAME_MOTION = 1e-3, 1e-5, 2e-5, 1e-2
# Peaks are held by so much above the least, as a share; by so much more the multiplier of that bound is
# measured. Next to a flat valley the objective falls by 120 times what the bound rises.
ABOVE_LEAST, RAISED = 1e-4, 1e-5
EXAMPLES = Path(__file__).resolve().parent.parent.parent / "examples"
# Between samples a constraint is exceeded by the same length, whatever its bound: here a smaller share of it.
WIDE = {"max_tool_deviation_m": 1e-3}
COARSE = {"chart_spacing": 0.3, "samples_per_segment": 20}
OUT_AND_BACK = [{"by": [0.1, 0, 0], "seconds": 2.5}, {"by": [-0.1, 0, 0], "seconds": 2.5}]
TWO_LEGS = [{"by": [0, -0.3, 0], "seconds": 4}, {"by": [0.1, 0, 0.1], "seconds": 3}]

SHIPPED = {
    f"{name}, {knots} {start}": (name, {"knots": knots, "start": start, **WIDE})
    for name, knots, start in (
        ("triangle", "fixed", "free"),
        ("triangle", "sliding", "free"),
        ("line", "sliding", "pinned"),
    )
}
SMALL: dict[str, dict[str, Any]] = {
    **{
        f"{keep}, {start}": {
            "tool_path": {"keep": keep},
            "planner": {"knots": "sliding", "start": start, **COARSE},
        }
        for keep, start in (("pose", "free"), ("axis", "pinned"), ("position", "free"))
    },
    "sag, pinned": {"planner": {"knots": "sliding", "start": "pinned", **COARSE, "objective": "sag"}},
    "about the base, free": {"planner": {"knots": "sliding", **COARSE, "moment_about": "base"}},
    "about x, pinned": {
        "planner": {"knots": "sliding", "start": "pinned", **COARSE, "axis_weights": [1.0, 0.0, 0.0]}
    },
    # Gravity has no torque about z: next to a flat valley.
    "about z": {"planner": {"knots": "sliding", **COARSE, "axis_weights": [0.05, 0.05, 1.0]}},
    "fixed": {},
    "fixed, position": {"tool_path": {"keep": "position"}},
    "fixed, out and back": {"tool_path": {"legs": OUT_AND_BACK, "via_points": 9}},
    "fixed, two legs": {"tool_path": {"legs": TWO_LEGS, "via_points": 14}},
    "fixed, jerk limited": {"tool_path": {"speed_profile": {"kind": "jerk_limited", "ramp": 0.3}}},
    "fixed, fewest via-points": {"tool_path": {"via_points": 5}, "planner": WIDE},
    "fixed, little smoothing": {"planner": {"smoothing_weight": 1e-6}},
}
ARMS: dict[str, Callable[[Path], Scene]] = {
    "panda, pose": lambda folder: arm_scene(folder, "panda"),
    "kinova, pose": lambda folder: arm_scene(folder, "kinova"),
    "kinova, axis": lambda folder: arm_scene(folder, "kinova", "axis"),
    "ur5, pose": lambda folder: six_joint_scene(
        folder, "ur5", [-105, -76, -94, 84, 48, -61], path_of("pose", 15, ([0.061, -0.054, -0.015], 5.9))
    ),
    "ur5, axis": lambda folder: six_joint_scene(
        folder, "ur5", [0, 71, -107, 55, 66, -104], path_of("axis", 15, ([0.037, 0.13, -0.125], 4.9))
    ),
    "z1, pose": lambda folder: six_joint_scene(
        folder, "z1", [103, 80, -26, -9, -39, 13], path_of("pose", 12, ([0.047, -0.097, 0.114], 5.3))
    ),
}


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Where a solver ended."""

    # Half the mean square of the objective and the smoothing, from the trajectory alone.
    objective: float
    # Largest value of the objective, and what it was held below, in units of the problem's scale.
    peak: float
    bound: float
    # The largest of all constraints but the peak's, as a share.
    violation: float
    trajectory: QuinticTrajectory

    def away_from(self, other: Self) -> float:
        """Largest difference of a joint's angle between two answers, rad."""
        t = np.linspace(*self.trajectory.t[[0, -1]], 400)
        return float(np.abs(self.trajectory.evaluate(t) - other.trajectory.evaluate(t)).max())


class SameStart:
    """A scene's torque problem, for both solvers around the same via-points."""

    def __init__(self, scene: Scene, own: WrenchFunction | None = None) -> None:
        asked = build_request(scene, scene.planner, own)
        guess = initial_guess(asked)
        via_points, sliding = guess.problem.parametrization.via_points, scene.planner.knots == "sliding"
        form = parametrization_through(asked, via_points, sliding=sliding, pinned=guess.pinned)
        self.problem = TorqueProblem(asked, form, guess.lower_bound.value)

    def solve(self, solver: Literal["sqp", "slsqp"], above_least: float = ABOVE_LEAST) -> Answer:
        # To the end, so that it does not matter which of them attains a lower bound by a hair.
        options = exchange_options(self.problem)
        options = replace(
            options,
            solver=solver,
            least_peak_tolerance=above_least,
            held_gain=options.sqp.stall_tolerance,
            held_promise=options.sqp.stall_promise,
        )
        found = minimize_peak(self.problem, options)
        return self.judged(found.parametrization.trajectory, found.peak_bound)

    def objective_at(self, bound: float, answer: Answer) -> float:
        """The SQP's objective, to first order in its peak's bound, were that held below `bound`."""
        if abs(bound - answer.bound) <= 0.1 * SAME_BOUND * bound:
            return answer.objective
        raised = self.solve("sqp", ABOVE_LEAST + RAISED)
        slope = (raised.objective - answer.objective) / (raised.bound - answer.bound)
        assert slope <= 0
        return answer.objective + slope * (bound - answer.bound)

    def judged(self, trajectory: QuinticTrajectory, bound: float) -> Answer:
        """Judge a trajectory whose peak is held below `bound`."""
        problem, asked = self.problem, self.problem.request
        limits = asked.cell.robot.limits
        times, share = gauss_points(trajectory.t, 5)
        value = asked.cell.objective.values(StateSamples.along(trajectory, times)) / problem.scale
        jerk = ((trajectory.evaluate(times, 3) / limits.jerk) ** 2).mean(axis=1)
        fine = np.linspace(*trajectory.t[[0, -1]], 60 * len(trajectory.t))
        states = StateSamples.along(trajectory, fine)
        kept = [function.sample(states)[0].max() for function in problem.constraints]
        bounds = (limits.velocity, limits.acceleration, limits.jerk)
        kept += [
            float((trajectory.extrema(order).largest()[0] / bound).max()) - 1
            for order, bound in enumerate(bounds, start=1)
        ]
        q = trajectory.extrema(0).value
        outside = np.maximum(q - limits.upper[:, None], limits.lower[:, None] - q)
        return Answer(
            objective=0.5 * float(share @ (value**2 + asked.cell.options.smoothing_weight * jerk)),
            peak=float(asked.cell.objective.values(states).max()) / problem.scale,
            bound=bound,
            violation=max(*kept, float(outside.max())),
            trajectory=trajectory,
        )


def changed(scene: Scene, **planner: Any) -> Scene:
    return scene.with_options(**planner)


def of_example(name: str) -> tuple[Scene, WrenchFunction]:
    """The scene of an example and its own objective: what stands before it plans."""
    text, there = (EXAMPLES / name).read_text(encoding="utf-8"), dict[str, Any]()
    exec(compile(text[: text.index("usual = cmbot.plan(")], name, "exec"), there)
    return there["scene"], there["stress"]


def compared(both: SameStart) -> tuple[Answer, Answer]:
    """Answers of the SQP and of SLSQP: both keep the constraints, and neither is worse by much."""
    sparse, dense = both.solve("sqp"), both.solve("slsqp")
    for answer in (sparse, dense):
        assert answer.violation <= MET
        assert answer.peak <= answer.bound * (1 + MET)
    assert sparse.bound <= dense.bound * (1 + SAME)
    if abs(sparse.bound - dense.bound) <= SAME_BOUND * dense.bound:
        objective = both.objective_at(dense.bound, sparse)
        assert objective <= dense.objective * (1 + SAME)
        if sparse.away_from(dense) <= SAME_MOTION:
            assert objective == pytest.approx(dense.objective, rel=SAME)
    return sparse, dense


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """As `cmbot.plan` has it: the matrices are small, more threads of linear algebra wait for each other."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_scenes(name: str) -> None:
    scene, changes = SHIPPED[name]
    compared(SameStart(changed(load_scene(scene), **changes)))


@pytest.mark.parametrize("name", SMALL)
def test_small_scenes(name: str) -> None:
    compared(SameStart(short_scene(**SMALL[name])))


@pytest.mark.parametrize("arm", ARMS)
def test_other_arms(arm: str, tmp_path: Path) -> None:
    compared(SameStart(ARMS[arm](tmp_path)))


def test_an_own_objective() -> None:
    compared(SameStart(*of_example("05_your_own_objective.py")))


def test_the_comparison_can_fail() -> None:
    both = SameStart(short_scene())
    sparse = both.solve("sqp")
    moved = replace(sparse.trajectory, q=sparse.trajectory.q + 1e-3 * np.arange(8)[:, None])
    worse = both.judged(moved, sparse.bound)
    assert sparse.away_from(worse) >= 7e-3
    assert worse.violation > MET
    assert worse.objective != sparse.objective
