"""Vibration suppression: the tool comes to rest without swinging on; nothing else that matters changes."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.archive import load_plan, save
from cmbot.archive.schema import SuppressionFile
from cmbot.optimization.least_distance import LeastChange
from cmbot.planning import Plan, plan, remarks
from cmbot.planning.flexibility.vibration_suppression import Window
from cmbot.simulation import SimulationOptions, simulate

THERE_AND_BACK = {
    "legs": [{"by": [0, -0.3, 0], "seconds": 6}, {"by": [0, 0.3, 0], "seconds": 5}],
    "via_points": 28,
}
# Fine enough that the amplitudes of a few micrometres are the motion's.
FINE = SimulationOptions(step_s=0.001, settle_s=1.0)


def planned(modes: int, **tool_path: object) -> Plan:
    return plan(
        short_scene(
            tool_path={**THERE_AND_BACK, **tool_path},
            planner={"knots": "sliding", "start": "pinned", "quiet_modes": modes},
        )
    )


@pytest.fixture(scope="module")
def loud() -> Plan:
    return planned(0)


@pytest.fixture(scope="module")
def quiet() -> Plan:
    return planned(2)


def residual(of: Plan) -> float:
    """Largest distance between any two places of the tool after the stop, less the sag, m."""
    tracking = simulate(of, FINE).planned
    after = tracking.dynamic[tracking.t > tracking.stop + 1e-9]
    return float(np.linalg.norm(np.ptp(after, axis=0)))


def test_the_tool_comes_to_rest(loud: Plan, quiet: Plan) -> None:
    """In the simulation, which knows nothing of how it was done."""
    # What is left are the faster modes.
    assert residual(quiet) < 0.15 * residual(loud)


def test_what_is_predicted_is_what_happens(loud: Plan, quiet: Plan) -> None:
    assert quiet.quieting.share == 1.0
    assert quiet.quieting.modes == 2
    # Both modes' amplitudes coincide at some time: twice that is the most the tool swings through.
    assert 0.4 * residual(loud) < 2 * quiet.quieting.before < 1.5 * residual(loud)
    assert quiet.quieting.after < 1e-3 * quiet.quieting.before


def test_nothing_else_changes(loud: Plan, quiet: Plan) -> None:
    assert loud.quieting is None
    assert quiet.certificate.holds
    np.testing.assert_allclose(quiet.trajectory.q, loud.trajectory.q, rtol=0, atol=1e-12)
    assert np.abs(quiet.trajectory.jumps(3)).max() < 1e-9
    ends = quiet.trajectory.t[[0, -1]]
    for order in (1, 2, 3):
        assert np.abs(quiet.trajectory.evaluate(ends, order)).max() < 1e-9
    assert quiet.figures.peak_guardrail_torque <= loud.figures.peak_guardrail_torque * (1 + 1e-5)
    moved = quiet.trajectory.evaluate(loud.samples.t) - loud.samples.q
    assert 1e-9 < np.abs(moved).max() < 1e-3


def test_bounds_that_are_met_already_stay_met() -> None:
    """With hardly any room for the tool, the change is worked out around what is at its bound."""
    scene = short_scene(
        tool_path=THERE_AND_BACK,
        planner={"knots": "sliding", "start": "pinned", "max_tool_deviation_m": 2e-4, "quiet_modes": 2},
    )
    tight = plan(scene)
    assert tight.certificate.holds
    assert tight.quieting.share > 0
    assert tight.quieting.after <= tight.quieting.before


def test_fixed_knots_are_left_to_the_letter() -> None:
    assert plan(short_scene(planner={"knots": "fixed", "quiet_modes": 2})).quieting is None


def test_links_alone_are_quieted_too() -> None:
    """On a rigid hold the links still bend."""
    scene = short_scene(guardrail={"bays": 0}, planner={"knots": "sliding", "start": "pinned"})
    rigid_hold = plan(scene)
    assert rigid_hold.quieting.share > 0


def test_a_window_that_cannot_be_quieted_leaves_the_others_theirs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of a path with two windows the first finds no change; the last leg comes to rest all the same."""
    change = Window.change

    def first_in_vain(window: Window, *rows: Any) -> LeastChange | None:
        return None if window.start == 0 else change(window, *rows)

    monkeypatch.setattr(Window, "change", first_in_vain)
    made = planned(2, via_points=81)
    assert made.quieting.shares == (0.0, 1.0)
    assert made.quieting.after < 1e-3 * made.quieting.before
    assert made.certificate.holds
    assert "at the ends of 1 of the 2 legs, and at those of 1 not" in " ".join(remarks(made))
    save(made, tmp_path / "plan")
    assert load_plan(tmp_path / "plan").quieting == made.quieting
    # Files of before do not tell the legs apart.
    file = SuppressionFile(modes=2, share=0.5, before=1e-3, after=5e-4)
    assert file.made().shares == (0.5,)


def test_it_is_kept_in_the_plan_directory(quiet: Plan, tmp_path: Path) -> None:
    save(quiet, tmp_path / "plan")
    assert load_plan(tmp_path / "plan", verify=True).quieting == quiet.quieting


def test_a_wrong_stiffness_is_no_worse_than_no_quieting(loud: Plan, quiet: Plan) -> None:
    """Where the modes are not where they were thought to be, some of the vibration stays."""
    for factor in (0.9, 1.1):
        options = replace(FINE, guardrail_factor=factor, link_factor=factor)
        swings = []
        for each in (loud, quiet):
            tracking = simulate(each, options).planned
            swings.append(np.ptp(tracking.dynamic[tracking.t > tracking.stop + 1e-9], axis=0).max())
        assert swings[1] < 1.5 * swings[0]
