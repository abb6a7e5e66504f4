"""What prescribes the joints: exactly the trajectory, or the baseline's positions made smooth."""

import numpy as np

from cmbot.planning import Plan
from cmbot.simulation import PrescribedWork
from cmbot.trajectory import QuinticTrajectory


def test_after_the_stop_the_joints_stay() -> None:
    t, q = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [0.2], [0.5]])
    work = PrescribedWork.of([(QuinticTrajectory.through(t, q), None)])
    np.testing.assert_allclose(work.postures(np.array([0.0, 1.0, 2.0, 9.0])), [[0.0], [0.2], [0.5], [0.5]])


def test_the_baseline_keeps_its_positions_and_hardly_needs_more_acceleration(triangle_plan: Plan) -> None:
    baseline = triangle_plan.baseline.samples
    motion = QuinticTrajectory.through(baseline.t, baseline.q)
    q, v, a = motion.states(baseline.t)
    np.testing.assert_allclose(q, baseline.q, atol=1e-14)
    # The rates of the file are the means to the next sample.
    means = np.diff(baseline.q, axis=0) / np.diff(baseline.t)[:, None]
    np.testing.assert_allclose(means, baseline.v[:-1], atol=1e-9)
    assert np.abs(v - baseline.v).max() < 1.05 * np.abs(np.diff(baseline.v, axis=0)).max()
    assert np.abs(a).max() < 1.3 * np.abs(baseline.a).max()
