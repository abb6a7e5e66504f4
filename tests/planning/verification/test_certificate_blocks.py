"""The certificate measures samples block by block: that changes nothing that it says."""

from __future__ import annotations

from dataclasses import asdict, fields

import numpy as np
import pytest

from cmbot.collision import Clearances
from cmbot.planning import Plan
from cmbot.planning.verification import certificate as certifying
from cmbot.planning.verification.certificate import Certificate, Check, certify
from cmbot.planning.verification.metrics import LimitUse, MotionMetrics, together


def again(planned: Plan) -> Certificate:
    return certify(
        planned.robot,
        planned.task,
        planned.trajectory,
        planned.trajectory.q,
        Clearances(planned.robot, planned.scene.obstacles),
        planned.options,
    )


@pytest.mark.parametrize("block", [1, 7, 512])
def test_samples_that_are_measured_few_at_a_time_say_the_same(
    short_plan: Plan, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(certifying, "_BLOCK", block)
    got, expected = again(short_plan), short_plan.certificate
    assert got.clearance_bound == expected.clearance_bound
    for check, other in zip(got.checks, expected.checks, strict=True):
        assert (check.quantity, check.unit, check.bound) == (other.quantity, other.unit, other.bound)
        assert check.value == pytest.approx(other.value, rel=1e-9, abs=1e-15)
        assert check.time == pytest.approx(other.time, abs=1e-9)
    for mine, others in zip(numbers(got.figures), numbers(expected.figures), strict=True):
        assert mine == pytest.approx(others, rel=1e-9, abs=1e-15)


def numbers(figures: MotionMetrics) -> list[float]:
    """All figures, in one list."""
    most = asdict(figures)
    return [*most.pop("limit_use").values(), *most.values()]


@pytest.mark.parametrize("broken_at", [0, 2])
def test_what_is_no_number_in_one_block_is_not_lost(broken_at: int) -> None:
    checks = [
        Check(quantity="x", time=0.0, value=np.nan if k == broken_at else k, bound=10.0, unit="m")
        for k in range(3)
    ]
    assert np.isnan(certifying._worst(checks).value)
    use = LimitUse(velocity=0.1, acceleration=0.1, jerk=0.1, torque=0.1)
    values = dict.fromkeys((field.name for field in fields(MotionMetrics)), 1.0) | {"limit_use": use}
    good = MotionMetrics(**values)
    bad = MotionMetrics(
        **dict.fromkeys(values, np.nan)
        | {"limit_use": LimitUse(**dict.fromkeys((field.name for field in fields(LimitUse)), np.nan))}
    )
    parts = [(1.0, bad if k == broken_at else good) for k in range(3)]
    assert np.isnan(numbers(together(parts))).all()
    assert together([(2.0, good)] * 3) == good
