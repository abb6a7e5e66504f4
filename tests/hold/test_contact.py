"""A contact: its figures, and when it slips, by a linear program of its own."""

import numpy as np
import pytest
import scipy.optimize
import shapely
from contact_lp import Plate
from holding import random_loads
from shapely import affinity

from cmbot.hold import MAGNET_PRESSURE, Contact, Foot, Gap, Holding
from cmbot.hold.friction import Friction


def foot(contact: Contact, gap: Gap = "allowed") -> Foot:
    flat = {"centre": np.zeros(3), "axes": np.eye(3), "share": np.eye(6)}
    return Foot(kind="magnet", contact=contact, friction=0.4, safety=1.0, gap=gap, **flat)


def needed(contact: Contact, load: np.ndarray, gap: Gap = "allowed") -> np.ndarray:
    return Holding([foot(contact, gap)], np.zeros(6)).needed(0, load)


def test_area_and_outline_are_about_the_centroid() -> None:
    region = shapely.union_all([shapely.box(0, 0, 0.1, 0.02), shapely.box(0, 0, 0.02, 0.1)])
    contact, centroid = Contact.of(region)
    assert contact.area == pytest.approx(0.1 * 0.02 + 0.08 * 0.02)
    np.testing.assert_allclose(centroid, region.centroid.coords[0])
    np.testing.assert_allclose(contact.region.centroid.coords[0], 0, atol=1e-8)
    assert contact.size == pytest.approx((0.1, 0.1))


def test_no_magnet_exceeds_what_saturated_iron_pulls() -> None:
    assert pytest.approx(1.59e6, rel=2e-3) == MAGNET_PRESSURE
    wide = foot(Contact.rectangle(0.15, 0.075))
    assert wide.ceiling == pytest.approx(MAGNET_PRESSURE * 0.01125)


@pytest.mark.parametrize("size", [(0.15, 0.075), (0.13, 0.15), (0.05, 0.05)])
def test_no_plate_slips_or_tips_with_what_it_needs(size: tuple[float, float]) -> None:
    plate, loads = Plate(*size, 0.4), random_loads(size, 6, seed=7)
    for load, value in zip(loads, needed(Contact.rectangle(*size), loads), strict=True):
        exact = plate.needed(load, float(value))
        most = 1.10 if load[5] == 0 else 1.25
        assert exact <= value, load
        assert value - load[2] <= most * (exact - load[2]), load


def test_turning_a_contact_turns_what_it_needs(rng: np.random.Generator) -> None:
    loads = random_loads((0.15, 0.075), 50, seed=3)
    turned = loads @ np.kron(np.eye(2), np.array([[0, 1.0, 0], [-1, 0, 0], [0, 0, 1]]))
    value = needed(Contact.rectangle(0.075, 0.15), turned)
    np.testing.assert_allclose(value, needed(Contact.rectangle(0.15, 0.075), loads), rtol=1e-6)


def test_a_contact_turned_by_any_angle_needs_the_same(rng: np.random.Generator) -> None:
    """Also of what suffices between loads, near the edge too."""
    sides, angle = (0.15, 0.075), 0.6
    R = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    turned = Contact.of(affinity.rotate(shapely.box(0, 0, *sides), angle, use_radians=True))[0]
    loads = random_loads(sides, 60, seed=3)
    loads[::2, :2] *= 0.01
    other = loads @ np.kron(np.eye(2), R).T
    plain = Contact.rectangle(*sides)
    np.testing.assert_allclose(needed(turned, other), needed(plain, loads), rtol=1e-6)
    force, torque = rng.uniform(0, 10, (2, 60))
    plainly, again = (
        Holding([foot(contact)], np.zeros(6)).needed_between(0, each[:, None], force, torque)
        for contact, each in ((plain, loads), (turned, other))
    )
    np.testing.assert_allclose(again, plainly, rtol=1e-5)


def test_several_pads_tip_about_their_hull_and_turn_about_all() -> None:
    """Three small pads at the corners of a triangle hold more than one of their area in the middle."""
    places = 0.1 * np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(3) / 3])
    pads = shapely.union_all([shapely.Point(*place).buffer(0.01) for place in places])
    contact, centroid = Contact.of(pads)
    np.testing.assert_allclose(centroid, 0, atol=1e-6)
    assert contact.area == pytest.approx(3 * np.pi * 0.01**2, rel=0.01)
    turning = needed(contact, np.array([[0, 0, 0, 0, 0, 20.0]]))
    away = np.random.default_rng(0).uniform(-0.01, 0.01, (400_000, 2))
    away = away[np.hypot(*away.T) < 0.01] + [0.1, 0.0]
    assert turning == pytest.approx(20 / (0.4 * np.hypot(*away.T).mean()), rel=1e-3)
    # Every edge of the hull is 50 mm and a pad's radius away.
    tipping = needed(contact, np.array([[0, 0, 0, 0, -30.0, 0]]))
    assert tipping == pytest.approx(30 / 0.06, rel=0.02)


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_what_is_needed_grows_with_the_load(gap: Gap, rng: np.random.Generator) -> None:
    contact, loads = Contact.rectangle(0.15, 0.075), random_loads((0.15, 0.075), 40, seed=5)
    factor = 10 ** rng.uniform(-5, 1, (40, 1))
    np.testing.assert_allclose(
        needed(contact, factor * loads, gap), factor[:, 0] * needed(contact, loads, gap), rtol=1e-9
    )


def test_a_plate_holds_with_more_than_it_needs_too() -> None:
    """As the centre of pressure moves in, friction may be too little again: what is needed is beyond that."""
    plate = Plate(0.15, 0.075, 0.4)
    load = np.array([-338.0, -853.0, -272.0, -19.2, -192.0, 73.5])
    tilts = 192.0 / 0.075
    assert plate.factor(load, 1.01 * tilts) > 1 > plate.factor(load, 1.2 * tilts)
    (value,) = needed(Contact.rectangle(0.15, 0.075), load[None])
    assert all(plate.factor(load, more * (value - load[2])) >= 1 for more in (1.0, 1.05, 1.1, 1.3, 2.0, 5.0))
    assert value - load[2] <= 1.25 * (plate.needed(load, value) - load[2])


@pytest.mark.parametrize("torsion", [0.9, 2.4, 4.07])
def test_a_disc_about_to_tip_turns_about_what_is_pressed(torsion: float) -> None:
    """A narrow cap bears the torsion: against a sum over points, and the centre that SciPy finds."""
    radius, tipping = 0.1, 50.0
    disc = Contact.of(shapely.Point(0, 0).buffer(radius, quad_segs=64))[0]
    (value,) = needed(disc, np.array([[0, 0, 0, 0, tipping, torsion]]))
    turned = np.zeros((60, 6))
    turned[:, 3:5] = tipping * np.column_stack([np.sin(a := np.linspace(0, 6, 60)), np.cos(a)])
    turned[:, 5] = torsion
    assert needed(disc, turned) == pytest.approx(value, rel=5e-3)
    across, along = (radius * np.linspace(-1, 1, n) for n in (401, 4001))
    points = np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)
    points = points[(np.hypot(*points.T) < radius) & (points[:, 0] > 0.7 * radius)]

    def excess(start: float) -> float:
        pressed = np.maximum(points[:, 0] - start, 0)
        return float(pressed @ points[:, 0] / pressed.sum() - tipping / value)

    pressed = np.maximum(points[:, 0] - scipy.optimize.brentq(excess, 0.7 * radius, 0.999 * radius), 0)
    pressed *= value / pressed.sum()
    most = scipy.optimize.minimize_scalar(
        lambda centre: pressed @ np.hypot(points[:, 0] - centre, points[:, 1]), bounds=(0, radius)
    )
    assert 0.4 * most.fun == pytest.approx(torsion, rel=0.02)


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_what_suffices_a_disc_that_may_tip(gap: Gap, rng: np.random.Generator) -> None:
    """Near its edge friction changes much with the centre of pressure."""
    disc, N = Contact.of(shapely.Point(0, 0).buffer(0.1))[0], 300
    angle = rng.uniform(0, 2 * np.pi, N)
    load = np.zeros((N, 6))
    load[:, 3], load[:, 4] = 50 * np.cos(angle), 50 * np.sin(angle)
    load[:, 5] = rng.uniform(-5, 5, N)
    change, none = 50 * 10 ** rng.uniform(-4, -1.5, N), np.zeros(N)
    enough = Holding([foot(disc, gap)], none[:6]).needed_between(0, load[:, None], none, change)
    other = load.copy()
    other[:, 3:5] *= 1 + change[:, None] / 50
    value = needed(disc, other, gap)
    assert (value <= enough * (1 + 1e-9)).all()
    between = Holding([foot(disc, gap)], none[:6]).needed_between(0, np.stack([load, other], 1), none, none)
    assert (value <= between * (1 + 1e-9)).all()


DISC = np.exp(2j * np.pi * np.arange(24) / 24)
PADS = [0.04 * DISC + centre for centre in (0.2, 0.2j, -0.2)]


@pytest.fixture(params=["plate", "pads"])
def several(request: pytest.FixtureRequest) -> Contact:
    """A plate, and three discs whose hull is mostly empty."""
    if request.param == "plate":
        return Contact.rectangle(0.125, 0.075)
    rings = [shapely.Polygon(np.column_stack([pad.real, pad.imag])) for pad in PADS]
    return Contact.of(shapely.MultiPolygon(rings))[0]


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_what_is_above_a_level_is_exact(several: Contact, gap: Gap, rng: np.random.Generator) -> None:
    load = rng.normal(size=(300, 5)) * [100.0, 100.0, 8.0, 8.0, 10.0]
    exact, slope = several.slip(load, 0.3, gap)
    level = exact * rng.uniform(0.3, 1.7, 300)
    value, by_load = several.slip(load, 0.3, gap, level)
    above = exact > level
    assert 100 < above.sum() < 200
    np.testing.assert_allclose(value[above], exact[above], rtol=1e-7)
    np.testing.assert_allclose(by_load[above], slope[above], atol=1e-4 * np.abs(slope).max())
    assert (value[~above] <= level[~above]).all()


@pytest.mark.parametrize("corners", [None, [(0, 0), (0.02, 0.09), (0.0, 0.12), (-0.2, 0.1)]])
def test_a_contact_bears_what_is_pressed_by_more_than_slips(
    corners: list[tuple[float, float]] | None, rng: np.random.Generator
) -> None:
    """Most of it is said by a bound alone, which knows nothing of the search for the force that slips."""
    plate = Contact.rectangle(0.125, 0.075) if corners is None else Contact.of(shapely.Polygon(corners))[0]
    load = rng.normal(size=(2000, 5)) * [100.0, 100.0, 8.0, 8.0, 4.0] * rng.uniform(size=(2000, 5)) ** 2
    exact = np.maximum(plate.slip(load, 0.3, "allowed")[0], plate.tip(load[:, 2:4])[0])
    for factor in (0.5, 0.9, 0.999, 1.001, 1.2, 2.0):
        assert (plate.bears(load, factor * exact, 0.3, "allowed") == (factor > 1)).all()


def test_what_a_bound_says_is_not_searched_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a plate holds far more than a light load asks."""
    asked, work = list[int](), Friction.work

    def counting(self: Friction, pressure: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, ...]:
        asked.append(len(pressure))
        return work(self, pressure, motion)

    plate = Contact.rectangle(0.125, 0.075)
    load, pressed = np.array([[3.0, 4.0, 0.2, 0.1, 0.1]]), np.array([100.0])
    assert plate.slip(load, 0.3, "none")[0] < 0.5 * pressed
    monkeypatch.setattr(Friction, "work", counting)
    assert plate.bears(load, pressed, 0.3, "none").all()
    assert not asked


@pytest.mark.parametrize("pads", ["three discs", "far and narrow"])
def test_what_hardly_slips_or_hardly_turns_needs_an_end(pads: str, rng: np.random.Generator) -> None:
    """Loads that mostly tip, and slides that mostly do not turn: searches begin or end far from those."""
    if pads == "far and narrow":
        region = shapely.union_all([shapely.box(x, -0.056, x + 0.12, 0.056) for x in (-2.0, 1.88)])
        load = rng.normal(size=(3000, 5)) * [1, 1, 1e-3, 1e-3, 0] + 1e-13 * rng.normal(size=(3000, 5))
    else:
        discs = [shapely.Point(at).buffer(0.05) for at in ((0.25, 0), (-0.2, 0.2), (-0.2, -0.2))]
        region = shapely.union_all(discs)
        load = np.array([[-0.3434, 0, 39.9011, -5e-15, -1e-17], [0, 1e-3, 0, 1, 0], [1e-9, 0, 1, 1, 1e-12]])
    contact = Contact.of(region)[0]
    exact = np.maximum(contact.slip(load, 0.4, "allowed")[0], contact.tip(load[:, 2:4])[0])
    assert np.isfinite(exact).all()
    for factor in (0.999, 1.01, 3.0):
        assert (contact.bears(load, factor * exact, 0.4, "allowed") == (factor > 1)).all()


def test_the_estimate_without_a_gap_is_a_little_too_low(several: Contact, rng: np.random.Generator) -> None:
    load = rng.normal(size=(300, 5)) * [100.0, 100.0, 2.0, 2.0, 10.0]
    exact = several.slip(load, 0.3, "none")[0]
    beyond = exact > 1.001 * np.maximum(several.gap(load[:, 2:4])[0], np.hypot(*load[:, :2].T) / 0.3)
    share = several.slip_without_gap(load, 0.3)[0][beyond] / exact[beyond]
    assert beyond.sum() > 100
    assert (share.min() > 0.9) & (share.max() < 1 + 1e-9)


@pytest.mark.parametrize("gap", ["none", "allowed"])
@pytest.mark.parametrize("part", [0, 1, 2])
def test_what_suffices_where_one_part_of_a_load_changes(
    gap: Gap, part: int, rng: np.random.Generator
) -> None:
    """A longer push along itself, a larger tipping moment or torsion: each is all that is off."""
    plate, N = Contact.rectangle(0.15, 0.075), 200
    load = rng.normal(size=(N, 5)) * [100, 100, 2, 1, 5]
    parts = np.array([[1, 1, 0, 0, 0], [0, 0, 1, 1, 0], [0, 0, 0, 0, 1]])
    share, size = 10 ** rng.uniform(-3, -1, N), np.zeros((N, 3))
    size[:, part] = share * np.linalg.norm(load * parts[part], axis=1)
    changed = load * (1 + share[:, None] * parts[part])
    enough = plate.suffices(load, size, 0.4, gap)
    upright = (plate.gap if gap == "none" else plate.tip)(changed[:, 2:4])[0]
    assert (np.maximum(plate.slip(changed, 0.4, gap)[0], upright) <= enough * (1 + 1e-9)).all()


def test_what_suffices_an_ellipse_that_may_tip(rng: np.random.Generator) -> None:
    """Far from its middle a small moment moves the centre of pressure much further than friction expects."""
    oval, N = Contact.of(affinity.scale(shapely.Point(0, 0).buffer(0.1, quad_segs=8), 2.5, 1))[0], 500
    angle, change, none = rng.uniform(0, 2 * np.pi, N), 50 * 10 ** rng.uniform(-4, -1.3, N), np.zeros(N)
    load = np.zeros((N, 6))
    load[:, 3], load[:, 4] = 50 * np.cos(angle), 50 * np.sin(angle)
    load[:, 5] = rng.choice([-1, 1], N) * 10 ** rng.uniform(-1.5, 1, N)
    other = load.copy()
    other[:, 3:5] *= 1 + change[:, None] / 50
    enough = Holding([foot(oval)], none[:6]).needed_between(0, load[:, None], none, change)
    assert (needed(oval, other) <= enough * (1 + 1e-9)).all()


@pytest.mark.parametrize(
    ("shape", "load", "factors"),
    [
        (
            "plate",
            (
                205.46197777086255,
                -151.21810629172057,
                24.397045345096025,
                53.639322804037455,
                -4.5049259005555164,
            ),
            np.append(1.5, np.linspace(1.06, 1.006, 19)),
        ),
        # A seventh below what is needed a force is about enough again.
        (
            "pads",
            (
                -73.67886857243137,
                -82.50182273523298,
                -39.808478285212296,
                -30.47033014767431,
                13.76603170965501,
            ),
            np.array([1.5, 1.1, 1.02, 1.001]),
        ),
    ],
)
def test_friction_that_is_just_too_little_between_two_forces_is_found(
    shape: str, load: tuple[float, ...], factors: np.ndarray
) -> None:
    """Beyond what is needed no force is too little, by SciPy's search for the weakest motion."""
    plate, (u, w, *moments, torsion) = Contact.rectangle(0.15, 0.075), load
    if shape == "pads":
        discs = [shapely.Point(at).buffer(0.02) for at in ((0.1, 0), (-0.1, 0.08), (-0.1, -0.08))]
        plate = Contact.of(shapely.union_all(discs))[0]
    size = max(np.hypot(*corner) for ring in plate.outline for corner in ring)
    exact = Friction([np.array(ring) @ np.array([1.0, 1j]) / size for ring in plate.outline])
    slips = np.array([u, w, torsion / size]) / 0.4
    along, free = slips / (slips @ slips), scipy.linalg.null_space(slips[None])
    (value,), pressure = needed(plate, np.array([[u, w, 0.0, *moments, torsion]])), np.array([1.0, 0.0, 0.0])
    enough = []
    for force in factors * value:
        goal = np.array([1.0, moments[1] / size / force, -moments[0] / size / force])
        for _ in range(50):
            pressure = np.linalg.solve(exact.moments(pressure[None])[0], goal)
        np.testing.assert_allclose(exact.moments(pressure[None])[0] @ pressure, goal, atol=1e-10)
        found = scipy.optimize.minimize(
            lambda y, p=force * pressure: exact.work(p[None], (along + free @ y)[None])[0][0],
            np.zeros(2),
            method="Nelder-Mead",
            options={"xatol": 1e-12, "fatol": 1e-12},
        )
        enough.append(found.fun)
    assert min(enough) > 1
