"""The largest loads of a job, against pinocchio's Newton-Euler recursion at the times that are told."""

import numpy as np
import pinocchio as pin
import pytest

from cmbot.planning import Plan, load_point, load_rows, loads


@pytest.mark.parametrize("name", ["triangle_plan", "returning_plan"])
def test_loads_are_those_of_the_motion_and_the_largest_of_it(
    request: pytest.FixtureRequest, name: str
) -> None:
    plan: Plan = request.getfixturevalue(name)
    found = {load.name: load for load in loads(plan)}
    base, model, trajectory = plan.scene.base_name, plan.robot.model, plan.job.trajectory
    assert len(found) == 8 + plan.robot.dof
    data = model.createData()
    for load in found.values():
        q, v, a = (trajectory.evaluate(np.array([load.time]), order)[0] for order in range(3))
        torque = pin.rnea(model, data, q, v, a)
        if load.limit is not None:
            joint = plan.robot.joints.index(load.name.rpartition(" ")[2])
            assert load.value == pytest.approx(torque[joint], rel=1e-6)
            assert abs(load.value) <= load.limit
        elif load.name.startswith("force") and not load.name.endswith("norm"):
            # What holds the arm moves its centre of mass, and carries its weight.
            pin.centerOfMass(model, data, q, v, a)
            force = plan.robot.arm_mass * (model.gravity.linear - data.acom[0])
            assert load.value == pytest.approx(force["xyz".index(load.name[-1])], rel=1e-6, abs=1e-6)
        assert load.segment in {segment.name for segment in plan.job.segments}
    norm = found[f"torque on the {base}, norm"]
    # The certificate's peak is one at all times, the samples' one every 0.01 s.
    peak = plan.job.figures.peak_guardrail_torque
    assert peak * (1 - 1e-3) < norm.value <= peak * (1 + 1e-9)
    for what in ("force", "torque"):
        each = [abs(found[f"{what} on the {base}, {axis}"].value) for axis in "xyz"]
        assert max(each) <= found[f"{what} on the {base}, norm"].value * (1 + 1e-12)
    np.testing.assert_allclose(load_point(plan), 0.0, atol=1e-12)


def test_rows_have_signs_units_times_and_shares(triangle_plan: Plan) -> None:
    rows = list(load_rows(triangle_plan))
    assert [len(row) for row in rows] == [6] * len(rows)
    vertical = next(row for row in rows if row[0].startswith("force") and row[0].endswith(", z"))
    # The arm's weight pulls downwards.
    assert vertical[1].startswith("-") and vertical[2] == "N"
    assert [row[5].endswith(" %") for row in rows] == [False] * 8 + [True] * triangle_plan.robot.dof
