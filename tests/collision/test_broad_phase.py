"""No distance is below the bounds of the broad phase, and these are near the distances."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from distance_tables import SHAPES, TOLERANCE, all_distances
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from state_samples import StateSamples

from cmbot.collision import Clearances, Mesh, Obstacle, PairedShapes
from cmbot.collision.broad_phase import BroadPhase
from cmbot.common.poses import pose
from cmbot.robot import Robot
from cmbot.scene import load_scene

FloatArray = NDArray[np.float64]


@pytest.fixture(scope="module")
def crowded(any_arm: Robot, tmp_path_factory: pytest.TempPathFactory) -> tuple[Robot, list[Obstacle]]:
    """Arms of capsules, of meshes and of cylinders among obstacles of every shape, turned at random."""
    rock = tmp_path_factory.mktemp("obstacles") / "rock.stl"
    trimesh.creation.icosahedron().apply_scale([0.2, 0.3, 0.1]).export(rock)
    rng = np.random.default_rng(5)
    trimesh.creation.icosahedron().apply_scale([0.1, 2.0, 0.1]).export(beam := rock.with_name("beam.stl"))
    obstacles, meshes = [], {"rock": Mesh(path=rock), "beam": Mesh(path=beam)}
    for name, shape in [*((kind, shape) for kind, (shape, _) in SHAPES.items()), *meshes.items()]:
        point = any_arm.base_point + 0.4 * any_arm.reach * rng.normal(size=3)
        X_WO = pin.SE3(Rotation.random(rng=rng).as_matrix(), point)
        obstacles.append(Obstacle(name=name, shape=shape, X_WO=X_WO.homogeneous))
    return any_arm, obstacles


def bounds_of(
    robot: Robot, obstacles: Sequence[Obstacle], q: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Bounds and better bounds (P, N) of all pairs."""
    paired = PairedShapes(robot, obstacles)
    for bounds in BroadPhase(robot, list(paired.geometry.geometryObjects), paired.shapes).lower_bounds(q):
        pair, posture = (index.ravel() for index in np.indices(bounds.value.shape))
        yield bounds.value, bounds.tightened(pair, posture).reshape(bounds.value.shape)


def test_no_distance_is_below_its_bound(
    crowded: tuple[Robot, list[Obstacle]], random_states: StateSamples
) -> None:
    robot, obstacles = crowded
    q = random_states(robot, 80)[0]
    distances = all_distances(Clearances(robot, obstacles), q)
    assert (distances < 0).mean() > 0.003
    ((bounds, better),) = bounds_of(robot, obstacles, q)
    assert (bounds <= distances + TOLERANCE).all()
    assert (better <= distances + TOLERANCE).all()
    assert (better >= bounds).all()


def test_bounds_are_not_far_too_low(cmbot_robot: Robot, random_states: StateSamples) -> None:
    """Those of capsules beside boxes that do not move are nearly exact, and that is what most pairs are."""
    box = Obstacle(name="box", shape=SHAPES["box"][0], X_WO=pose([1, 0.5, -1], [0.3, 0.2, 0.1]))
    clearances = Clearances(cmbot_robot, [box])
    q = random_states(cmbot_robot, 200)[0]
    distances = all_distances(clearances, q)
    ((bounds, better),) = bounds_of(cmbot_robot, [box], q)
    apart = (distances > 0) & np.array([not pair.self_collision for pair in clearances.pairs])[:, None]
    assert np.quantile((distances - better)[apart], 0.9) < 1e-3
    assert np.median((distances - bounds)[apart]) < 0.2
    for pair, far, *low in zip(clearances.pairs, distances, bounds, better, strict=True):
        if pair.other in ("foot_1", "box"):
            assert np.median((far - low[0])[far > 0]) < 0.08
            assert np.quantile((far - low[1])[far > 0], 0.9) < 1e-3


def test_bounds_of_several_blocks_are_in_order(cmbot_robot: Robot, random_states: StateSamples) -> None:
    obstacles, number = load_scene("line").all_obstacles, 1200
    q = random_states(cmbot_robot, number)[0]
    blocks = [bounds for bounds, _ in bounds_of(cmbot_robot, obstacles, q)]
    assert len(blocks) > 1
    for k in (0, 511, 512, number - 1):
        ((alone, _),) = bounds_of(cmbot_robot, obstacles, q[k : k + 1])
        np.testing.assert_allclose(np.hstack(blocks)[:, k], alone[:, 0], rtol=0, atol=1e-12)
