"""Poses and their angles."""

import warnings

import numpy as np
import pytest

from cmbot.common.poses import pose, rpy_deg


@pytest.mark.parametrize("pitch", [-90.0, -30.0, 0.0, 90.0])
def test_angles_turn_as_the_rotation_does(pitch: float) -> None:
    """At a right angle, too, where many do, and without a word on standard error."""
    R = pose([0, 0, 0], np.radians([20.0, pitch, -50.0]))[:3, :3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        angles = rpy_deg(R)
    np.testing.assert_allclose(pose([0, 0, 0], np.radians(angles))[:3, :3], R, atol=1e-9)
