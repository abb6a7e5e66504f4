"""Sway: how far an arm's tool moves, over its work, while its base is shaken at random.

Each posture answers as if it were held: that is good where it changes little while its slowest mode dies
away, 1 / (2 pi zeta f), some seconds. Where the arm moves faster, the response lags behind; a simulated
record shows it.

Trains pass while the arm works: how far the tool moves at each speed, when to pause, how long.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.fft import irfft, next_fast_len

from cmbot.common.arrays import BoolArray, FloatArray, interpolated
from cmbot.common.errors import InputError
from cmbot.common.reading.file_types import Matrices, Row
from cmbot.common.representation import ShortRepr
from cmbot.elastic import Guardrail, elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.first_order import BAND_HZ
from cmbot.excitation.along_work import PostureSystem, tool_along
from cmbot.excitation.peaks import davenport_factor, departure_rate, probability_of_leaving
from cmbot.excitation.response import (
    AXES,
    ModalResponse,
    Moments,
    Spectrum,
    flat_band,
    modal_response,
)
from cmbot.excitation.trains import Span, Train, pressure_pulse
from cmbot.hold import needed_by_load
from cmbot.planning import Plan, held_guardrail
from cmbot.robot import Robot
from cmbot.scene import Tolerance

# Simulated records: how many, how many at once, and numbers at most; their steps a second and the fastest
# mode, over the highest frequency.
_RECORDS, _RECORDS_AT_ONCE, _MOST_NUMBERS = 2000, 500, 20_000_000
_FINENESS, _MODES_TO_BANDS = 5.0, 2.0
_FEWEST_RECORDS, _RECORD_SEED = 100, 2021
# Of so few in the first batch that leave the tolerance none is counted: the bound by crossings is taken. With
# so many, batches end: their share is then known to 7 %.
_FEWEST_OUTSIDE, _ENOUGH_OUTSIDE, _MOST_BATCHES = 10, 200, 6
# Signs of the six loads of a foot.
_LOAD_SIGNS = np.array(list(product((-1.0, 1.0), repeat=6)))
# Decay times after which a vibration is forgotten.
_MEMORY_DECAYS = 5.0
STILL_M = 0.5e-3
"""A tool that moves by less is still, m."""

# Step, s; and the tail: until the slowest decay has lost three decades, but no longer than this, s.
_TIME_STEP_S, _DECADES, _LONGEST_TAIL = 0.002, 3, 60.0


@dataclass(frozen=True, kw_only=True, eq=False)
class RandomSway(ShortRepr):
    """The tool's motion about where it would be, stationary in each of K postures of the work.

    Attributes
    ----------
    t : (K,), s
        On the clock of the work.
    covariance : (K, 3, 3), m2
        Of the tool point, in W.
    across, along : (K,), m
        Root mean squares across the tool's axis, of both directions, and along it.
    first_hz : (K,), Hz
        The slowest mode.
    peak : float, m
        Mean of the largest displacement over the work along the direction that moves most (Davenport).
    peak_factor : float
        Of that peak to the root mean square.
    leaves : float or None
        Probability that the tolerance is left in the work; None without a tolerance.
    leaves_by : str or None
        How it was found: ``records``, the share of simulated ones, or ``crossings``, a bound from above.
    """

    t: Row
    covariance: Matrices
    across: Row
    along: Row
    first_hz: Row
    peak: float
    peak_factor: float
    leaves: float | None
    leaves_by: str | None

    @property
    def rms(self) -> FloatArray:
        """Root mean squares of the displacement in space (K,), m."""
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)))

    @property
    def rms_mm(self) -> float:
        """Their mean over the work, mm."""
        return 1e3 * mean_over(self.t, self.rms)


def mean_over(t: FloatArray, values: FloatArray) -> float:
    """Return the mean of values (K,) at times (K,), linear in between."""
    if len(t) == 1 or t[-1] == t[0]:
        return float(values.mean())
    return float(np.sum((values[1:] + values[:-1]) / 2 * np.diff(t)) / (t[-1] - t[0]))


def sway_mm_per_m_s2(
    work: Plan | FloatArray, robot: Robot | None = None, guardrail: Guardrail | None = None
) -> float:
    """Return the tool's RMS in space, mm, by 1 m/s2 RMS of the deck along each axis, flat from 0.5 to 30 Hz.

    With the damping of its robot.

    Parameters
    ----------
    work : Plan or (n,)
        Of a plan the mean over its work; or one posture, rad and m.
    robot : Robot, optional
        Of a posture.
    guardrail : Guardrail, optional
        On which that robot stands.

    Raises
    ------
    InputError
        When nothing bends, or it is too soft to carry itself.
    """
    if isinstance(work, Plan):
        arm = elastic_arm(work.robot, elastic_base(held_guardrail(work.scene, work.robot)))
        t = np.linspace(0.0, work.work.duration, 13)
        postures = work.trajectory.evaluate(work.trajectory.t[0] + t)
    else:
        if robot is None:
            raise InputError("sway_mm_per_m_s2", "robot", "nothing", "the robot whose posture that is")
        arm = elastic_arm(robot, None if guardrail is None else elastic_base(guardrail))
        t, postures = np.zeros(1), np.asarray(work)[None]
    require_bending(arm, "sway_mm_per_m_s2")
    each = [modal_response(arm, q, arm.robot.damping_ratio).moments(flat_band(), BAND_HZ) for q in postures]
    return 1e3 * mean_over(t, np.array([np.sqrt(np.trace(moments.value[:3, :3])) for moments in each]))


def require_bending(arm: ElasticArm, source: str) -> None:
    """Refuse an arm of which nothing bends.

    Raises
    ------
    InputError
    """
    if not len(arm.elastic):
        expected = (
            "guardrail.bays, base.tube, guardrail.stiffness, base.modes or robot.elasticity in the scene"
        )
        raise InputError(source, "guardrail", "nothing that bends", expected)


def sway_of(
    t: FloatArray,
    responses: Sequence[ModalResponse],
    moments: Sequence[Moments],
    tolerance: Tolerance | None = None,
    draw: Callable[[int], FloatArray] | None = None,
) -> RandomSway:
    """Return the sway over a work in K postures.

    Parameters
    ----------
    t : (K,), s
    responses : K ModalResponse
    moments : K Moments
        Of all outputs.
    tolerance : Tolerance, optional
    draw : callable, optional
        From a batch's number to its simulated records, `sampled_tool`; needed where there is a tolerance.
    """
    covariance = np.array([each.value[:3, :3] for each in moments])
    frames = [_frame(response.axis) for response in responses]
    turned = [each.along(R @ np.eye(3, 9)) for each, R in zip(moments, frames, strict=True)]
    squares = np.array([np.diag(each.value) for each in turned])
    # The direction, posture by posture, that moves most.
    main = [each.along(np.linalg.eigh(each.value)[1][:, -1:].T) for each in turned]
    sigma = np.sqrt([float(each.value[0, 0]) for each in main])
    worst = int(np.argmax(sigma))
    rate = np.sqrt(float(main[worst].rate[0, 0])) / (2 * np.pi * max(sigma[worst], 1e-300))
    factor = davenport_factor(rate, float(t[-1] - t[0]) or 1.0)
    leaves, by = None, None
    if tolerance is not None and draw is not None:
        axes = np.array([response.axis for response in responses])
        gone = count = 0
        for batch in range(_MOST_BATCHES):
            outside = _outside(t, axes, draw(batch), tolerance)
            gone, count = gone + int(outside.sum()), count + len(outside)
            if not _FEWEST_OUTSIDE <= gone < _ENOUGH_OUTSIDE:
                break
        few = gone < _FEWEST_OUTSIDE
        leaves, by = (_crossing(t, turned, tolerance), "crossings") if few else (gone / count, "records")
    return RandomSway(
        t=t,
        covariance=covariance,
        across=np.sqrt(squares[:, 0] + squares[:, 1]),
        along=np.sqrt(squares[:, 2]),
        first_hz=np.array([response.frequencies[0] for response in responses]),
        peak=factor * float(sigma[worst]),
        peak_factor=factor,
        leaves=leaves,
        leaves_by=by,
    )


def _crossing(t: FloatArray, turned: Sequence[Moments], tolerance: Tolerance) -> float:
    """Bound of the probability that the tool leaves its tolerance, by crossings; z is its axis."""
    bounds = ((tolerance.across_mm, np.eye(2, 3)), (tolerance.along_axis_mm, np.eye(3)[2:]))
    stays = 1.0
    for bound, rows in bounds:
        if bound is not None:
            each = np.array([departure_rate(some.along(rows), bound / 1e3) for some in turned])
            stays *= 1 - probability_of_leaving(t, each[:, 0], each[:, 1])
    return float(1 - stays)


def _outside(t: FloatArray, axes: FloatArray, tool: FloatArray, tolerance: Tolerance) -> BoolArray:
    """Which records (N, R, 3) leave a tolerance, the tool's axes (K, 3) at times `t` (K,)."""
    at = np.linspace(t[0], t[-1], len(tool))
    axis = interpolated(at, t, axes)
    along = np.einsum("nri,ni->nr", tool, axis)
    across = np.sqrt(np.maximum(np.einsum("nri,nri->nr", tool, tool) - along**2, 0.0))
    return ~np.asarray(tolerance.keeps(across, along).all(axis=0))


def sampled_tool(
    t: FloatArray,
    responses: Sequence[ModalResponse],
    spectrum: Spectrum,
    band: tuple[float, float],
    batch: int = 0,
    records: int = _RECORDS,
) -> FloatArray:
    """Return displacements of the tool (N, R, 3), m, in W, at N equal steps of the work.

    They are those under simulated records, which are Gaussian, with random phases and amplitudes, the same
    in every run.

    Parameters
    ----------
    t : (K,), s
        Equal steps.
    responses : K ModalResponse
    spectrum, band
        Of the inputs.
    batch : int
        Others in each.
    records : int
        Fewer where they are long.
    """
    duration = float(t[-1] - t[0])
    # A record is cut from a periodic one, longer by the time in which the slowest decay forgets.
    N = max(int(_FINENESS * band[1] * duration), 2)
    step = duration / (N - 1) if duration else 1 / (_FINENESS * band[1])
    slowest = min(float((response.frequencies * response.damping).min()) for response in responses)
    count = next_fast_len(N + int(_MEMORY_DECAYS / (2 * np.pi * slowest * step)), real=True)
    records = max(min(records, _MOST_NUMBERS // (AXES * N)), _FEWEST_RECORDS)
    f = np.arange(count // 2 + 1) / (count * step)
    S, random = spectrum(f), np.random.default_rng(_RECORD_SEED + batch)
    acting, inside = S.any(axis=0), S.any(axis=1)
    # E |X|^2 = S N^2 df / 2 for the coefficients of a real series.
    scale = (np.sqrt(S[:, acting] / (count * step)) * count / 2).astype(np.float32)[:, :, None]
    # What is linear between steps lacks so much.
    linear = (np.sinc(f * step) ** 2).astype(np.float32)[:, None, None]
    systems = [PostureSystem.of(response, _MODES_TO_BANDS * band[1]) for response in responses]
    systems = [replace(system, gain=system.gain[:, acting]) for system in systems]
    done, tool = np.linspace(0.0, 1.0, N), list[FloatArray]()
    for first in range(0, records, _RECORDS_AT_ONCE):
        some = min(_RECORDS_AT_ONCE, records - first)
        X = random.standard_normal((2, *scale.shape[:2], some), dtype=np.float32)
        spectra = (X[0] + 1j * X[1]) * scale
        start = 2 / count * systems[0].steady(f[inside], spectra[inside]).real
        inputs = irfft(spectra / linear, count, axis=0)[:N]
        tool.append(tool_along(systems, done, inputs, step, start))
    return np.concatenate(tool, axis=1)


def _frame(axis: FloatArray) -> FloatArray:
    """Rows (3, 3): two directions across the tool's axis, and the axis."""
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis])


def shaken_adhesion(
    robot: Robot, planned: FloatArray, moments: Sequence[Moments], factor: float
) -> float | None:
    """Return the largest adhesion that a foot needs while it is shaken, N: static, and a peak factor on top.

    All loads of the shaking are taken at their peaks at once, with the signs for which a foot needs most.

    Parameters
    ----------
    robot : Robot
    planned : (K, 6), N and Nm
        The wrench of the planned motion in each posture.
    moments : K Moments
    factor : float
        Peak to root mean square.
    """
    holding, most = robot.holding, None
    if holding is None:
        return None
    for number in holding.adhesive:
        foot = holding.feet[number]
        for wrench, each in zip(planned, moments, strict=True):
            load = factor * np.sqrt(np.diag(foot.from_wrench @ each.value[3:, 3:] @ foot.from_wrench.T))
            planned_load = holding.load(number, wrench[None])
            needed = float(needed_by_load(foot, planned_load + _LOAD_SIGNS * load)[0].max())
            most = needed if most is None else max(most, needed)
    return most


@dataclass(frozen=True, kw_only=True)
class PassageLoad:
    """What a train at one speed, m/s, does to the arm: over a span, by pressure, Pa, from one side."""

    span: Span
    train: Train
    speed: float
    pressure: float = 0.0

    def inputs(self, t: FloatArray, count: int) -> FloatArray:
        """Return the first inputs (N, count) at times (N,): the deck's acceleration, then pressure, Pa.

        The first axle comes onto the span at time 0, and the head passes the arm as it is abreast.
        """
        x = np.zeros((len(t), count))
        x[:, :AXES] = self.span.acceleration(self.train, self.speed, t)
        if count > AXES:
            abreast = self.span.at / self.speed
            x[:, AXES] = self.pressure * pressure_pulse(self.train, self.speed, t - abreast)
        return x


@dataclass(frozen=True, kw_only=True)
class Passage(ShortRepr):
    """What a train at one speed does, at worst over the postures of the work.

    Attributes
    ----------
    speed_km_h : float
    passes_s : float, s
        From the first axle on the span to the last one off it.
    deck : float, m/s2
        Largest acceleration of the deck.
    tool : float, m
        Largest displacement of the tool from where it would be.
    torque : float, Nm
        Largest torque about O0 that is added.
    adhesion : float or None, N
        Largest that a foot needs, of the planned motion's wrench in that posture and what is added.
    still_s : float, s
        From the last axle off until the tool moves by less than 0.5 mm for good; 0 where it never did.
    pause_s : float, s
        From the first axle on until the tool is for good within its tolerance, or without one still; 0: no
        pause.
    kept : bool or None
        Whether the tolerance is kept throughout; None without one.
    """

    speed_km_h: float
    passes_s: float
    deck: float
    tool: float
    torque: float
    adhesion: float | None
    still_s: float
    pause_s: float
    kept: bool | None


def passage(
    load: PassageLoad,
    responses: Sequence[ModalResponse],
    tolerance: Tolerance | None,
    robot: Robot,
    planned: FloatArray,
) -> Passage:
    """Return what a train does in some postures, with the planned wrenches (K, 6) there."""
    slowest = min(float((each.frequencies * each.damping).min()) for each in responses)
    slowest = min(slowest, load.span.first * load.span.damping)
    tail = min(_DECADES * np.log(10) / (2 * np.pi * slowest), _LONGEST_TAIL)
    passes = load.span.passage(load.train, load.speed)
    t = np.arange(0.0, passes + tail, _TIME_STEP_S)
    inputs = load.inputs(t, responses[0].gain.shape[1])
    tool = torque = still = pause = 0.0
    kept, wrenches = True, list[FloatArray]()
    for response in responses:
        y = response.history(inputs, _TIME_STEP_S)
        size = np.linalg.norm(y[:, :AXES], axis=1)
        off = _off(y[:, :AXES], response.axis, tolerance, size)
        tool = max(tool, float(size.max()))
        torque = max(torque, float(np.linalg.norm(y[:, 6:], axis=1).max()))
        still, pause = max(still, _last(t, size > STILL_M) - passes), max(pause, _last(t, off))
        kept = kept and not off.any()
        wrenches.append(y[:, AXES:])
    return Passage(
        speed_km_h=3.6 * load.speed,
        passes_s=passes,
        deck=float(np.abs(inputs[:, :AXES]).max()),
        tool=tool,
        torque=torque,
        adhesion=adhesion_of(robot, wrenches, planned, t),
        still_s=max(still, 0.0),
        pause_s=pause,
        kept=None if tolerance is None else kept,
    )


def adhesion_of(
    robot: Robot, added: Sequence[FloatArray], planned: FloatArray, t: FloatArray
) -> float | None:
    """Return the largest adhesion that a foot needs, N; None where none holds by it.

    Parameters
    ----------
    robot : Robot
    added : K of (N, 6), N and Nm
        In some postures, at times `t` (N,).
    planned : (K, 6), N and Nm
        The wrench of the planned motion there.
    t : (N,), s
    """
    holding = robot.holding
    if holding is None or not holding.adhesive:
        return None
    return max(holding.worst(y + wrench, t).peak for y, wrench in zip(added, planned, strict=True))


def _off(y: FloatArray, axis: FloatArray, tolerance: Tolerance | None, size: FloatArray) -> BoolArray:
    """When the tool is off its tolerance, or without one not still."""
    if tolerance is None:
        return np.asarray(size > STILL_M)
    along = y @ axis
    return ~tolerance.keeps(np.sqrt(np.maximum(size**2 - along**2, 0.0)), along)


def _last(t: FloatArray, off: BoolArray) -> float:
    """The last time that something is so; 0 where it never is."""
    return float(t[np.flatnonzero(off)[-1]]) if off.any() else 0.0


def resonance_speeds(train: Train, first_hz: float, slowest: float, fastest: float) -> tuple[float, ...]:
    """Return the speeds, m/s, at which the axles' commonest repetition meets a frequency: ``v = f L / n``."""
    gaps = np.round(np.subtract.outer(train.axles, train.axles), 2)
    lengths, counts = np.unique(gaps[gaps > train.length / len(train.axles)], return_counts=True)
    length = float(lengths[np.argmax(counts)]) if len(lengths) else train.length
    each = [first_hz * length / n for n in range(1, 21)] if length else []
    return tuple(speed for speed in reversed(each) if slowest <= speed <= fastest)


@dataclass(frozen=True, kw_only=True)
class Timetable(ShortRepr):
    """How much of an hour is left for work where the arm pauses for trains, between strokes alone.

    Attributes
    ----------
    per_hour : float
        Trains in an hour.
    pause_s : float
        For each: the longest of the passages.
    waits_s : float
        Mean of what is lost before: a stroke that would not end before the train comes is not begun.
    work_s : float
        Left of an hour.
    pauses_at_s : tuple of float
        When the work can pause, s on its clock: at the ends of strokes.
    rests_s : tuple of (float, float)
        Where the minutes of trains are known: from when to when the arm rests, s of an hour.
    """

    per_hour: float
    pause_s: float
    waits_s: float
    work_s: float
    pauses_at_s: tuple[float, ...]
    rests_s: tuple[tuple[float, float], ...] = ()


def timetable(
    per_hour: float, passages: Sequence[Passage], strokes: FloatArray, comes_s: Sequence[float] = ()
) -> Timetable:
    """Return what trains leave of an hour.

    Parameters
    ----------
    per_hour : float
        Trains, at any time alike.
    passages : sequence of Passage
    strokes : (S, 2), s
        Begins and ends on the work's clock; the work is done again and again.
    comes_s : sequence of float, s
        When trains come, of every hour, in place of `per_hour`.
    """
    pause = max(each.pause_s for each in passages)
    durations, count = strokes[:, 1] - strokes[:, 0], len(comes_s) or per_hour
    # A train comes at any time alike: within a stroke in proportion to its length, half of which is then
    # lost.
    waits = float((durations**2).sum() / (2 * (strokes[-1, 1] - strokes[0, 0]))) if pause else 0.0
    rests = _rests(sorted(comes_s), pause, strokes) if pause else ()
    work = 3600.0 - sum(end - begin for begin, end in rests) if comes_s else 3600.0 - count * (pause + waits)
    return Timetable(
        per_hour=count,
        pause_s=pause,
        waits_s=(3600.0 - work) / count - pause if rests else waits,
        work_s=max(0.0, work),
        pauses_at_s=tuple(strokes[:, 1].tolist()),
        rests_s=rests,
    )


def _rests(comes: Sequence[float], pause: float, strokes: FloatArray) -> tuple[tuple[float, float], ...]:
    """From when to when an arm rests in an hour, s, which it does before a stroke that would not end in time.

    The hour before is gone through, too: its last train may end in this one.
    """
    # Each stroke with the move to it.
    needs = np.diff(strokes[:, 1], prepend=strokes[0, 0])
    rests = list[tuple[float, float]]()
    trains, clock, number = [hour + each for hour in (-3600.0, 0.0, 3600.0) for each in comes], -3600.0, 0
    for train in trains:
        while clock + needs[number % len(needs)] <= train:
            clock, number = clock + float(needs[number % len(needs)]), number + 1
        begin, clock = clock, max(clock, train + pause)
        if rests and begin == rests[-1][1]:
            begin = rests.pop()[0]
        rests.append((begin, clock))
    return tuple((max(begin, 0.0), min(end, 3600.0)) for begin, end in rests if end > 0.0 and begin < 3600.0)
