"""What joints and feet use of their bounds at rest: above a share it is exact, below it may be less."""

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.planning.request import build_request


@pytest.mark.parametrize("above", [0.7, 1.0])
def test_above_a_share_it_is_exact(above: float, rng: np.random.Generator) -> None:
    hold = {"kind": "magnet", "adhesion_n": 9000.0, "safety": 1.0}
    scene = short_scene(guardrail={"hold": hold})
    cell = build_request(scene, scene.planner, None).cell
    at = cell.postures.at(cell.robot.limits.drawn(rng, 200))
    exact, found = cell.use_at_rest(at), cell.use_at_rest(at, above)
    by_joints = (np.abs(at.joint_torque) / cell.robot.limits.torque).max(axis=1)
    high = exact > above
    # The feet decide of some, on both sides.
    assert (high & (by_joints < above)).any() and (~high & (exact > by_joints)).any()
    np.testing.assert_allclose(found[high], exact[high], rtol=1e-6)
    assert (found[~high] <= exact[~high] + 1e-9).all()
