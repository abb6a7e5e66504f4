"""How far the tool may be across its path by what is not known of the stiffness."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_scenes import parts, short_scene

from cmbot.planning.certification.sag_spread import across_path, largest_spread
from cmbot.trajectory import QuinticTrajectory


def known(spread: Any) -> Any:
    """A sag whose covariance is that of displacements (3,), or one by a function of the postures (N, n)."""
    by_posture = spread if callable(spread) else lambda q: np.tile(np.outer(spread, spread), (len(q), 1, 1))
    return SimpleNamespace(spread=by_posture)


@pytest.mark.parametrize(
    ("displaced", "across"), [([0, 0.003, 0], 0.0), ([0.002, 0, 0], 0.002), ([0.001, 0.5, 0], 0.001)]
)
def test_only_what_is_across_the_path_counts(displaced: list[float], across: float) -> None:
    """The leg of the short scene is along y."""
    _, task, q, _ = parts(short_scene())
    t = np.linspace(0.5, 3.5, 4)
    got = across_path(task.path, known(displaced), t, np.tile(q, (4, 1)))
    np.testing.assert_allclose(got, across, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("ends", "parts_of_time"),
    [
        # Every quarter of a second the deviation is computed, and in eighths of short motions.
        ((0.0, 4.0), 16),
        ((0.0, 1.0, 4.0), 16),
        ((0.0, 0.3, 1.0), 8),
    ],
)
def test_half_of_what_changes_in_between_is_added(ends: tuple[float, ...], parts_of_time: int) -> None:
    """The standard deviation grows with the first joint, by a millimetre over all segments."""
    _, task, q, _ = parts(short_scene())
    t = np.array(ends)
    rest = np.tile(np.eye(7)[0] / t[-1], (len(t), 1))
    moving = np.tile(q, (len(t), 1)) + (t / t[-1])[:, None] * np.eye(7)[0]
    motion = QuinticTrajectory(t=t, q=moving, v=rest, a=0 * rest)

    def growing(postures: Any) -> Any:
        size = 1e-3 * (postures[:, 0] - q[0])
        return size[:, None, None] ** 2 * np.diag([1.0, 0.0, 0.0])

    largest, when = largest_spread(task.path, known(growing), motion)
    assert when == t[-1]
    assert largest == pytest.approx(1e-3 + 0.5 * 1e-3 / parts_of_time, rel=1e-6)
