"""Trains that pass while the arm works: how far the tool moves at each speed, when to pause, how long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.excitation.response import AXES, ModalResponse
from cmbot.excitation.trains import Span, Train, pressure_pulse
from cmbot.robot import Robot
from cmbot.scene import Tolerance

STILL_M = 0.5e-3
"""A tool that moves by less is still, m."""

# Step, s; and the tail: until the slowest decay has lost three decades, but no longer than this, s.
_TIME_STEP_S, _DECADES, _LONGEST_TAIL = 0.002, 3, 60.0


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
