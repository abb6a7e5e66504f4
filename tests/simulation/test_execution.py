"""How a controller executes a motion: servos, set-points and delays, against SciPy's integrator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cmbot.archive import load_tracking, save, save_tracking
from cmbot.common.errors import InputError
from cmbot.planning import Plan
from cmbot.simulation import (
    PrescribedWork,
    SimulationOptions,
    simulate,
    tracking_remarks,
    tracking_rows,
    tracking_summary,
    tracking_verdict,
)
from cmbot.simulation.execution import executed, is_executed
from cmbot.trajectory import QuinticTrajectory

OPTIONS = SimulationOptions(settle_s=0.5)


@pytest.fixture(scope="module")
def work() -> PrescribedWork:
    """Two joints through a few places, in two parts."""
    t = np.linspace(0, 0.6, 4)
    q = np.array([[0.0, 1.0], [0.1, 0.9], [0.4, 0.5], [0.5, 0.4]])
    there = QuinticTrajectory.through(t, q)
    return PrescribedWork.of([(there, None), (QuinticTrajectory.through(t, q[::-1]), None)])


@pytest.mark.parametrize(
    ("rate", "set_points", "delay"),
    [(None, "interpolated", 0.0), (50.0, "held", 0.013), (50.0, "interpolated", 0.0)],
)
def test_joints_follow_as_the_filter_does(
    work: PrescribedWork, rate: float | None, set_points: str, delay: float
) -> None:
    bandwidths = (4.0, 9.0)
    options = replace(
        OPTIONS, set_point_rate_hz=rate, set_points=set_points, servo_bandwidth_hz=bandwidths, delay_s=delay
    )
    curve, parts = executed(work, options)

    def command(t: float) -> np.ndarray:
        t = max(t - delay, 0.0)
        if rate is None:
            return work.postures(np.array([t]))[0]
        k = np.floor(t * rate + 1e-9)
        points = work.postures(np.array([k, k + 1]) / rate)
        return points[0] if set_points == "held" else points[0] + (t * rate - k) * (points[1] - points[0])

    w = 2 * np.pi * np.array(bandwidths)

    def rate_of(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[2:], w**2 * (command(t) - x[:2]) - np.sqrt(2) * w * x[2:]])

    start = np.concatenate([work.postures(np.zeros(1))[0], np.zeros(2)])
    times = np.linspace(0, 0.5, 25)
    found = solve_ivp(rate_of, (0, 0.5), start, t_eval=times, max_step=8e-3, rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(curve(times), found.y[:2].T, atol=1e-4)
    np.testing.assert_allclose(curve(times, 1), found.y[2:].T, atol=2e-2 if set_points == "held" else 2e-3)
    assert [part.duration for part in parts] == pytest.approx([0.6, 0.6, 0.5])
    for part in parts:
        q, v, _ = part.states(np.array([0.0, part.duration]))
        np.testing.assert_allclose(q, curve([part.begin, part.end]), atol=1e-9)
        np.testing.assert_allclose(v, curve([part.begin, part.end], 1), atol=1e-9)


def test_a_delay_alone_shifts_the_motion(work: PrescribedWork) -> None:
    options = replace(OPTIONS, delay_s=0.05)
    assert is_executed(options)
    assert not is_executed(OPTIONS)
    curve, _ = executed(work, options)
    times = np.linspace(0, 1.6, 50)
    expected = work.postures(np.maximum(times - 0.05, 0.0))
    np.testing.assert_allclose(curve(times), expected, atol=1e-6)


def test_a_quick_servo_changes_nothing_and_a_slow_one_is_told(strokes_plan: Plan, tmp_path: object) -> None:
    exact = simulate(strokes_plan, OPTIONS)
    quick = simulate(strokes_plan, replace(OPTIONS, servo_bandwidth_hz=(150.0,))).planned
    assert quick.execution is not None
    np.testing.assert_allclose(quick.error - quick.execution, exact.planned.error, atol=5e-5)
    assert np.abs(quick.execution).max() < 3e-4
    driven = replace(
        OPTIONS, set_point_rate_hz=125.0, set_points="held", servo_bandwidth_hz=(5.0,), delay_s=0.01
    )
    slow = simulate(strokes_plan, driven)
    assert exact.planned.execution is None
    assert slow.planned.execution is not None
    largest = np.linalg.norm(slow.planned.execution, axis=1).max()
    # It follows by about sqrt(2) / w, half a set-point and the delay.
    speed = np.linalg.norm(np.diff(strokes_plan.samples.tool_point, axis=0), axis=1).max() / 0.01
    late = np.sqrt(2) / (2 * np.pi * 5) + 0.5 / 125 + 0.01
    assert largest == pytest.approx(late * speed, rel=0.15)
    # The rest of the error is what bends.
    rest = slow.planned.error - slow.planned.execution
    assert np.linalg.norm(rest - exact.planned.error, axis=1).max() < 0.3 * largest
    told = [row for row in tracking_summary(slow, compensated=False) if "how joints are driven" in row[0]]
    assert max(float(row[2]) for row in told) == pytest.approx(1e3 * largest, abs=0.02 * 1e3 * largest)
    assert not [row for row in tracking_summary(exact, compensated=False) if "driven" in row[0]]
    remarks = " ".join(tracking_remarks(slow))
    assert "joints driven with set-points at 125 Hz, held, servos of 5 Hz, a delay of 10 ms." in remarks
    assert "How the joints are driven puts it up to" in tracking_verdict(strokes_plan, slow)
    rows = {row[:2]: row for row in tracking_rows(slow)}
    rms = float(rows["by how joints are driven, RMS", "planned"][-1])
    assert 0 < rms < 1e3 * largest
    folder = tmp_path / "plan"  # type: ignore[operator]
    save(strokes_plan, folder)
    save_tracking(slow, folder)
    again = load_tracking(strokes_plan, folder)
    assert again is not None
    assert again.options == replace(driven, damping=strokes_plan.robot.damping_ratio)
    np.testing.assert_array_equal(again.planned.execution, slow.planned.execution)


def test_what_cannot_be_executed_is_refused(strokes_plan: Plan) -> None:
    with pytest.raises(InputError, match="servo_bandwidth_hz: got nothing, expected a number beside"):
        simulate(strokes_plan, SimulationOptions(set_point_rate_hz=125.0))
    with pytest.raises(InputError, match="servo_bandwidth_hz: got 2 numbers, expected one number, or 7"):
        simulate(strokes_plan, SimulationOptions(servo_bandwidth_hz=(5.0, 6.0)))
    with pytest.raises(InputError, match="delay_s: got -1, expected at least 0"):
        simulate(strokes_plan, SimulationOptions(delay_s=-1))
