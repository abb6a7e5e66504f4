"""What is not a number, or without end, keeps no promise: wherever it comes from, a check fails."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from clamped import MAGNET
from hypothesis import given, settings, strategies as st
from small_motions import wild
from small_scenes import short_scene

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.planning import Plan, plan
from cmbot.planning.certification.certificate import Certificate, Check, certify, continuity_check
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Dynamics, Kinematics
from cmbot.trajectory import Extrema, Pieces, QuinticTrajectory

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)
CERTIFIED_WITH: tuple[tuple[type, str], ...] = (
    (Dynamics, "efforts"),
    (Kinematics, "tool_poses"),
    (Kinematics, "tool_point_jacobians"),
    (Clearances, "query"),
    (Clearances, "distances"),
    (QuinticTrajectory, "jumps"),
    (QuinticTrajectory, "extrema"),
    (Pieces, "remainder"),
    (Pieces, "control_points"),
)
# Of what this returns the certificate reads the Jacobian alone.
READ = {"tool_point_jacobians": slice(1, None)}
JUDGED_WITH: tuple[tuple[type, str], ...] = (
    (Dynamics, "efforts"),
    (Kinematics, "tool_poses"),
    (Clearances, "query"),
)


@pytest.fixture(scope="module")
def held_plan() -> Plan:
    plate = {"name": "plate", "box": [0.5, 0.02, 0.5], "xyz": [2.3, 0.6, -2.06]}
    return plan(short_scene(obstacles=[plate], guardrail={"hold": MAGNET}))


def certified(planned: Plan, trajectory: QuinticTrajectory | None = None) -> Certificate:
    """A plan's work, certified again with everything bounded that can be."""
    return certify(
        planned.robot,
        replace(planned.task, max_speed=10.0, max_base_torque=1e5),
        planned.trajectory if trajectory is None else trajectory,
        Clearances(planned.robot, planned.scene.all_obstacles),
        planned.options,
        via_points=planned.scene.strokes[0].via_points,
    )


def judged(planned: Plan) -> tuple[Check, ...]:
    return second_opinion(
        planned.scene, planned.options, planned.trajectory, robot=planned.robot, stroke=0, sag=None
    )


def arrays(result: Any) -> list[FloatArray]:
    """The arrays of floats that a function returned; of extrema the values."""
    if isinstance(result, Extrema):
        return [result.value]
    parts = [getattr(result, each.name) for each in fields(result)] if is_dataclass(result) else result
    every = [parts] if isinstance(parts, np.ndarray) else list(parts)
    return [each for each in every if each.dtype.kind == "f" and each.size]


def spoilt(whole: Callable[..., Any], rng: np.random.Generator) -> Callable[..., Any]:
    """A function with NaN in place of one number that it returns, a random one of every call."""

    def function(*given: Any, **named: Any) -> Any:
        result = whole(*given, **named)
        found = arrays(result)[READ.get(whole.__name__, slice(None))]
        if found:
            chosen = found[rng.integers(len(found))]
            chosen.setflags(write=True)
            chosen[tuple(rng.integers(chosen.shape))] = np.nan
        return result

    return function


def test_the_plan_is_certified_and_judged_as_it_is(held_plan: Plan) -> None:
    assert certified(held_plan).holds
    assert all(check.holds for check in judged(held_plan))


@pytest.mark.parametrize(("owner", "name"), CERTIFIED_WITH)
@settings(max_examples=5)
@given(seed=SEEDS)
def test_no_certificate_holds_by_what_is_not_a_number(
    held_plan: Plan, owner: type, name: str, seed: int
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, name, spoilt(getattr(owner, name), np.random.default_rng(seed)))
        found = certified(held_plan)
    assert not found.holds


@pytest.mark.parametrize(("owner", "name"), JUDGED_WITH)
@settings(max_examples=5)
@given(seed=SEEDS)
def test_no_second_opinion_agrees_with_what_is_not_a_number(
    held_plan: Plan, owner: type, name: str, seed: int
) -> None:
    with pytest.MonkeyPatch.context() as patch, np.errstate(invalid="ignore"):
        patch.setattr(owner, name, spoilt(getattr(owner, name), np.random.default_rng(seed)))
        found = judged(held_plan)
    assert not all(check.holds for check in found)


@pytest.mark.parametrize("reach", [1e3, 1e4])
@pytest.mark.parametrize("fast", [False, True])
def test_what_overflows_on_the_ellipses_is_not_certified_too_low(
    held_plan: Plan, reach: float, fast: bool
) -> None:
    """Joints that turn thousands of times a second, also of an arm that may: bounds are above what occurs."""
    x = wild(1, joints=7)
    x = QuinticTrajectory(t=x.t, q=x.q * reach, v=x.v * reach, a=x.a * reach)
    # How it is held is not asked here.
    robot = replace(held_plan.robot, feet=())
    if fast:
        bounds = {name: np.full(7, 1e9) for name in ("velocity", "acceleration", "jerk")}
        robot = replace(robot, limits=replace(robot.limits, **bounds))
    found = certified(replace(held_plan, robot=robot), x)
    there = Dynamics(robot).efforts(*x.states(np.linspace(0, x.t[-1], 20_001)))
    assert found.guardrail_torque_bound >= np.linalg.norm(there.guardrail_torque, axis=1).max()
    (torque,) = (check for check in found.checks if check.quantity.startswith("torque of joint"))
    assert torque.value / torque.bound >= (np.abs(there.joint_torque) / robot.limits.torque).max()


@pytest.mark.parametrize("order", range(4))
def test_a_jump_that_is_not_a_number_is_the_largest(held_plan: Plan, order: int) -> None:
    """Whichever derivative jumps, and whatever is found of those after it."""

    class Jumping(QuinticTrajectory):
        def jumps(self, of: int) -> FloatArray:
            return super().jumps(of) * (np.nan if of == order else 1.0)

    x = held_plan.trajectory
    check = continuity_check(held_plan.robot, Jumping(t=x.t, q=x.q, v=x.v, a=x.a))
    assert not check.holds
    assert x.t[1] <= check.time <= x.t[-2]


def test_endlessly_much_keeps_no_bound() -> None:
    endless = Check(quantity="x", time=0.0, value=np.inf, bound=np.inf, unit="")
    assert not endless.holds
    assert replace(endless, value=1.0).holds
    # Where nothing is near, the clearance has no end.
    assert replace(endless, bound=0.02, at_least=True).holds
