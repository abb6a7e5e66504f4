"""Scenes of tool paths, and their timed poses against the second computation of them."""

import copy
from typing import Any

import numpy as np
from hypothesis import strategies as st
from oracles.scene_path import ScenePath
from scipy.spatial.transform import Rotation
from small_scenes import SHORT

from cmbot import load_scene
from cmbot.planning.verification.timed_path import DescribedPath
from cmbot.scene import Scene, Stroke
from cmbot.toolpath import Spline

SECOND = {
    **SHORT,
    "frames": {"bracket": {"xyz": [0.3, -0.2, 0.7], "rpy_deg": [10, -40, 130]}},
}
WHERE = np.array([1.8, 0.7, -2.0])


def scene_of(**tool_path: Any) -> Scene:
    data: dict[str, Any] = copy.deepcopy(SECOND)
    data["tool_path"] = {"via_points": 60, **tool_path}
    return load_scene(data)


def vectors(size: float = 1.0) -> st.SearchStrategy[list[float]]:
    number = st.floats(-size, size).map(lambda x: round(x, 4))
    return st.lists(number, min_size=3, max_size=3).filter(lambda v: float(np.abs(v).max()) > 0.05 * size)


def check_path(scene: Scene) -> None:
    """The timed poses of every stroke against the oracle, and against the verification's own."""
    X_WT = np.eye(4)
    X_WT[:3, :3], X_WT[:3, 3] = Rotation.from_rotvec([0.3, -1.2, 0.5]).as_matrix(), WHERE
    X_start = X_WT
    for number, stroke in enumerate(scene.timed_strokes(X_WT)):
        path, second = stroke.path, ScenePath(scene, X_start[:3, 3], X_start[:3, :3], number)
        times = np.unique(np.concatenate([np.linspace(0, path.duration, 301), path.breaks]))
        p, R = second.poses(times)
        poses = path.poses(times)
        np.testing.assert_allclose(poses.point, p, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.broadcast_to(poses.rotation, R.shape), R, rtol=0, atol=1e-9)
        if not any(isinstance(segment.curve, Spline) for segment in path.segments):
            # On splines their steps are equal in something else: tests/toolpath/test_tool_path.py.
            np.testing.assert_allclose(stroke.via_times, second.via_times(), rtol=1e-9)
        check_described(scene, stroke, X_WT)
        X_WT = path.end_pose


def check_described(scene: Scene, stroke: Stroke, X_before: np.ndarray) -> None:
    """What the verification reads from the scene's file against the package's path."""
    described, t = DescribedPath(scene, stroke, X_before), np.linspace(0, stroke.path.duration, 301)
    (p, R), poses = described.poses(t), stroke.path.poses(t)
    np.testing.assert_allclose(poses.point, p, rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.broadcast_to(poses.rotation, R.shape), R, rtol=0, atol=1e-9)
    np.testing.assert_allclose(stroke.via_times, described.via_times, rtol=1e-9)
    if not described.is_plain:
        assert (described.misses(t) < 1e-4).all()
