"""The table of trains against axles over a beam that is integrated, and the same arm in MuJoCo on it."""

from __future__ import annotations

import numpy as np
import pytest
from trains_in_mujoco import passed

from cmbot.excitation.response import modal_response
from cmbot.excitation.sway import PassageLoad, passage
from cmbot.excitation.trains import Span, train_of
from cmbot.planning import Plan, bending_arm

SPAN = Span(length=24.0, first=5.5, mass=3500.0, damping=0.005, at=12.0)
ZETA, TIMESTEP = 0.01, 4e-4


@pytest.mark.parametrize(("name", "speed_km_h", "time"), [("emu", 160.0, 5.0), ("hslm_a4", 200.0, 8.0)])
def test_mujoco_has_the_table_of_trains(
    triangle_plan: Plan, name: str, speed_km_h: float, time: float
) -> None:
    """Largest displacement of the tool and torque that is added: within 3 %."""
    arm, q = bending_arm(triangle_plan.scene, triangle_plan.robot), triangle_plan.trajectory
    posture, train, speed = q.evaluate(np.array([time]))[0], train_of(name), speed_km_h / 3.6
    load = PassageLoad(span=SPAN, train=train, speed=speed)
    response = modal_response(arm, posture, ZETA)
    ours = passage(load, [response], None, triangle_plan.robot, np.zeros((1, 6)))
    tool, torque = passed(arm, posture, ZETA, SPAN, train, speed, TIMESTEP)
    assert tool > 2e-3
    assert ours.tool == pytest.approx(tool, rel=0.03)
    assert ours.torque == pytest.approx(torque, rel=0.03)
