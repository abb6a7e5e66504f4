"""What feet bear along a motion whose wrench is known: closed forms."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cmbot.hold import Contact, Foot, Holding
from cmbot.planning.certification.enclosed_hold import EnclosedHold
from cmbot.trajectory import Pieces, QuinticTrajectory

LONG, WIDE, SECONDS = 0.13, 0.075, 2.0
FOOT = Foot(
    kind="magnet",
    centre=np.zeros(3),
    axes=np.eye(3),
    contact=Contact.rectangle(LONG, WIDE),
    friction=0.4,
    safety=2.0,
    adhesion=5000.0,
    share=np.eye(6),
)
PUSHED, TIPPED = np.array([10.0, 0, 0, 0, 0, 0]), np.array([0.0, 0, 0, 30.0, 0, 0])


def enclosed(feet: list[Foot], start: Any, end: Any) -> EnclosedHold:
    """Where the wrench changes from `start` (6,) to `end` (6,), and interpolation misses nothing."""
    rest = np.zeros((3, 1))
    motion = QuinticTrajectory(t=np.linspace(0.0, SECONDS, 3), q=rest, v=rest, a=rest)
    pieces = Pieces.between(motion, np.empty(0))
    share = pieces.times.reshape(-1, 1) / SECONDS
    none = np.zeros_like(pieces.ellipses.turn[..., 0])
    bounds: Any = SimpleNamespace(guardrail_force=none, guardrail_torque=none)
    return EnclosedHold(Holding(feet, np.zeros(6)), pieces, bounds, (1 - share) * start + share * end, 1e-6)


@pytest.mark.parametrize("reverse", [False, True])
def test_a_peak_says_what_happens_at_its_time(reverse: bool) -> None:
    """From a push along the plate, against which it would slip, to a moment about its nearer edge."""
    ends = (TIPPED, PUSHED) if reverse else (PUSHED, TIPPED)
    hold = enclosed([FOOT, replace(FOOT, share=2 * np.eye(6))], *ends)
    assert hold.needed is not None
    tips = 2 * 30.0 / (WIDE / 2)
    assert (hold.needed.mode, hold.needed.foot) == ("tip", 2)
    assert hold.needed.time == (0.0 if reverse else SECONDS)
    assert hold.needed.peak == pytest.approx(tips)
    assert (1 - 1e-12) * tips <= hold.needed_bound <= 1.001 * tips
    checks = list(hold.checks())
    assert [check.quantity for check in checks] == [
        "adhesion needed of foot 1, safety 2",
        "adhesion needed of foot 2, safety 2",
    ]
    assert [check.value for check in checks] == pytest.approx([tips / 2, tips], rel=1e-3)
    assert [check.bound for check in checks] == [2500.0, 2500.0]


def test_a_clamp_uses_its_bounds_with_its_safety() -> None:
    clamp = replace(FOOT, kind="clamp", adhesion=None, force=(100.0, 50.0, 20.0), moment=(90.0,) * 3)
    hold = enclosed([clamp], PUSHED, TIPPED)
    assert hold.needed is None
    assert hold.needed_bound == np.inf
    (check,) = hold.checks()
    assert check.quantity == "load of the clamp, safety 2"
    assert check.value == pytest.approx(2 * 30 / 90, rel=1e-5)
    assert (check.bound, check.time) == (1.0, SECONDS)
