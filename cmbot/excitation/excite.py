"""What shakes a plan's arm, and by how much: spectra, records, trains, wind; and a damper against it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from cmbot.accuracy import Accuracy, Shaking
from cmbot.common.arrays import FloatArray, interpolated
from cmbot.common.reading.fields import si_fields
from cmbot.common.reading.file_types import Row
from cmbot.common.representation import ShortRepr
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.first_order import BAND_HZ
from cmbot.excitation.along_work import PostureSystem, tool_along
from cmbot.excitation.damper import STIFFNESS_FACTORS, DamperGain, best_damper, den_hartog
from cmbot.excitation.ground import axles_of, read_record
from cmbot.excitation.response import (
    AXES,
    ModalResponse,
    Spectrum,
    flat_band,
    linear_spectrum,
    modal_response,
)
from cmbot.excitation.sway import (
    Passage,
    PassageLoad,
    RandomSway,
    Timetable,
    adhesion_of,
    passage,
    require_bending,
    resonance_speeds,
    sampled_tool,
    shaken_adhesion,
    sway_of,
    timetable,
)
from cmbot.excitation.trains import Span, passing_pressure
from cmbot.excitation.wind import AIR_KG_M3, DRAG, gust_spectrum, link_loads
from cmbot.planning import Plan, require_plan
from cmbot.scene import DamperFile, ExcitationFile, TrainsFile
from cmbot.simulation import PrescribedWork, SimulationOptions, elastic_arm_of, track_work

# Postures along the work, and for one record; those in which trains pass and dampers are tuned.
_POSTURES, _CLOSELY = 13, 49
_SOME = slice(None, None, 4)
_TRAINS_PER_HOUR = 4.0
# Of records and trains, s.
_STEP_S = 0.002
_CURVE_HZ = np.geomspace(*BAND_HZ, 400)


@dataclass(frozen=True, kw_only=True)
class Shaken(ShortRepr):
    """A work under a record or a train from its begin: how far the tool is from where it would be, m.

    Attributes
    ----------
    rms, peak : float, m
    peak_time : float, s
    by : str
        ``simulation`` of the whole elastic arm with all that is not linear, or, where a damper or the
        pressure of trains acts, ``modes`` along the work.
    """

    rms: float
    peak: float
    peak_time: float
    by: str


@dataclass(frozen=True, eq=False)
class _AlongWork:
    """Displacements of the tool (N, 3), m, at times `t` (N,), s, and by what they were found."""

    t: FloatArray
    tool: FloatArray
    by: str

    def at(self, times: FloatArray) -> FloatArray:
        return interpolated(times, self.t, self.tool)

    @property
    def figures(self) -> Shaken:
        size = np.linalg.norm(self.tool, axis=1)
        k, rms = int(size.argmax()), float(np.sqrt(np.mean(size**2)))
        return Shaken(rms=rms, peak=float(size[k]), peak_time=float(self.t[k]), by=self.by)


@dataclass(frozen=True, kw_only=True, eq=False)
class Excitation:
    """What shakes the arm of a plan, and how it answers.

    Attributes
    ----------
    kind : str
        What the deck does: ``spectrum``, ``record``, ``trains``, ``still``, or ``reference``, where the
        scene has no excitation: 1 m/s2 RMS along each axis, flat from 0.5 to 30 Hz.
    damping : float
        Ratio of every mode.
    reference : RandomSway
        Under that flat spectrum, without wind and damper.
    sway : RandomSway or None
        Under the scene's spectrum and gusts; None where nothing is random.
    simulated : Shaken or None
        Under the record, or the train at the worst of its speeds, from the begin of the work.
    accuracy : Accuracy or None
        The plan's budget with what shakes and leans the arm; None without an excitation in the scene.
    passages : tuple of Passage
    timetable : Timetable or None
    resonances_km_h : tuple of float
        Speeds within the asked range at which axles meet the span's first frequency.
    wind : float, m
        Largest displacement of the tool under the mean wind.
    adhesion : float or None, N
        Largest that a foot needs, the shaking and the mean wind included.
    adhesion_factor : float
        Peak to root mean square in it.
    damper : DamperGain or None
    curve_hz, curve : (F,), Hz and m per m/s2
        How far the tool moves by an acceleration of the deck that swings at a frequency, as the root of the
        sum of squares over the axes of both; the largest of the postures, with the damper.
    seconds : float
        Wall time.
    """

    kind: str
    damping: float
    reference: RandomSway
    sway: RandomSway | None
    simulated: Shaken | None
    accuracy: Accuracy | None
    passages: tuple[Passage, ...]
    timetable: Timetable | None
    resonances_km_h: tuple[float, ...]
    wind: float
    adhesion: float | None
    adhesion_factor: float
    damper: DamperGain | None
    curve_hz: Row
    curve: Row
    seconds: float

    def __repr__(self) -> str:
        return f"<Excitation: {self.kind}, {self.rms_mm:.2f} mm RMS at the tool>"

    @property
    def rms_mm(self) -> float:
        """Mean over the work of the tool's RMS in space, mm; of records and trains, as simulated."""
        if self.kind == "reference":
            return self.reference.rms_mm
        each = [0.0 if self.sway is None else self.sway.rms_mm]
        each += [] if self.simulated is None else [1e3 * self.simulated.rms]
        return float(np.hypot.reduce(each))


def excite(plan: Plan) -> Excitation:
    """Return what shakes the arm of a plan, as its scene says, and how the arm answers.

    Parameters
    ----------
    plan : Plan

    Raises
    ------
    InputError
        When `plan` is no plan, nothing of its arm bends, or a file that the scene names cannot be used.
    SimulationDiverged
        When a record shakes the arm beyond the model of springs.

    Examples
    --------
    >>> excitation = cmbot.excite(plan)
    >>> f"{excitation.rms_mm:.1f} mm RMS by 1 m/s2 of the deck"
    '10.5 mm RMS by 1 m/s2 of the deck'
    """
    require_plan(plan, "cmbot.excite")
    started = time.perf_counter()
    # The matrices are too small for several threads of linear algebra.
    with threadpool_limits(limits=1, user_api="blas"):
        found = _Excited(plan, plan.scene.excitation).answer()
    return replace(found, seconds=time.perf_counter() - started)


class _Excited:
    """A plan's arm; its inputs are the deck's acceleration, a pressure along y, and one along the wind."""

    def __init__(self, plan: Plan, given: ExcitationFile | None) -> None:
        self.plan, self.given = plan, given
        self.shaken, self.wind = (None, None) if given is None else (given.deck, given.wind)
        own = plan.robot.damping_ratio
        self.damping = own if given is None or given.damping is None else given.damping
        self.options = SimulationOptions(damping=self.damping, step_s=_STEP_S, output_step_s=_STEP_S)
        self.arm = elastic_arm_of(plan, self.options)
        require_bending(self.arm, plan.scene.source)
        self.work = PrescribedWork.planned(plan)
        self.t = np.linspace(0.0, self.work.duration, _POSTURES)
        self.postures = self.work.postures(self.t)
        given_damper = plan.scene.damper
        self.damper = self.best_place() if given_damper == "auto" else given_damper
        samples = plan.samples
        wrench = np.hstack([samples.guardrail_force, samples.guardrail_torque])
        self.wrench = interpolated(self.t, samples.t, wrench)

    def responses(
        self, arm: ElasticArm, postures: FloatArray, damper: DamperFile | None = None
    ) -> list[ModalResponse]:
        wind = 0.0 if self.wind is None else np.radians(self.wind.from_deg)
        towards = -np.array([np.cos(wind), np.sin(wind), 0.0])
        loads = [link_loads(np.array([0.0, 1.0, 0.0])), link_loads(towards, DRAG)]
        place = "tool" if damper is None else damper.at
        return [modal_response(arm, q, self.damping, loads, place) for q in postures]

    def answer(self) -> Excitation:
        plan, tolerance = self.plan, self.plan.scene.tool.tolerance
        responses = self.responses(self.arm, self.postures, self.damper)
        flat = _with_loads(flat_band())
        moments = [response.moments(flat, BAND_HZ) for response in responses]
        draw = partial(sampled_tool, self.t, responses, flat, BAND_HZ)
        asked = tolerance if self.given is None else None
        reference = sway_of(self.t, responses, moments, asked, draw)
        spectrum, band = self.random()
        # Against trains and records all frequencies of the band count alike.
        at_random = spectrum is not None and self.kind in ("spectrum", "still")
        damper = self.tuned(spectrum, band) if at_random and spectrum else self.tuned(flat, BAND_HZ)
        if damper is not None:
            responses = [replace(response, damper=damper.damper) for response in responses]
        sway, drawn = None, None
        if spectrum is not None:
            moments = [response.moments(spectrum, band) for response in responses]
            draw = partial(sampled_tool, self.t, responses, spectrum, band)
            drawn = first = draw(0)
            sway = sway_of(self.t, responses, moments, tolerance, lambda k: draw(k) if k else first)
        factor, steady = (sway or reference).peak_factor, self.mean_wind()
        still = np.array([response.static(steady) for response in responses])
        self.wrench += still[:, AXES:]
        needed = list[float | None]()
        if sway is not None or self.given is None:
            needed.append(shaken_adhesion(plan.robot, self.wrench, moments, factor))
        passages, times, resonances = self.trains(responses)
        needed += [each.adhesion for each in passages]
        inputs = self.deck(passages)
        known = None if inputs is None else self.along_work(inputs, responses)
        if inputs is not None and known is not None and not passages:
            added = [each.history(inputs(known.t), _STEP_S)[:, AXES:] for each in responses[_SOME]]
            needed.append(adhesion_of(plan.robot, added, self.wrench[_SOME], known.t))
        tool = [response.transfer(_CURVE_HZ)[:, :AXES, :AXES] for response in responses]
        return Excitation(
            kind=self.kind,
            damping=self.damping,
            reference=reference,
            sway=sway,
            simulated=None if known is None else known.figures,
            accuracy=None if self.given is None else self.accuracy(drawn, known, still[:, :AXES]),
            passages=passages,
            timetable=times,
            resonances_km_h=resonances,
            wind=float(np.linalg.norm(still[:, :AXES], axis=1).max()),
            adhesion=max((each for each in needed if each is not None), default=None),
            adhesion_factor=factor,
            damper=damper,
            curve_hz=_CURVE_HZ,
            curve=np.max([np.linalg.norm(each, axis=(1, 2)) for each in tool], axis=0),
            seconds=0.0,
        )

    @property
    def kind(self) -> str:
        if self.given is None:
            return "reference"
        return "still" if self.shaken is None else self.shaken.given

    def random(self) -> tuple[Spectrum | None, tuple[float, float]]:
        """The spectrum of what is random among the inputs, and its band, Hz; None where nothing is."""
        wind = self.wind
        gusty = wind is not None and wind.gusts_m_s > 0 and wind.mean_m_s > 0
        rows = None if self.shaken is None else self.shaken.spectrum
        if rows is None and not gusty:
            return None, BAND_HZ
        deck = None if rows is None else linear_spectrum(np.array(rows))
        low, high = BAND_HZ
        if rows is not None:
            low, high = (min(low, rows[0][0]), max(high, rows[-1][0])) if gusty else (rows[0][0], rows[-1][0])

        def spectrum(f: FloatArray) -> FloatArray:
            S = np.zeros((len(f), AXES + 2))
            if deck is not None:
                S[:, :AXES] = deck(f)
            if gusty and wind is not None:
                # Of the pressure: rho U v' about its mean.
                S[:, -1] = (AIR_KG_M3 * wind.mean_m_s) ** 2 * gust_spectrum(f, wind.mean_m_s, wind.gusts_m_s)
                S[(f < low) | (f > high), -1] = 0.0
            return S

        return spectrum, (low, high)

    def best_place(self) -> DamperFile:
        """A kilogram where Den Hartog's tuning of it leaves the least of the flat spectrum."""
        places = [DamperFile(at=at) for at in ("tool", *self.plan.robot.joints)]

        def left(damper: DamperFile) -> float:
            each = self.responses(self.arm, self.postures[_SOME], damper)
            tuned = [replace(some, damper=den_hartog(some, damper.mass_kg)) for some in each]
            return max(some.tool_variance(_with_loads(flat_band()), BAND_HZ) for some in tuned)

        return min(places, key=left)

    def mean_wind(self) -> FloatArray:
        steady = np.zeros(AXES + 2)
        if self.wind is not None:
            steady[-1] = AIR_KG_M3 * self.wind.mean_m_s**2 / 2
        return steady

    def tuned(self, spectrum: Spectrum, band: tuple[float, float]) -> DamperGain | None:
        """The damper that is best over postures and the stiffness interval; None where none is asked."""
        wanted = self.damper
        if wanted is None:
            return None
        arms = [self.arm if factor == 1 else self.arm.softened(factor) for factor in STIFFNESS_FACTORS]
        responses = [each for arm in arms for each in self.responses(arm, self.postures[_SOME], wanted)]
        given = {"frequency": wanted.frequency_hz, "damping": wanted.damping}
        return best_damper(responses, spectrum, band, wanted.mass_kg, wanted.at, **given)

    def trains(
        self, responses: Sequence[ModalResponse]
    ) -> tuple[tuple[Passage, ...], Timetable | None, tuple[float, ...]]:
        """The passages at each speed, what they leave of an hour, and the speeds of resonance, km/h."""
        deck = self.shaken
        if deck is None or deck.trains is None:
            return (), None, ()
        trains, tolerance = deck.trains, self.plan.scene.tool.tolerance
        loads = [self.load(trains, speed) for speed in trains.speeds_km_h]
        some, wrench = responses[_SOME], self.wrench[_SOME]
        passages = tuple(passage(load, some, tolerance, self.plan.robot, wrench) for load in loads)
        parts = [part for part in self.work.parts if part.path is not None]
        strokes = np.array([(part.begin, part.begin + part.motion.duration) for part in parts])
        speeds = [load.speed for load in loads]
        met = resonance_speeds(loads[0].train, loads[0].span.first, min(speeds), max(speeds))
        per_hour = _TRAINS_PER_HOUR if trains.per_hour is None else trains.per_hour
        times = timetable(per_hour, passages, strokes, [60 * minute for minute in trains.minutes or ()])
        return passages, times, tuple(3.6 * speed for speed in met)

    def load(self, trains: TrainsFile, speed_km_h: float) -> PassageLoad:
        given, train, speed = si_fields(trains.span), axles_of(trains.axles), speed_km_h / 3.6
        span = Span(mass=1e3 * given.pop("mass_t"), **given)
        passing = None if self.given is None else self.given.passing
        pressure = 0.0 if passing is None else passing_pressure(speed, passing.distance_m, passing.shape)
        return PassageLoad(span=span, train=train, speed=speed, pressure=pressure)

    def accuracy(
        self, drawn: FloatArray | None, known: _AlongWork | None, leaning: FloatArray
    ) -> Accuracy | None:
        """The plan's budget with random records (N, R, 3), what is known, and the mean wind (K, 3)."""
        t = self.t if known is None else known.t
        if drawn is not None:
            t = np.linspace(0.0, self.work.duration, len(drawn))
        steady = [_AlongWork(self.t, leaning, "")] + ([] if known is None else [known])
        tool = sum((each.at(t) for each in steady), np.zeros((len(t), AXES)))[:, None]
        return self.plan.accuracy_while(Shaking(t=t, tool=tool if drawn is None else tool + drawn))

    def deck(self, passages: Sequence[Passage]) -> Callable[[FloatArray], FloatArray] | None:
        """The inputs (N, 5) at times (N,) by a record or the worst train; None where there is neither."""
        deck = self.shaken
        if deck is not None and deck.record is not None:
            record = read_record(Path(deck.record), "excitation.deck.record")
            return lambda t: np.hstack([record.at(t), np.zeros((len(t), 2))])
        if deck is not None and deck.trains is not None:
            worst = max(passages, key=lambda each: each.tool)
            load = self.load(deck.trains, worst.speed_km_h)
            return lambda t: load.inputs(t, AXES + 2)
        return None

    def along_work(
        self, inputs: Callable[[FloatArray], FloatArray], responses: Sequence[ModalResponse]
    ) -> _AlongWork:
        """The tool along the work: simulated whole, where nothing but the deck acts, else by modes."""
        t = np.arange(0.0, self.work.duration + self.options.settle_s, _STEP_S)
        if self.damper is None and not inputs(t)[:, AXES:].any():
            ground = lambda t: inputs(t)[:, :AXES]  # noqa: E731
            shaken, still = (
                track_work(self.arm, self.work, self.options, sag=self.plan.sag, ground=moves)
                for moves in (ground, None)
            )
            return _AlongWork(shaken.t, shaken.error - still.error, "simulation")
        tuned = responses[0].damper
        each = self.responses(
            self.arm, self.work.postures(np.linspace(0.0, self.work.duration, _CLOSELY)), self.damper
        )
        systems = [PostureSystem.of(replace(response, damper=tuned), np.inf) for response in each]
        done = np.minimum(t / self.work.duration, 1.0)
        return _AlongWork(t, tool_along(systems, done, inputs(t)[:, :, None], _STEP_S)[:, 0], "modes")


def _with_loads(spectrum: Spectrum) -> Spectrum:
    """A spectrum of the deck, with loads that are still."""
    return lambda f: np.hstack([spectrum(f), np.zeros((len(f), 2))])
