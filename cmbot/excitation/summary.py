"""What is said of an excitation: rows of figures, a row for each speed of the trains, and a few sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.elastic.first_order import BAND_HZ
from cmbot.excitation.damper import STIFFNESS_FACTORS, DamperGain
from cmbot.excitation.excite import Excitation
from cmbot.excitation.sway import RandomSway

PASSAGE_HEADINGS = (
    *("speed, km/h", "tool, mm", "torque added, Nm", "adhesion, kN", "passes, s", "still after, s"),
    *("pause, s", "tolerance"),
)
_LIMIT_WORDS = {None: "-", True: "kept", False: "left"}


def excitation_rows(excitation: Excitation) -> Iterator[tuple[str, str]]:
    """Yield the figures of an excitation, each as its name and unit, and its value."""
    reference, shaken = excitation.reference, excitation.simulated
    low, high = BAND_HZ
    yield f"tool by 1 m/s2 of the deck, {low:g}-{high:g} Hz, RMS, mm", f"{reference.rms_mm:.2f}"
    yield "slowest mode, Hz", f"{reference.first_hz.min():.2f}"
    if excitation.sway is not None:
        yield from _sway(excitation.sway, random_inputs(excitation))
    if shaken is not None:
        value = f"{1e3 * shaken.rms:.2f}, {1e3 * shaken.peak:.2f}"
        by = {"simulation": "simulated whole", "modes": "by its modes along the work"}[shaken.by]
        what = "record"
        if excitation.passages:
            what = f"worst train, {max(excitation.passages, key=lambda each: each.tool).speed_km_h:g} km/h"
        yield f"tool under the {what}, {by}, RMS and largest, mm", value
    if (accuracy := excitation.accuracy) is not None:
        name = f"tool from its path with {100 * accuracy.probability:g} %, all counted, at most, mm"
        yield name, f"{accuracy.within_mm:.2f}"
        if accuracy.tolerance_share is not None:
            yield "probability of keeping the tolerance, all counted", f"{accuracy.tolerance_share:.3g}"
    if excitation.wind:
        yield "tool under the mean wind, mm", f"{1e3 * excitation.wind:.2f}"
    if excitation.adhesion is not None:
        yield "adhesion needed at work, kN", f"{excitation.adhesion / 1e3:.2f}"
    if excitation.damper is not None:
        yield from _damper(excitation.damper)
    if excitation.timetable is not None:
        yield "work in an hour, s", f"{excitation.timetable.work_s:.0f}"


def random_inputs(excitation: Excitation) -> str:
    """Return what the random part of an excitation is by."""
    if excitation.sway is None:
        return "1 m/s2 of the deck"
    return "spectrum and gusts" if excitation.kind == "spectrum" else "gusts alone"


def _sway(sway: RandomSway, by: str) -> Iterator[tuple[str, str]]:
    yield f"tool under {by}, RMS, mm", f"{sway.rms_mm:.2f}"
    value = f"{1e3 * sway.across.max():.2f}, {1e3 * sway.along.max():.2f}"
    yield "largest across its axis, along it, RMS, mm", value
    yield "mean of the largest displacement, mm", f"{1e3 * sway.peak:.2f}"
    if sway.leaves is not None:
        most = "at most " if sway.leaves_by == "crossings" else ""
        yield f"probability of leaving the tolerance by {by}", f"{most}{sway.leaves:.3g}"


def _damper(gain: DamperGain) -> Iterator[tuple[str, str]]:
    tuned = gain.damper
    name = f"damper of {tuned.mass:g} kg at {gain.at}, Hz and ratio"
    yield name, f"{tuned.frequency:.2f}, {tuned.damping:.3f}"
    with_it, without = (
        1e3 * np.reshape(each, (len(STIFFNESS_FACTORS), -1)) for each in (gain.each_with, gain.each_without)
    )
    for factor, left, before in zip(STIFFNESS_FACTORS, with_it, without, strict=True):
        name = f"largest RMS with it, without, mm, left over postures, stiffness times {factor:g}"
        shares = 100 * left / before
        yield name, f"{left.max():.2f}, {before.max():.2f}, {shares.min():.0f} to {shares.max():.0f} %"


def passage_rows(excitation: Excitation) -> Iterator[tuple[str, ...]]:
    """Yield a row for each speed of the trains, under `PASSAGE_HEADINGS`."""
    for each in excitation.passages:
        yield (
            *(f"{each.speed_km_h:g}", f"{1e3 * each.tool:.2f}", f"{each.torque:.0f}"),
            "-" if each.adhesion is None else f"{each.adhesion / 1e3:.2f}",
            *(f"{each.passes_s:.1f}", f"{each.still_s:.1f}", f"{each.pause_s:.1f}", _LIMIT_WORDS[each.kept]),
        )


def excitation_sentences(excitation: Excitation) -> Iterator[str]:
    """Yield what is to be said of an excitation beside its figures."""
    if excitation.kind == "reference":
        yield "The scene has no excitation: figures are for a deck of 1 m/s2 RMS along each axis."
    times = excitation.timetable
    if times is None:
        return
    left = ", ".join(f"{each.speed_km_h:g}" for each in excitation.passages if each.kept is False)
    kept = ", ".join(f"{each.speed_km_h:g}" for each in excitation.passages if each.kept)
    if left:
        yield f"The tool leaves its tolerance at {left} km/h; it keeps it at {kept or 'no speed'}."
    if met := ", ".join(f"{speed:.0f}" for speed in excitation.resonances_km_h):
        yield f"Axles meet the span's first frequency at {met} km/h."
    if times.pause_s:
        at = ", ".join(f"{time:.1f}" for time in times.pauses_at_s)
        yield (
            f"For a train the work pauses for {times.pause_s:.0f} s, at the end of a stroke ({at} s of the "
            f"work); {times.per_hour:g} trains an hour leave {times.work_s:.0f} s of it."
        )
    if times.rests_s:
        rests = ", ".join(f"{_clock(begin)} to {_clock(end)}" for begin, end in times.rests_s)
        yield f"Of each hour it rests from {rests}, minutes and seconds."


def _clock(seconds: float) -> str:
    return "{:02d}:{:02d}".format(*divmod(round(seconds), 60))
