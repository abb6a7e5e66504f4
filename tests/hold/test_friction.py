"""The work of friction under a pressure, against sums over many points."""

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray
from shapely import affinity

from cmbot.hold import Contact
from cmbot.hold.contact import BY_MOMENT, BY_MOMENT_AT_EDGE
from cmbot.hold.friction import Friction

FloatArray = NDArray[np.float64]

LEG = shapely.union_all([shapely.box(0, 0, 1.0, 0.2), shapely.box(0, 0, 0.2, 1.0)])
DISC = shapely.Point(0, 0).buffer(1.0)
PADS = shapely.union_all([shapely.Point(x, y).buffer(0.3) for x, y in ((0.7, 0), (-0.4, 0.6), (-0.4, -0.6))])
CONTACTS = {
    "plate": shapely.box(-1, -0.5, 1, 0.5),
    "edge": shapely.box(-1, -0.06, 1, 0.06),
    "leg": LEG,
    "pads": PADS,
}


def friction(region: shapely.Geometry) -> tuple[Friction, shapely.Geometry]:
    contact = Contact.of(region)[0]
    return Friction([np.array(ring) @ np.array([1.0, 1j]) for ring in contact.outline]), contact.region


def some(rng: np.random.Generator, region: shapely.Geometry, number: int) -> tuple[FloatArray, FloatArray]:
    """Pressures that are positive on 1 to 100 % of the way across the contact, and motions."""
    angle, depth = rng.uniform(0, 2 * np.pi, number), np.exp(rng.uniform(np.log(0.01), 0.2, number))
    b = np.column_stack([np.cos(angle), np.sin(angle)])
    reach = b @ shapely.get_coordinates(region).T
    a = depth * (reach.max(axis=1) - reach.min(axis=1)) - reach.max(axis=1)
    centre = rng.normal(size=(number, 2)) * np.exp(rng.uniform(-2, 2, (number, 1)))
    return np.column_stack([a, b]), np.column_stack([centre[:, 1], -centre[:, 0], np.ones(number)])


@pytest.mark.parametrize("region", CONTACTS.values(), ids=CONTACTS)
def test_work_is_the_integral_over_the_contact(region: shapely.Geometry, rng: np.random.Generator) -> None:
    exact, region = friction(region)
    low, high = np.reshape(region.bounds, (2, 2))
    points = rng.uniform(low, high, (400_000, 2))
    points = points[shapely.contains_xy(region, *points.T)]
    pressures, motions = some(rng, region, 8)
    pressures[:, 0] += 0.3
    work, _, _, distance = exact.work(pressures, motions)
    moments = exact.moments(pressures)
    for k, (pressure, motion) in enumerate(zip(pressures, motions, strict=True)):
        pressed = np.maximum(pressure[0] + points @ pressure[1:], 0.0)
        speed = np.hypot(motion[0] - motion[2] * points[:, 1], motion[1] + motion[2] * points[:, 0])
        share = region.area / len(points)
        assert work[k] == pytest.approx(share * pressed @ speed, rel=0.03)
        on = (pressed > 0) * share
        affine = np.column_stack([np.ones(len(points)), points])
        np.testing.assert_allclose(distance[k], affine.T @ (on * speed), atol=0.03 * distance[k, 0])
        np.testing.assert_allclose(
            moments[k], affine.T @ (on[:, None] * affine), atol=0.03 * moments[k, 0, 0]
        )


def test_derivatives(rng: np.random.Generator) -> None:
    exact, region = friction(PADS)
    pressures, motions = some(rng, region, 20)
    _, slope, curved, _ = exact.work(pressures, motions)
    for axis in range(3):
        change = 1e-5 * np.eye(3)[axis]
        more, less = exact.work(pressures, motions + change), exact.work(pressures, motions - change)
        np.testing.assert_allclose(slope[:, axis], (more[0] - less[0]) / 2e-5, rtol=1e-5, atol=1e-7)
        np.testing.assert_allclose(curved[:, axis], (more[1] - less[1]) / 2e-5, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    "region", [*CONTACTS.values(), DISC, affinity.scale(DISC, 3, 1)], ids=[*CONTACTS, "disc", "ellipse"]
)
def test_work_changes_with_moments_by_what_certificates_take(
    region: shapely.Geometry, rng: np.random.Generator
) -> None:
    exact, region = friction(region)
    contact = Contact.of(region)[0]
    pressures, motions = some(rng, region, 4000)
    moments = exact.moments(pressures)
    by_moments = np.linalg.solve(moments, exact.work(pressures, motions)[3][:, :, None])[:, 1:, 0]
    load = (moments @ pressures[:, :, None])[:, :, 0]
    share = contact.tip(load[:, 1:] / load[:, :1])[0]
    hull = region.convex_hull
    distances = [hull.exterior.distance(shapely.Point(0, 0)), hull.hausdorff_distance(shapely.Point(0, 0))]
    at_edge = BY_MOMENT_AT_EDGE * distances[1] / distances[0] / np.sqrt(1 - share)
    most = BY_MOMENT if len(shapely.get_coordinates(hull)) == 5 else np.maximum(BY_MOMENT, at_edge)
    assert (np.linalg.norm(by_moments, axis=1) < most).all()
