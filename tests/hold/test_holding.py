"""What feet bear: closed forms, derivatives, bounds of changes."""

from dataclasses import replace

import numpy as np
import pytest
from finite_differences import finite_difference
from numpy.typing import NDArray

from cmbot.hold import AdhesionPeak, Contact, Foot, Gap, Holding, bears, needed_all_over, needed_by_load

FloatArray = NDArray[np.float64]

FOOT = Foot(
    kind="magnet",
    centre=np.array([0.0, 0.0375, 0.0]),
    axes=np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    contact=Contact.rectangle(0.13, 0.075),
    friction=0.4,
    safety=2.0,
    adhesion=5000.0,
    share=np.eye(6),
)
PLAIN = replace(FOOT, centre=np.zeros(3), axes=np.eye(3))


def needed(load: list[float], foot: Foot = PLAIN) -> list[float]:
    """What a foot needs against pull, tip and slip by a load."""
    values: list[float] = Holding([foot], np.zeros(6)).modes(0, np.array([load]))[0].tolist()
    return values


@pytest.mark.parametrize(
    ("kilonewtons", "gap", "steel", "said"),
    [
        (
            *(3.01, "none", 0.012),
            "two-pole magnets pull 2.9 kN at most on 12 mm of steel, with safety 2 the job asks 6.0 kN "
            "(gap: none): clamps, or a magnet of more poles that pulls 6.0 kN",
        ),
        (
            *(1.0, "allowed", None),
            "two-pole magnets pull 15.5 kN at most, with safety 2 the job asks 2.0 kN (gap: allowed; gap: "
            "none asks 7.2 kN): clamps, or a magnet that pulls 2.0 kN",
        ),
        (
            *(9.0, "allowed", 0.012),
            "no magnet pulls more than 15.5 kN on this contact, with safety 2 the job asks 18.0 kN (gap: "
            "allowed; gap: none asks 18.0 kN): clamps alone",
        ),
    ],
)
def test_which_kinds_of_hold_are_left(kilonewtons: float, gap: Gap, steel: float | None, said: str) -> None:
    """1.592 MPa, B^2 / 2 mu_0 at 2 T, on 13 cm by 7.5 cm, and on twice 12 mm by 7.5 cm."""
    holding = Holding([replace(FOOT, steel=steel, gap=gap)], np.zeros(6))
    needed = AdhesionPeak(peak=1e3 * kilonewtons, mode="tip", tip=1e3, gap=3.6e3, time=0.0)
    assert holding.kinds_left(needed, "the job") == said


@pytest.mark.parametrize(
    ("steel", "more"), [(None, ""), (0.012, ", beyond the 2.9 kN of two poles on 12 mm")]
)
def test_which_magnets_a_job_asks(steel: float | None, more: str) -> None:
    """Safety included, and of the foot that needs most, here the second one."""
    holding = Holding([replace(FOOT, safety=3.0), replace(FOOT, steel=steel)], np.zeros(6))
    needed = AdhesionPeak(peak=3.01e3, mode="tip", tip=1e3, gap=3.6e3, time=0.0, foot=2)
    assert holding.magnets_asked(needed) == f"magnets of 6.0 kN with safety 2{more}"


CLAMP = replace(PLAIN, kind="clamp", adhesion=None, force=(900.0, 800.0, 700.0), moment=(90.0, 80.0, 70.0))


@pytest.mark.parametrize(
    ("feet", "load", "bound", "axis", "said"),
    [
        ([CLAMP], [0, -400, 5, 0, 0, 0], "force_n", 1, "400 N across the plate, of a foot, 800 N"),
        ([CLAMP], [0, 0, -350, 0, 0, 0], "force_n", 2, "350 N onto the steel, of a foot, 700 N"),
        ([CLAMP], [0, 0, 0, -45, 9, 0], "moment_nm", 0, "45 Nm about the length, of a foot, 90 Nm"),
        ([CLAMP], [0, 0, 0, 0, 9, -35], "moment_nm", 2, "35 Nm about the normal, of a foot, 70 Nm"),
        ([PLAIN, CLAMP], [450, 0, 0, 0, 0, 0], "force_n", 0, "450 N along the plate, of foot 2, 900 N"),
        ([CLAMP, PLAIN], [0, 0, 3e4, 0, 0, 0], "force_n", 2, "30000 N off the steel, of foot 1, 700 N"),
        ([PLAIN], [0, 0, 2500, 0, 0, 0], "adhesion_n", 0, "2500 N of adhesion, of a foot, 5000 N"),
    ],
)
def test_what_is_used_most_is_named(
    feet: list[Foot], load: list[float], bound: str, axis: int, said: str
) -> None:
    """Of all that is known of clamps and magnets, safety included."""
    words, whose, has = said.split(", ")
    use = Holding(feet, np.zeros(6)).most_used(np.array([load], dtype=float))
    assert (use.bound, use.axis, use.foot) == (bound, axis, feet.index(CLAMP) if CLAMP in feet else 0)
    assert use.in_words == f"{words}, times safety 2, where {whose.removeprefix('of ')} has {has}"
    assert use.share == pytest.approx(2 * float(words.split()[0]) / float(has.split()[0]))


def test_without_a_gap_more_is_needed() -> None:
    """What a peak says of `gap: none` is what feet need that may open none."""
    loads = np.random.default_rng(3).uniform(-1, 1, (200, 6)) * [600, 600, 400, 90, 90, 60]
    allowed, none = (Holding([replace(PLAIN, gap=gap)], np.zeros(6)) for gap in ("allowed", "none"))
    peak = allowed.worst(loads, np.arange(200.0))
    assert peak.closed == pytest.approx(none.each(loads).max(), rel=1e-6)
    assert peak.closed > 1.5 * peak.peak


def test_objective_and_bounds_ask_feet_for_the_same() -> None:
    """Of several magnets and clamps, each by itself; what is kept of the last loads is not another's."""
    away = replace(FOOT, centre=np.array([0.3, 0.1, 0.2]), share=0.4 * np.eye(6))
    weak = replace(away, adhesion=900.0, safety=1.3, friction=0.2)
    clamp = replace(away, kind="clamp", adhesion=None, force=(900, 800, 700), moment=(90, 80, 70))
    wrenches = np.random.default_rng(4).uniform(-1, 1, (2, 15, 6)) * [300, 300, 300, 60, 60, 40]
    for feet in ([FOOT, away], [FOOT, weak], [FOOT, clamp], [clamp]):
        holding = Holding(feet, np.array([5.0, -9, 40, 3, 2, -1]))
        for wrench in (*wrenches, wrenches[0]):
            needs = np.array([holding.needed(k, wrench) for k in holding.flat])
            np.testing.assert_allclose(holding(wrench)[0], needs.max(axis=0, initial=0.0), rtol=1e-9)
            shares = [
                foot.safety * needs[k] / foot.adhesion if foot.adhesion else holding.use(k, wrench)
                for k, foot in enumerate(feet)
            ]
            value, gradient = holding.share(wrench)
            np.testing.assert_allclose(value, np.max(shares, axis=0), rtol=1e-9)
            step = 1e-4 * np.ones(6)
            after = holding.share(wrench + step)[0] - holding.share(wrench - step)[0]
            np.testing.assert_allclose(2 * gradient @ step, after, rtol=1e-3, atol=1e-9)


def test_a_foot_is_named_where_there_are_several() -> None:
    one, two = (Holding(feet, np.zeros(6)) for feet in ([FOOT], [FOOT, replace(FOOT, safety=1.5)]))
    assert one.named("load", 0) == "load, safety 2"
    assert [two.named("load", k) for k in (0, 1)] == [
        "load of foot 1, safety 2",
        "load of foot 2, safety 1.5",
    ]


def test_a_plain_pull_needs_itself() -> None:
    assert needed([0, 0, 700, 0, 0, 0]) == pytest.approx([700, 700, 700, 700])
    assert Holding([PLAIN], np.zeros(6)).each(np.array([[0, 0, -700.0, 0, 0, 0]])) == 0
    # Nor does a small push to either side change that by more than the other: the pull alone counts.
    value, gradient = needed_all_over(PLAIN, np.array([[0, 0, 700.0, 0, 0, 0]]))
    assert value == 700
    np.testing.assert_array_equal(gradient, [[0, 0, 1, 0, 0, 0]])


def test_tipping_is_about_the_nearer_edge() -> None:
    assert needed([0, 0, 100, 30, 0, 0])[1] == pytest.approx(100 + 30 / 0.0375)
    assert needed([0, 0, 100, 30, 65, 0])[1] == pytest.approx(100 + 65 / 0.065)
    # And changes with the moment about it alone.
    for load, axis, lever in (([0, 0, 9, -30, 0, 0], 3, -0.0375), ([0, 0, 9, 0, 65, 0], 4, 0.065)):
        gradient = needed_by_load(PLAIN, np.array([load], dtype=float))[1]
        np.testing.assert_allclose(gradient, [np.eye(6)[2] + np.eye(6)[axis] / lever], atol=1e-12)


def test_slipping_along_and_turning() -> None:
    assert needed([300, 400, 100, 0, 0, 0])[3] == pytest.approx(100 + 500 / 0.4)
    points = np.random.default_rng(1).uniform(-1, 1, (400_000, 2)) * [0.065, 0.0375]
    turning = 20 / (0.4 * np.hypot(*points.T).mean())
    assert needed([0, 0, 0, 0, 0, -20])[3] == pytest.approx(turning, rel=3e-3)  # of random points


def test_a_robot_that_hangs_beside_a_wall_needs_no_more_than_its_weight_and_lever_ask() -> None:
    """Friction m g / mu or the lever m g h / l: nothing is added up."""
    for lever in (0.01, 0.05, 0.2, 0.5, 3.0):
        value = Holding([PLAIN], np.zeros(6)).needed(0, np.array([[-300.0, 0, 0, 0, -300 * lever, 0]]))
        assert value == pytest.approx(max(300 / 0.4, 300 * lever / 0.065), rel=1e-9)


def test_where_no_gap_may_open_the_kern_is_what_counts() -> None:
    tight = replace(PLAIN, gap="none")
    holding = Holding([tight], np.zeros(6))
    value = needed([0, 0, 100, 30, 20, 0], tight)
    expected = 100 + 3 * (30 / 0.0375 + 20 / 0.065)
    assert value[2] == pytest.approx(expected)
    peak = Holding([PLAIN], np.zeros(6)).worst(np.array([[0.0, 0, 100, 30, 20, 0]]), np.zeros(1))
    assert (peak.tip, peak.gap) == pytest.approx((900.0, expected))
    rng = np.random.default_rng(2)
    first, second = rng.normal(size=(2, 500, 6)) * [500, 500, 500, 50, 50, 50]
    middle = holding.needed(0, 0.5 * (first + second))
    assert (middle <= 0.5 * (holding.needed(0, first) + holding.needed(0, second)) + 1e-9).all()


def test_the_load_is_about_the_centre_of_the_contact() -> None:
    # 100 N downwards, 0.5 m before the face: it tips about the x axis, across the member.
    wrench = np.array([[0, 0, -100.0, -100.0 * 0.5375, 0, 0]])
    load = Holding([FOOT], np.zeros(6)).load(0, wrench)[0]
    np.testing.assert_allclose(load, [-100, 0, 0, 0, -50, 0], atol=1e-12)


def test_loads_of_feet_anywhere(rng: np.random.Generator) -> None:
    """Forces and moments of a foot's share of the wrench, about its centre and along its axes."""
    centre, share = rng.normal(size=3), rng.normal(size=(6, 6))
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    feet = [FOOT, replace(FOOT, centre=centre, axes=axes, share=share)]
    holding, wrench = Holding(feet, np.zeros(6)), 100 * rng.normal(size=(20, 6))
    force, about = np.split(wrench @ share.T, 2, axis=1)
    expected = np.hstack([force @ axes.T, (about - np.cross(centre, force)) @ axes.T])
    np.testing.assert_allclose(holding.load(1, wrench), expected)
    # A column for each foot; what is pressed on needs nothing.
    each = holding.each(wrench)
    np.testing.assert_array_equal(each, np.maximum([holding.needed(k, wrench) for k in (0, 1)], 0).T)


def test_what_does_not_move_counts() -> None:
    weight = np.array([0, 0, -300.0, 0, 10, 0])
    arm = np.array([[1.0, 2, 3, 4, 5, 6]])
    both = Holding([FOOT], np.zeros(6)).load(0, arm + weight)
    np.testing.assert_allclose(Holding([FOOT], weight).load(0, arm), both)


@pytest.mark.parametrize("foot", [FOOT, replace(FOOT, adhesion=None, force=(1e3,) * 3, moment=(50.0,) * 3)])
def test_gradients(foot: Foot, rng) -> None:
    other = replace(foot, centre=np.array([0.2, 0.1, -0.4]), share=rng.normal(size=(6, 6)))
    holding = Holding([foot, other], rng.normal(size=6))
    scale = np.array([500, 500, 500, 50, 50, 50])
    for function in (holding, holding.share):
        wrench = rng.normal(size=(8, 6)) * scale
        value, gradient = function(wrench)
        assert (value > 0).any()
        # All of them at once: each depends on its own wrench alone.
        expected = finite_difference(lambda by, f=function, w=wrench: f(w + by)[0], np.zeros(6), 1e-3)
        np.testing.assert_allclose(gradient, expected, rtol=1e-5, atol=1e-4)


def test_what_is_kept_of_the_last_wrenches_is_exact_above_what_is_asked(rng: np.random.Generator) -> None:
    """Whatever was asked before, by the objective or by the bound of an adhesion."""
    wrench, feet = rng.normal(size=(60, 6)) * [500, 500, 500, 50, 50, 50], [FOOT, replace(FOOT, safety=3.0)]
    needed = Holding(feet, np.zeros(6))(wrench)[0]
    share = Holding(feet, np.zeros(6)).share(wrench)[0]
    kept, levels = Holding(feet, np.zeros(6)), np.quantile(needed, [0.9, 0.2, 0.5, 0.0])
    for level in (*levels, -np.inf, *levels):
        least = level * feet[1].safety / (feet[1].adhesion or 1.0)
        for found, exact, above in (
            (kept(wrench, level), needed, level),
            (kept.share(wrench, least), share, least),
        ):
            np.testing.assert_allclose(np.maximum(found[0], above), np.maximum(exact, above), rtol=1e-9)


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_what_a_contact_that_is_pressed_all_over_needs_is_near_and_has_a_gradient(
    gap: Gap, rng: np.random.Generator
) -> None:
    foot = replace(PLAIN, gap=gap)
    load = rng.normal(size=(300, 6)) * [500, 500, 300, 10, 10, 20] - [0, 0, 600, 0, 0, 0]
    value, gradient = needed_all_over(foot, load)
    pressed = np.maximum(needed_by_load(foot, load)[0] - load[:, 2], 0.0)
    assert (np.abs(value - load[:, 2] - pressed) <= 0.2 * pressed + 1e-9).all()
    by = finite_difference(lambda d: needed_all_over(foot, load + d)[0], np.zeros(6), 1e-4)
    # But where another motion, or tipping, begins to count.
    assert (np.abs(gradient - by).max(axis=1) < 1e-5).mean() > 0.99


def test_the_foot_that_would_need_most_without_a_gap_counts(rng: np.random.Generator) -> None:
    """Of several, whatever they may open; a clamp needs nothing."""
    feet = [PLAIN, replace(PLAIN, friction=0.3, share=0.5 * np.eye(6)), CLAMP]
    loads = rng.normal(size=(50, 6)) * [500, 500, 300, 10, 10, 20] - [0, 0, 600, 0, 0, 0]
    tight = [replace(foot, gap="none") for foot in feet[:2]]
    each = [needed_all_over(foot, Holding([foot], np.zeros(6)).load(0, loads))[0] for foot in tight]
    most = Holding(feet, np.zeros(6)).pressed_without_gap(loads)
    np.testing.assert_allclose(most, np.max(each, axis=0))


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_a_foot_bears_what_needs_no_more_than_it_has(gap: Gap, rng: np.random.Generator) -> None:
    magnet = replace(PLAIN, gap=gap)
    clamp = replace(PLAIN, adhesion=None, force=(900.0,) * 3, moment=(90.0,) * 3)
    load = rng.normal(size=(500, 6)) * [300, 300, 300, 30, 30, 30]
    for foot in (magnet, clamp):
        expected = Holding([foot], np.zeros(6)).share(load)[0] <= 1
        assert 0.05 < expected.mean() < 0.95
        np.testing.assert_array_equal(bears(foot, load), expected)
    # Of moments nothing is said.
    assert bears(replace(clamp, moment=None), load * [1, 1, 1, 1e6, 1e6, 1e6]).any()
    # On a wide plate it takes little to bear a moment.
    wide = replace(magnet, contact=Contact.rectangle(4.0, 3.0))
    load = load * [1, 1, 1, 50, 50, 50]
    np.testing.assert_array_equal(bears(wide, load), Holding([wide], np.zeros(6)).share(load)[0] <= 1)


def test_a_foot_is_bounded_where_something_is_known_of_it() -> None:
    clamp = replace(PLAIN, kind="clamp", adhesion=None, force=(900.0,) * 3)
    welded = replace(PLAIN, kind="welded", adhesion=None)
    assert [foot.bounded for foot in (PLAIN, clamp, welded)] == [True, True, False]
    assert bears(welded, 1e9 * np.eye(6)).all()
    for feet, known in (([welded, clamp], True), ([PLAIN, welded], True), ([welded] * 2, False)):
        assert Holding(feet, np.zeros(6)).bounded is known


def test_a_remainder_bounds_the_change(rng) -> None:
    clamp = replace(FOOT, adhesion=None, force=(1e3, 2e3, 3e3), moment=(50.0, 60.0, 70.0))
    holding = Holding([FOOT, clamp], np.zeros(6))
    wrench = rng.normal(size=(500, 6)) * 300
    change = rng.normal(size=wrench.shape)
    force, torque = (np.linalg.norm(part, axis=1) for part in (change[:, :3], change[:, 3:]))
    enough = holding.needed_between(0, wrench[:, None], force, torque)
    assert (holding.needed(0, wrench + change) <= enough).all()
    assert np.quantile(enough / holding.needed(0, wrench), 0.9) < 1.1
    least = float(np.median(enough))
    more = holding.needed_between(0, wrench[:, None], force, torque, least)
    assert (holding.needed(0, wrench + change) <= more).all()
    assert (more >= least - 1e-9).all() and (more <= np.maximum(enough, least) * (1 + 1e-9)).all()
    moved = np.abs(holding.use(1, wrench + change) - holding.use(1, wrench))
    assert (moved <= holding.use_remainder(1, force, torque)).all()


def test_a_change_of_the_push_is_enclosed_where_the_plate_turns(rng: np.random.Generator) -> None:
    """A push turns the plate about centres that are away from its middle: its change counts there too."""
    holding, number = Holding([PLAIN], np.zeros(6)), 1500
    scale = np.array([300, 300, 0, 60, 100, 20]) * 10 ** rng.uniform(-1, 0, (number, 6))
    load, angle = rng.normal(size=(number, 6)) * scale, rng.uniform(0, 2 * np.pi, number)
    for share in (0.3, 0.03):
        size = share * np.hypot(load[:, 0], load[:, 1])
        other = (
            load + np.outer(size * np.cos(angle), np.eye(6)[0]) + np.outer(size * np.sin(angle), np.eye(6)[1])
        )
        enough = holding.needed_between(0, load[:, None], size, np.zeros(number))
        assert (holding.needed(0, other) <= enough * (1 + 1e-9)).all()


def test_what_suffices_for_a_longer_push_is_hardly_more_than_it_needs() -> None:
    """A push that may be a tenth longer, and the pull that may come with it."""
    longer = np.sqrt(2)  # by a newton along and across
    push = 10 * longer * np.eye(6)[:1, None]
    enough = Holding([PLAIN], np.zeros(6)).needed_between(0, push, np.ones(1), np.zeros(1))
    assert 11 * longer / 0.4 + 1 <= enough <= 1.025 * 11 * longer / 0.4 + 1


@pytest.mark.parametrize("axis", [0, 1, 3, 4, 5])
def test_a_change_along_one_axis_is_enclosed(axis: int) -> None:
    """Where a plate slips the adhesion changes by more than the force: by its share of the friction."""
    holding, change = Holding([PLAIN], np.zeros(6)), np.zeros((1, 6))
    change[0, axis] = 1.0
    force, torque = (np.linalg.norm(part, axis=1) for part in (change[:, :3], change[:, 3:]))
    less, more = (holding.needed(0, share * change) for share in (99, 100))
    assert less < more <= holding.needed_between(0, 99 * change[:, None], force, torque) < 1.2 * more


@pytest.mark.parametrize("friction", [0.05, 0.3, 1.0])
def test_a_push_along_where_there_was_nothing_is_enclosed(friction: float) -> None:
    holding, push = Holding([replace(PLAIN, friction=friction)], np.zeros(6)), np.eye(6)[:1]
    enough = holding.needed_between(0, 0 * push[:, None], np.ones(1), np.zeros(1))
    assert holding.needed(0, push) <= enough < 20 / friction


def test_between_two_pulls_the_larger_one_counts() -> None:
    pulls = np.array([[[0, 0, 100.0, 0, 0, 0], [0, 0, 300.0, 0, 0, 0]]])
    assert Holding([PLAIN], np.zeros(6)).needed_between(0, pulls, np.zeros(1), np.zeros(1)) == [300.0]


@pytest.mark.parametrize("moment", [None, (1e3, 1e3, 1e3)])
def test_what_is_beyond_all_bounds_loads_without_bound(moment: tuple[float, float, float] | None) -> None:
    """Never a number that compares with nothing: a promise would seem kept."""
    clamp = replace(PLAIN, kind="clamp", adhesion=None, force=(1e3, 1e3, 1e3), moment=moment)
    beyond = np.array([np.inf, 1.0])
    found = Holding([clamp], np.zeros(6)).use_remainder(0, beyond, beyond)
    assert found[0] == np.inf
    assert np.isfinite(found[1])


@pytest.mark.parametrize("gap", ["none", "allowed"])
def test_what_suffices_between_wrenches(gap: Gap, rng: np.random.Generator) -> None:
    holding = Holding([replace(FOOT, gap=gap)], np.zeros(6))
    corners = rng.normal(size=(40, 1, 6)) * 300 + rng.normal(size=(40, 5, 6)) * 10
    weights = rng.dirichlet(np.ones(5), size=(40, 30))
    inside = np.einsum("lmk,lki->lmi", weights, corners)
    needed, exact = holding.needed(0, inside.reshape(-1, 6)).reshape(40, 30), np.zeros(40)
    assert (needed <= holding.needed_between(0, corners, exact, exact)[:, None] + 1e-9).all()
    # The nearer they are, the closer it is.
    close = corners[:, :1] + 1e-6 * (corners - corners[:, :1])
    enough = holding.needed_between(0, close, exact, exact)
    np.testing.assert_allclose(enough, holding.needed(0, close[:, 0]), rtol=1e-3)
