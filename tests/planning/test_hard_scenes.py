"""Scenes that were hard to plan: drawn at random, for arms that are not ours."""

from pathlib import Path

import pytest
from urdf_arms import six_joint_scene

from cmbot.common.errors import OptimisationFailed
from cmbot.optimization.exchange import ExchangeReport
from cmbot.planning import plan
from cmbot.planning.context import build_context
from cmbot.planning.initial_guess import sliding_guess
from cmbot.planning.torque.decomposition import optimise

PINNED = {"start": "pinned", "solver": "sqp"}


def path_of(keep: str, via_points: int, *legs: tuple[list[float], float]) -> dict[str, object]:
    each = [{"by": by, "seconds": seconds} for by, seconds in legs]
    return {"legs": each, "via_points": via_points, "keep": keep}


SETTING_OFF = (
    [-15, -22, 27, 51, 29, -16],
    path_of("axis", 15, ([-0.132, -0.057, 0.065], 5.3), ([0.012, -0.057, 0.125], 5.8)),
)
TURNING = (
    [-104, 45, 111, 26, 8, 119],
    path_of("axis", 25, ([-0.11, 0.14, 0.046], 4.7), ([-0.092, 0.109, 0.108], 5.4)),
)


def test_an_arm_that_cannot_set_off_without_more_torque_than_at_rest(tmp_path: Path) -> None:
    """The peak at rest is that of the start, which stays; to get away from there the arm asks more."""
    made = plan(six_joint_scene(tmp_path, "ur5", *SETTING_OFF, **PINNED))
    assert made.certificate.holds
    assert made.start.moved == 0
    assert made.options.step_share == made.scene.planner.step_share
    at_rest = made.certificate.figures.peak_static_guardrail_torque
    assert at_rest < made.certificate.figures.peak_guardrail_torque < 1.01 * at_rest
    assert {"peak", "mean square"} == {report.stage for report in made.passes}


def test_a_way_that_no_trajectory_follows_is_given_up_soon(tmp_path: Path) -> None:
    """Steps that turn round break accelerations, and no step of the solver does much about it."""
    scene = six_joint_scene(tmp_path, "ur5", *TURNING, **PINNED)
    context = build_context(scene, scene.planner)
    reports: list[ExchangeReport] = []
    with pytest.raises(OptimisationFailed, match="cannot all be met") as caught:
        optimise(sliding_guess(context).problem, reports.append)
    assert "acceleration" in caught.value.constraint
    assert caught.value.violation > 1
    assert len(reports) <= 1
    made = plan(scene)
    assert made.certificate.holds
    assert made.options.step_share < scene.planner.step_share
