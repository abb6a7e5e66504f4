"""Time laws and shapers: from rest to rest, as smooth as they say, and of little vibration."""

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.integrate import solve_ivp
from small_scenes import short_scene

from cmbot.common.errors import InputError, SceneError
from cmbot.scene import Scene
from cmbot.toolpath import LegLaw, SpeedProfile, TimeLaw
from cmbot.toolpath.shaper import LEFT, Shaper, extra_insensitive, two_hump

KINDS = ("trapezoidal", "jerk_limited", "quiet")
ORDERS = {"trapezoidal": 1, "jerk_limited": 2, "quiet": 3}
SECONDS = 4.0

frequencies = st.floats(1.0, 20.0)
dampings = st.floats(0.0, 0.1)
shapers = st.one_of(
    st.builds(lambda f, z: extra_insensitive(2 * np.pi * f, z), frequencies, dampings),
    st.builds(lambda f, z: two_hump(2 * np.pi * f, z), st.floats(2.0, 20.0), dampings),
    st.builds(
        lambda f, g, z: extra_insensitive(2 * np.pi * f, z).then(extra_insensitive(2 * np.pi * g, z)),
        st.floats(1.5, 20.0),
        st.floats(1.5, 20.0),
        dampings,
    ),
)
ramped = st.builds(
    lambda kind, up, cruise, down, flat: TimeLaw.ramped(kind, up, cruise, down, flat=flat),
    st.sampled_from(KINDS),
    st.floats(0.05, 1.0),
    st.floats(0.0, 1.0),
    st.floats(0.05, 1.0),
    st.floats(0.0, 0.9),
)
laws = st.one_of(ramped, st.builds(lambda law, shaper: law.shaped(shaper, SECONDS), ramped, shapers))


@given(laws)
@settings(max_examples=60, deadline=None)
def test_a_law_leads_forward_from_rest_to_rest(law: TimeLaw) -> None:
    u = np.linspace(0.0, 1.0, 2001)
    share = law.share(u)
    assert (share[0], share[-1]) == (0.0, 1.0)
    assert (np.diff(share) >= -1e-14).all()
    assert (law.rate(u) >= -1e-9).all()
    np.testing.assert_array_equal(law.rate(np.array([0.0, 1.0])), 0.0)
    inside = np.linspace(0.01, 0.99, 50)
    np.testing.assert_allclose(law.share(law.time_share(inside)), inside, rtol=0, atol=1e-12)


@given(laws)
@settings(max_examples=60, deadline=None)
def test_derivatives_are_continuous_up_to_the_order_of_each_break(law: TimeLaw) -> None:
    before, after = law.coefficients[:-1], law.coefficients[1:]
    h = np.diff(law.breaks)[:-1]
    for order in range(int(law.continuity.min()) + 1):
        factors = np.arange(law.coefficients.shape[1])
        falling = np.prod([factors - k for k in range(order)], axis=0) if order else np.ones(len(factors))
        end = [
            sum(row[p] * falling[p] * h[k] ** (p - order) for p in range(order, len(row)))
            for k, row in enumerate(before)
        ]
        begin = after[:, order] * falling[order]
        scale = max(np.abs(law.coefficients[:, order] * falling[order]).max(), 1.0)
        np.testing.assert_allclose(end, begin, rtol=0, atol=1e-8 * scale)
    # And it begins and ends so.
    assert not law.coefficients[0, : law.continuity[0] + 1].any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_next_derivative_jumps(kind: str) -> None:
    law, order = SpeedProfile(kind=kind, ramp=0.3).law, ORDERS[kind] + 1
    assert (law.continuity == order - 1).all()
    eps = 1e-9
    jumps = np.abs(law.rate(law.breaks[1:-1] + eps, order) - law.rate(law.breaks[1:-1] - eps, order))
    # The jerk of a quiet ramp passes zero in its middle as it came.
    assert np.sort(jumps)[-4 if kind == "quiet" else 0] > 1.0


@given(laws)
@settings(max_examples=40, deadline=None)
def test_the_way_back_is_the_same_law_in_a_mirror(law: TimeLaw) -> None:
    u = np.linspace(0.0, 1.0, 401)
    np.testing.assert_allclose(law.reversed().share(u), 1 - law.share(1 - u), rtol=0, atol=1e-12)
    np.testing.assert_allclose(law.reversed().rate(u), law.rate(1 - u), rtol=0, atol=1e-9)


@given(shapers)
@settings(max_examples=60, deadline=None)
def test_a_shaper_is_a_weighted_mean_of_delays(shaper: Shaper) -> None:
    assert (shaper.amplitudes > 0).all()
    assert shaper.amplitudes.sum() == pytest.approx(1.0, abs=1e-14)
    assert shaper.delays[0] == 0
    assert (np.diff(shaper.delays) >= 0).all()


@given(shapers, st.sampled_from(KINDS))
@settings(max_examples=40, deadline=None)
def test_a_shaped_law_is_the_sum_of_delayed_ones(shaper: Shaper, kind: str) -> None:
    law = SpeedProfile(kind=kind, ramp=0.3).law
    shaped, own = law.shaped(shaper, SECONDS), SECONDS - shaper.duration
    t = np.linspace(0.0, SECONDS, 501)
    ways = [
        A * law.share(np.clip((t - d) / own, 0, 1))
        for A, d in zip(shaper.amplitudes, shaper.delays, strict=True)
    ]
    np.testing.assert_allclose(shaped.share(t / SECONDS), np.sum(ways, axis=0), rtol=0, atol=1e-12)
    assert (shaped.continuity == ORDERS[kind]).all()


@given(st.floats(0.3, 10.0), dampings, st.floats(0.2, 5.0))
@settings(max_examples=60, deadline=None)
def test_the_residual_is_that_of_the_damped_mode(frequency: float, damping: float, other: float) -> None:
    """Of impulses the response of ``x'' + 2 z w x' + w^2 x`` is known in closed form (superposition)."""
    shaper, omega = extra_insensitive(2 * np.pi * frequency, damping), 2 * np.pi * other
    root = np.sqrt(1 - damping**2)
    left = shaper.duration - shaper.delays
    decayed = shaper.amplitudes * np.exp(-damping * omega * left)
    sine, cosine = ((decayed * of(omega * root * left)).sum() for of in (np.sin, np.cos))
    assert shaper.residual(np.array([omega]), damping)[0] == pytest.approx(np.hypot(sine, cosine), abs=1e-12)


@pytest.mark.parametrize(
    ("shaper", "within", "middle"), [(extra_insensitive, 0.19, LEFT), (two_hump, 0.35, 0.0)]
)
def test_what_a_shaper_leaves_in_its_interval(shaper: object, within: float, middle: float) -> None:
    made = shaper(2 * np.pi * 2.0, 0.0)  # type: ignore[operator]
    omega = 2 * np.pi * 2.0 * np.linspace(1 - within, 1 + within, 201)
    assert made.residual(omega, 0.0).max() <= LEFT + 1e-3
    assert made.residual(omega[[100]], 0.0)[0] == pytest.approx(middle, abs=1e-3)


def test_a_mode_that_follows_a_shaped_law_is_at_rest_after_it() -> None:
    """An oscillator whose support follows the law, integrated by SciPy: the swing after the stop."""
    omega, damping = 2 * np.pi * 1.7, 0.01
    plain = SpeedProfile(kind="trapezoidal", ramp=0.2).law
    shaped = SpeedProfile(kind="quiet", ramp=0.3).law.shaped(extra_insensitive(omega, damping), SECONDS)

    def swing(law: TimeLaw) -> float:
        def motion(t: float, y: np.ndarray) -> list[float]:
            push = law.rate(np.array([min(t / SECONDS, 1.0)]), 2)[0] / SECONDS**2 if t < SECONDS else 0.0
            return [y[1], -2 * damping * omega * y[1] - omega**2 * y[0] - push]

        end = solve_ivp(motion, (0, SECONDS), [0, 0], max_step=0.005, rtol=1e-8, atol=1e-12).y[:, -1]
        return float(np.hypot(end[0], end[1] / omega))

    assert swing(shaped) < 0.05 * swing(plain)


@given(ramped, shapers)
@settings(max_examples=20, deadline=None)
def test_a_law_is_recorded_by_its_jerk(law: TimeLaw, shaper: Shaper) -> None:
    if law.continuity.min() < 3:
        law = SpeedProfile(kind="quiet", ramp=0.4).law
    shaped = law.shaped(shaper, SECONDS)
    u = np.linspace(0.0, 1.0, 301)
    np.testing.assert_allclose(LegLaw.of(0, shaped, SECONDS).law.share(u), shaped.share(u), rtol=0, atol=1e-9)


@given(st.floats(0.05, 0.5), st.floats(0.0, 0.9))
@settings(max_examples=40, deadline=None)
def test_a_flat_ramp_has_the_smaller_acceleration(ramp: float, flat: float) -> None:
    law = TimeLaw.ramped("quiet", ramp, 1 - 2 * ramp, ramp, flat=flat)
    u = np.linspace(0.0, ramp, 4001)
    acceleration = law.rate(u, 2)
    mean = law.rate(np.array([ramp]))[0] / ramp
    assert acceleration.max() == pytest.approx(2 * mean / (1 + flat), rel=1e-9)
    # Over that share of the ramp it is as large as that.
    assert np.mean(acceleration > acceleration.max() * (1 - 1e-9)) == pytest.approx(flat, abs=0.02)


def test_a_law_is_no_quicker_than_the_speed_that_is_asked() -> None:
    """In the same seconds without a cruise the tool would be 1.6 times as quick."""
    path = {"legs": [{"by": [0, -0.3, 0], "speed_m_s": 0.1}], "speed_profile": {"kind": "quiet"}}
    scene = short_scene().changed(tool_path={**path, "via_points": 12})
    seconds = scene.timed_strokes(np.eye(4))[0].path.duration

    def timed(law: TimeLaw) -> Scene:
        return scene.with_path(time_laws=(LegLaw.of(0, law, seconds),))

    timed(TimeLaw.ramped("quiet", 0.2, 0.6, 0.2)).timed_strokes(np.eye(4))
    with pytest.raises(SceneError, match=r"time_laws: got a law of leg 0 with up to 0\.16 m/s, expected"):
        timed(TimeLaw.ramped("quiet", 0.5, 0.0, 0.5)).timed_strokes(np.eye(4))


DASH = TimeLaw.ramped("quiet", 0.3, 0.4, 0.3)
QUIET = short_scene(
    tool_path={"legs": [{"by": [0, -0.3, 0], "seconds": SECONDS}], "speed_profile": {"kind": "quiet"}}
)


def sequence(*parts: tuple[float, float]) -> LegLaw:
    """Moves (seconds, share of the way) one after the other; with no share the tool waits."""
    seconds, jerk = list[float](), [0.0]
    for duration, share in parts:
        move = LegLaw.of(0, DASH, duration)
        seconds += move.seconds if share else [duration]
        jerk += [share * each for each in move.jerk[1:]] if share else [0.0]
    return LegLaw(leg=0, seconds=tuple(seconds), jerk=tuple(jerk))


@pytest.mark.parametrize(
    "parts",
    [
        [(0.2, 0.0), (0.6, 1.0), (0.2, 0.0)],
        [(0.3, 0.0), (0.7, 1.0)],
        [(0.4, 0.6), (0.6, 0.4)],
        [(0.25, 0.25)] * 4,
    ],
)
def test_a_quiet_law_that_waits_or_stops_in_between_is_refused(parts: list[tuple[float, float]]) -> None:
    law = sequence(*((share * SECONDS, way) for share, way in parts))
    with pytest.raises(SceneError, match=r"time_laws: got a law of leg 0 that waits, or slows down"):
        QUIET.with_path(time_laws=(law,)).timed_strokes(np.eye(4))


@pytest.mark.parametrize("back", [0.2, 1e-3])
def test_a_law_that_leads_back_is_none(back: float) -> None:
    """Though it leads to the end: the process would go over a stretch three times."""
    parts = [(1.5, 0.6), (1.0, -back), (1.5, 0.4 + back)]
    with pytest.raises(InputError, match="a law that leads back, expected one that leads forward"):
        sequence(*parts)


def test_a_quiet_law_that_creeps_at_its_ends_is_refused() -> None:
    """At a fiftieth of its largest speed for a fifth of the time."""
    rise, fall = [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]
    seconds = [0.05, 0.05, 0.7, 0.05, 0.05, 0.8, 0.05, 0.05, 0.7, 0.05, 0.05]
    jerk = [*rise[:2], 0.0, 0.0, 50.0, 0.0, 0.0, -50.0, 0.0, 0.0, *fall[1:]]
    law = LegLaw(leg=0, seconds=tuple(SECONDS / sum(seconds) * each for each in seconds), jerk=tuple(jerk))
    with pytest.raises(SceneError, match=r"time_laws: got"):
        QUIET.with_path(time_laws=(law,)).timed_strokes(np.eye(4))


@given(st.one_of(st.none(), shapers), st.floats(0.08, 0.49), st.sampled_from([0.0, 0.25, 0.5, 0.75]))
@settings(max_examples=60, deadline=None)
def test_ramps_with_a_shaper_are_taken(shaper: Shaper | None, ramp: float, flat: float) -> None:
    law = TimeLaw.ramped("quiet", ramp, 1 - 2 * ramp, ramp, flat=flat)
    if shaper is not None:
        assume(shaper.duration <= 0.4 * SECONDS)
        law = law.shaped(shaper, SECONDS)
    (stroke,) = QUIET.with_path(time_laws=(LegLaw.of(0, law, SECONDS),)).timed_strokes(np.eye(4))
    assert stroke.path.duration == pytest.approx(SECONDS)
