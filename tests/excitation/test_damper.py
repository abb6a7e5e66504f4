"""Tuned dampers: against Warburton's optimum for white noise, and on the shipped arm."""

from __future__ import annotations

import numpy as np
import pytest
from small_motions import arm_on_its_guardrail

from cmbot.common.errors import InputError
from cmbot.excitation.damper import best_damper, den_hartog
from cmbot.excitation.response import BAND_HZ, ModalResponse, flat_band, modal_response
from cmbot.robot import Robot
from cmbot.scene import load_scene


def mass_on_a_spring() -> ModalResponse:
    """1 kg at 3 Hz, hardly damped, that is shaken along x, where it moves the tool."""
    x = np.eye(3)[:, :1]
    return ModalResponse(
        frequencies=np.array([3.0]),
        damping=np.array([1e-4]),
        gain=-x.T,
        tool=x,
        wrench=np.zeros((6, 1)),
        direct=np.zeros((6, 3)),
        place=x,
        place_direct=np.zeros((6, 3)),
        axis=np.eye(3)[2],
        shapes=np.eye(1),
        momenta=np.eye(1),
    )


@pytest.mark.parametrize("ratio", [0.02, 0.1])
def test_the_best_damper_under_white_noise_is_warburtons(ratio: float) -> None:
    """For a base that is shaken, with the mass ratio m (1982)."""
    band = (0.05, 100.0)
    gain = best_damper([mass_on_a_spring()], flat_band(1.0, band), band, ratio, "tool")
    frequency = 3.0 * np.sqrt(1 - ratio / 2) / (1 + ratio)
    damping = np.sqrt(ratio * (1 - ratio / 4) / (4 * (1 + ratio) * (1 - ratio / 2)))
    assert gain.damper.frequency == pytest.approx(frequency, rel=0.01)
    assert gain.damper.damping == pytest.approx(damping, rel=0.05)
    assert gain.rms_with < 0.2 * gain.rms_without


def test_what_is_given_of_a_damper_stays() -> None:
    gain = best_damper([mass_on_a_spring()], flat_band(), BAND_HZ, 0.1, "tool", frequency=2.9, damping=0.12)
    assert (gain.damper.frequency, gain.damper.damping) == (2.9, 0.12)
    start = den_hartog(mass_on_a_spring(), 0.1)
    assert start.frequency == pytest.approx(3.0 / 1.1)
    assert start.damping == pytest.approx(np.sqrt(3 * 0.1 / (8 * 1.1)))


def test_a_kilogram_at_the_tool_leaves_a_good_third(cmbot_robot: Robot) -> None:
    """Over +-30 % of stiffness less than half, and no better elsewhere."""
    arm, q = arm_on_its_guardrail(cmbot_robot), np.array(load_scene("triangle").posture)
    arms = [arm, arm.softened(0.7), arm.softened(1.3)]
    gains = {}
    for place in ("tool", "arm_base", cmbot_robot.joints[3]):
        responses = [modal_response(each, q, 0.01, place=place) for each in arms]
        gains[place] = best_damper(responses, flat_band(), BAND_HZ, 1.0, place)
    shares = {place: gain.rms_with / gain.rms_without for place, gain in gains.items()}
    assert shares["tool"] < 0.45
    assert shares["tool"] < shares[cmbot_robot.joints[3]] < shares["arm_base"] < 1.0
    with pytest.raises(InputError, match="a place on the arm"):
        modal_response(arm, q, 0.01, place="elbow")
