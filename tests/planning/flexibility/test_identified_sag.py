"""Sag compensated by an identified stiffness: its standard deviation along the path, and what is promised."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import OptimisationFailed
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.planning import Plan, build_request, modelled_stiffness, plan, robot_of
from cmbot.planning.certification.sag_spread import across_path, largest_spread, spread_times
from cmbot.scene import Scene
from cmbot.views.charts import charts

FACTOR, DEVIATION = 0.8, 0.02


def identified(scene: Scene, deviation: float = DEVIATION) -> dict[str, Any]:
    """All a fifth softer than modelled, each parameter with the same standard deviation."""
    robot = robot_of(scene)
    arm = elastic_arm(robot, elastic_base(scene.elastic_guardrail))
    assert arm.base is not None
    of = modelled_stiffness(robot)
    springs = {
        kind: [
            {"name": name, "modelled": value, "factor": FACTOR}
            for (each, name), value in of.items()
            if each == kind
        ]
        for kind in ("link", "joint")
    }
    base = {
        "footholds": scene.elastic_guardrail.footholds,
        "stiffness": (FACTOR * arm.base.stiffness).tolist(),
    }
    return {
        "links": springs["link"],
        "joints": springs["joint"],
        "base": base | {"mass": arm.base.mass.tolist()},
        "covariance": (deviation**2 * np.eye(StiffnessParameters(arm).count)).tolist(),
    }


def scene_of(deviation: float = DEVIATION, **planner: Any) -> Scene:
    known = identified(short_scene(robot={"joints": "elastic"}), deviation)
    # A millimetre has room for what is not known of the stiffness.
    planner = {"compensate": True, "max_tool_deviation_m": 1e-3, **planner}
    return short_scene(robot={"joints": "elastic"}, identified=known, planner=planner)


@pytest.fixture(scope="module")
def planned() -> Plan:
    """Compensated; one standard deviation is promised."""
    return plan(scene_of(deviation_sigmas=1.0))


def test_the_deviation_is_certified_with_its_spread(planned: Plan) -> None:
    (check,) = (c for c in planned.certificate.checks if "standard deviations" in c.quantity)
    assert check.quantity == "tool deviation within 1 standard deviations of the stiffness"
    assert check.holds
    (expected,) = (c for c in planned.certificate.checks if c.quantity == "expected tool deviation")
    assert planned.compensation is not None
    assert check.value == pytest.approx(expected.value + planned.compensation.deviation, rel=1e-6)
    assert 1e-5 < planned.compensation.deviation < 1e-3


def test_the_spread_is_across_the_path_and_that_of_draws(planned: Plan, rng: np.random.Generator) -> None:
    assert planned.sag is not None
    assert planned.sag.covariance is not None
    (segment,) = planned.job.strokes
    t = spread_times(segment.trajectory)[:3]
    q = segment.trajectory.evaluate(t)
    across = across_path(segment.task.path, planned.sag, t, q)
    along = segment.task.path.leg_directions(t)
    arm, parameters = planned.sag.arm, StiffnessParameters(planned.sag.arm)
    moved = []
    for _ in range(60):
        x = rng.multivariate_normal(np.zeros(parameters.count), planned.sag.covariance)
        drawn = type(planned.sag)(replace(arm, stiffness=parameters.stiffness(x))).at(q).tool
        off = drawn - planned.sag.at(q).tool
        moved.append(off - np.einsum("ki,ki->k", off, along)[:, None] * along)
    for k in range(len(t)):
        largest = np.linalg.eigvalsh(np.cov(np.array(moved)[:, k].T))[-1]
        assert across[k] == pytest.approx(np.sqrt(largest), rel=0.4)
    assert largest_spread(segment.task.path, planned.sag, segment.trajectory)[0] >= across.max()


def test_the_arm_is_the_identified_one_also_after_reading_it_back(planned: Plan, tmp_path: Path) -> None:
    springs = planned.robot.joint_elasticity
    modelled = robot_of(short_scene(robot={"joints": "elastic"})).joint_elasticity
    assert springs["joint_2"].stiffness == pytest.approx(FACTOR * modelled["joint_2"].stiffness)
    cmbot.save(planned, tmp_path / "plan")
    again = cmbot.load_plan(tmp_path / "plan", verify=True)
    assert again.robot.joint_elasticity == springs
    assert again.compensation == planned.compensation
    quantities = [c.quantity for c in again.certificate.checks]
    assert {c.quantity for c in planned.certificate.checks} < set(quantities)
    ((t, largest),) = again.deviation_with_spread
    assert (largest > np.interp(t, again.samples.t, again.samples.tool_deviation)).all()


def test_it_is_told(planned: Plan) -> None:
    lines = list(cmbot.planning.remarks(planned))
    assert "Stiffness as identified, not as modelled: 4 links, 7 joints, guardrail." in lines
    rows = {row[0]: row[-1] for row in planned.rows()}
    deviation = planned.compensation.deviation
    assert rows["standard deviation by the identified stiffness, mm"] == f"{1e3 * deviation:.2f}"
    chart = next(chart for chart in charts(planned, None) if chart.key == "deviation")
    assert "Thin: with 1 standard deviations of the identified stiffness." in chart.note
    assert sum(curve.thin for curve in chart.curves) == 1


def test_a_stiffness_that_is_hardly_known_promises_nothing() -> None:
    with pytest.raises(OptimisationFailed, match="the stiffness is known too little: 3 standard deviations"):
        plan(scene_of(0.3, deviation_sigmas=3.0))


def test_laws_allow_for_what_is_not_known() -> None:
    scene = scene_of()
    options = build_request(scene, scene.planner).cell.options
    # Two modes, of many springs with independent errors of 2 % each.
    assert 0.005 < options.quiet_stiffness_share < 2 * DEVIATION
    vague = scene_of(1.0)
    assert build_request(vague, vague.planner).cell.options.quiet_stiffness_share == 0.3
