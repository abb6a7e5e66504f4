"""What is drawn, as triangles: solids against closed forms, normals smooth on them and sharp at edges."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from hypothesis import example, given, strategies as st
from hypothesis.extra.numpy import arrays
from urdf_arms import ROBOTS

from cmbot.common.robot_library import library_robots
from cmbot.robot import Robot
from cmbot.views.drawing.surfaces import (
    Surface,
    ball,
    bar,
    box,
    capsule,
    cone,
    creased,
    cylinder,
    hull,
    merged,
    simplified,
    tube,
    visual_surface,
)

CREASE = np.deg2rad(35.0)
SIZE = np.array([0.2, 0.3, 0.4])
CORNERS = box(SIZE).vertices


def solid(surface: Surface) -> trimesh.Trimesh:
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


@pytest.mark.parametrize(
    ("surface", "volume", "extents"),
    [
        (box(SIZE), 0.024, SIZE),
        (bar(SIZE, 0.05), 0.024, SIZE),
        (cylinder(0.1, 0.4), np.pi * 0.1**2 * 0.4, (0.2, 0.2, 0.4)),
        (cone(0.1, 0.4), np.pi * 0.1**2 * 0.4 / 3, (0.2, 0.2, 0.4)),
        (ball(0.1), 4 / 3 * np.pi * 0.1**3, (0.2, 0.2, 0.2)),
        (capsule(0.1, 0.4), np.pi * 0.1**2 * 0.4 + 4 / 3 * np.pi * 0.1**3, (0.2, 0.2, 0.6)),
        (cylinder(0.1, 0.4, 0.05), np.pi * 0.1**2 * 0.4, (0.2, 0.2, 0.4)),
        (capsule(0.1, 0.4, 0.05), np.pi * 0.1**2 * 0.4 + 4 / 3 * np.pi * 0.1**3, (0.2, 0.2, 0.6)),
        (hull(np.vstack([CORNERS, 0.3 * CORNERS])), 0.024, SIZE),
    ],
    ids=("box", "bar", "cylinder", "cone", "ball", "capsule", "rings", "capsule rings", "hull"),
)
def test_solids_are_closed_and_as_large_as_they_should_be(
    surface: Surface, volume: float, extents: np.ndarray
) -> None:
    mesh = solid(surface)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    # What is round is drawn with corners, so it is a little too small.
    assert 0.97 * volume < mesh.volume < volume * (1 + 1e-9)
    assert surface.area == pytest.approx(mesh.area)
    np.testing.assert_allclose(mesh.extents, extents, rtol=1e-9)
    np.testing.assert_allclose(mesh.bounds.sum(axis=0), 0.0, atol=1e-12)
    assert set(surface.faces.ravel()) == set(range(len(surface.vertices)))


def test_a_tube_follows_its_points_and_merged_surfaces_keep_their_triangles() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.3, 0.0, -1.0], [0.3, 0.5, -0.4]])
    pieces = solid(tube(points, 0.01)).split()
    assert len(pieces) == 3 + 4
    assert all(piece.is_watertight and piece.volume > 0 for piece in pieces)
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    for piece, start, end, length in zip(pieces[:3], points, points[1:], lengths, strict=False):
        np.testing.assert_allclose(piece.centroid, (start + end) / 2, atol=1e-12)
        assert piece.volume == pytest.approx(np.pi * 0.01**2 * length, rel=0.05)
    pieces = solid(merged([box(SIZE), ball(0.1)])).split()
    assert sorted(len(piece.faces) for piece in pieces) == sorted([12, len(ball(0.1).faces)])


def test_a_box_has_a_normal_for_each_side_what_is_round_is_smooth_but_at_its_rims() -> None:
    surface, normals = creased(box(SIZE), CREASE)
    assert len(surface.vertices) == 24
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (np.einsum("ki,ki->k", normals, surface.vertices) > 0).all()
    surface, normals = creased(ball(0.5), CREASE)
    assert len(surface.vertices) == len(ball(0.5).vertices)
    np.testing.assert_allclose(normals, surface.vertices / 0.5, atol=0.01)
    plain = cylinder(0.1, 0.4)
    surface, normals = creased(plain, CREASE)
    assert len(surface.vertices) == 2 * (len(plain.vertices) - 2) + 2
    level = np.abs(normals[:, 2]) < 1e-9
    np.testing.assert_allclose(normals[level], surface.vertices[level] * [10, 10, 0], atol=1e-9)
    np.testing.assert_allclose(np.abs(normals[~level, 2]), 1.0)


def test_edges_of_three_triangles_and_of_two_wound_differently_are_sharp() -> None:
    fin = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, 1, 0.02], [0.5, 1, 0.0], [0.5, 1, -0.02], [0.5, 0, 0]])
    # The last two are lines, which are left out.
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [0, 1, 5], [2, 2, 3]])
    surface, normals = creased(Surface(fin, faces), CREASE)
    assert (len(surface.faces), len(surface.vertices)) == (3, 9)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    # The one's normal is the other's turned round: only what lies back to back shares it.
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0.9, 0.1]])
    apart, _ = creased(Surface(points, np.array([[0, 1, 2], [0, 1, 3]])), CREASE)
    assert len(apart.vertices) == 6
    folded, normals = creased(Surface(points, np.array([[0, 1, 2], [0, 1, 4]])), CREASE)
    assert len(folded.vertices) == 4
    at_edge = np.abs(folded.vertices[:, 1]) < 1e-12
    # Between the triangles' own, which are (0, 0, 1) and turned from it by 6.3 deg.
    turned = np.degrees(np.arctan2(-normals[at_edge, 1], normals[at_edge, 2]))
    assert ((turned > 2) & (turned < 4.3)).all()


def test_the_robot_is_shaded_as_trimesh_would(cmbot_robot: Robot) -> None:
    """Trimesh finds the same patches, for the shapes of our robot, and the same normals on them."""
    for shape in cmbot_robot.visual_model.geometryObjects:
        plain = visual_surface(shape, "")
        surface, normals = creased(plain, CREASE)
        other: Any = trimesh.graph.smooth_shade(solid(plain), angle=CREASE)
        ours, theirs = (
            np.hstack([p[f].reshape(-1, 9), n[f].reshape(-1, 9)])
            for p, n, f in (
                (surface.vertices, normals, surface.faces),
                (other.vertices, other.vertex_normals, other.faces),
            )
        )
        order = [np.lexsort(np.round(rows[:, :9], 9).T) for rows in (ours, theirs)]
        np.testing.assert_allclose(ours[order[0]], theirs[order[1]], atol=1e-6)


def test_only_surfaces_of_many_triangles_are_simplified() -> None:
    small, middle, large = (ball(0.1, sections=n, rings=n) for n in (8, 40, 160))
    counts = [len(surface.faces) for surface in (small, middle, large)]
    assert simplified([small, middle, large], sum(counts)) == [small, middle, large]
    most = counts[0] + counts[1] + 5000
    found = simplified([large, small, middle], most)
    assert found[1:] == [small, middle]
    assert 0.95 * 5000 < len(found[0].faces) <= 5000
    found = simplified([large, small, middle], 2000)
    assert found[1] is small
    assert 1900 < sum(len(surface.faces) for surface in found) <= 2000
    for surface in (found[0], found[2]):
        assert solid(surface).volume == pytest.approx(4 / 3 * np.pi * 0.1**3, rel=0.02)
    # Triangles that share no vertices, as in STL files, do not come apart.
    apart = Surface(large.vertices[large.faces].reshape(-1, 3), np.arange(3 * counts[2]).reshape(-1, 3))
    (joined,) = simplified([apart], 5000)
    assert trimesh.Trimesh(joined.vertices, joined.faces).is_watertight


def reached(surface: Surface) -> np.ndarray:
    """The box about its triangles, without those that are lines."""
    points = surface.vertices[surface.faces[np.linalg.norm(surface.crosses, axis=1) > 1e-12]].reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])


def require_whole(drawn: Surface, original: Surface, away: float) -> None:
    """The same box to 0.2 % of its diagonal, and nothing of the original farther than `away` of it."""
    box = reached(original)
    low, size = box[0], np.linalg.norm(box[1] - box[0])
    np.testing.assert_allclose(reached(drawn), box, atol=0.002 * size)
    # trimesh takes what is shorter than 1e-8 for nothing: distances are those of surfaces of size 1.
    one, other = (solid(Surface((each.vertices - low) / size, each.faces)) for each in (drawn, original))
    _, distances, _ = trimesh.proximity.closest_point_naive(one, other.sample(50, seed=1))
    assert distances.max() < away


@pytest.mark.parametrize("name", ["ur5", "panda"])
def test_a_robot_is_drawn_whole(name: str) -> None:
    """Meshes with loose parts and edges of three triangles, where edge collapse alone gets stuck."""
    urdf = (library_robots() or {})[name]
    model, kind = pin.buildModelFromUrdf(str(urdf)), pin.GeometryType.VISUAL
    folders = [str(ROBOTS.parent.parent)]
    shapes = pin.buildGeomFromUrdf(model, str(urdf), kind, package_dirs=folders).geometryObjects
    originals = [visual_surface(shape, name) for shape in shapes]
    assert sum(len(surface.faces) for surface in originals) > 3 * 24_000
    drawn = simplified(originals, 24_000)
    assert sum(len(surface.faces) for surface in drawn) <= 24_000
    for surface, original in zip(drawn, originals, strict=True):
        require_whole(surface, original, 0.05)


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_a_mesh_of_several_materials_is_drawn_as_it_is(tmp_path: Path, unit: float) -> None:
    """A block of one colour, and a ball of another beside it, in one object of a file."""
    parts, lines, first = (box(SIZE), ball(0.1).moved(pin.SE3(np.eye(3), SIZE).homogeneous)), ["o arm"], 1
    for number, part in enumerate(parts):
        lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in part.vertices.tolist()] + [f"usemtl colour_{number}"]
        lines += [f"f {a} {b} {c}" for a, b, c in (part.faces + first).tolist()]
        first += len(part.vertices)
    (tmp_path / "two.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    mesh = f'<mesh filename="{tmp_path}/two.obj" scale="{unit} {unit} {unit}"/>'
    link = f'<link name="l"><visual><geometry>{mesh}</geometry></visual></link>'
    (urdf := tmp_path / "two.urdf").write_text(f'<robot name="r">{link}</robot>', encoding="utf-8")
    shapes = pin.buildGeomFromUrdf(pin.buildModelFromUrdf(str(urdf)), str(urdf), pin.GeometryType.VISUAL)
    drawn = visual_surface(shapes.geometryObjects[0], "r")
    assert drawn.area == pytest.approx(unit**2 * sum(part.area for part in parts), rel=1e-6)
    assert solid(drawn).volume == pytest.approx(unit**3 * sum(solid(part).volume for part in parts), rel=1e-6)


@given(
    corners=arrays(np.float64, (120, 3, 3), elements=st.floats(-1, 1, width=32)),
    spread=st.sampled_from([1e-4, 0.01, 1.0]),
    most=st.integers(1, 360),
    welded=st.booleans(),
)
@example(corners=np.zeros((120, 3, 3)), spread=1.0, most=10, welded=False)
def test_loose_triangles_are_drawn_whole(corners: np.ndarray, spread: float, most: int, welded: bool) -> None:
    """Triangles without neighbours, each there three times: small ones, large ones, lines and points."""
    centres = corners[:, :1]
    loose = centres + spread * (corners - centres)
    if welded:
        loose = np.round(loose, 1)
    lying = np.linalg.norm(np.cross(loose[:, 1] - loose[:, 0], loose[:, 2] - loose[:, 0]), axis=1) > 1e-9
    loose[~lying, 2] = loose[~lying, 1]
    soup = Surface(np.tile(loose.reshape(-1, 3), (3, 1)), np.arange(9 * len(loose)).reshape(-1, 3))
    (drawn,) = simplified([soup], most)
    assert len(drawn.faces) <= len(soup.faces)
    if lying.any():
        require_whole(drawn, Surface(soup.vertices, soup.faces[np.tile(lying, 3)]), 0.05)
