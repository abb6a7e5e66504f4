"""How far tools sway on shaken decks: prints the tables of docs/excitation.md.

``python benchmarks/excitation.py`` plans the triangle as it stands and elsewhere; some minutes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import cmbot
from cmbot.common.errors import CmbotError
from cmbot.excitation import PASSAGE_HEADINGS, passage_rows, sway_mm_per_m_s2
from cmbot.excitation.damper import best_damper
from cmbot.excitation.passages import PassageLoad, passage
from cmbot.excitation.response import BAND_HZ, flat_band, modal_response
from cmbot.excitation.sway import sampled_tool, sway_of
from cmbot.excitation.trains import Span, train_of
from cmbot.planning import Plan, bending_arm
from cmbot.scene import Tolerance

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "helpers"))
from trains_in_mujoco import passed

SPAN = {"length_m": 24, "first_hz": 5.5, "mass_t_m": 3.5, "damping": 0.005, "at_m": 12}
TRAINS = {"freight": [40, 60, 80, 100, 120], "emu": [80, 120, 160]}
STANCES: Mapping[str, Any] = {
    "shipped": None,
    "post_4, 0.54 m": {"foot_1": {"member": "post_4", "along_m": 0.54, "face": "outer"}, "foot_2": "free"},
    "post_4, 1.10 m": {"foot_1": {"member": "post_4", "along_m": 1.1, "face": "outer"}, "foot_2": "free"},
}
DAMPING = (0.005, 0.01, 0.02, 0.04, 0.08)
PLACES = ("tool", "joint_4", "arm_base")
MASSES = (0.5, 1.0, 2.0)
STIFFNESS = (0.7, 1.0, 1.3)
TIMESTEP = 4e-4


def planned(**keys: Any) -> Plan:
    """The triangle with other keys, planned."""
    return cmbot.plan(cmbot.load_scene(cmbot.load_scene("triangle").as_data() | keys), progress=False)


def stances() -> Iterator[tuple[str, ...]]:
    """Sway, slowest mode, sag and torque of stances."""
    for name, stance in STANCES.items():
        keys = {} if stance is None else {"guardrail": {"stance": stance}}
        try:
            plan = planned(**keys)
        except CmbotError as error:
            yield name, *4 * ("-",), f"({error})"
            continue
        excitation = cmbot.excite(plan)
        arm = bending_arm(plan.scene, plan.robot)
        moments = [
            modal_response(arm, q, 0.01).moments(flat_band(1.0, (2.0, 30.0)), (2.0, 30.0))
            for q in plan.trajectory.evaluate(np.linspace(*plan.trajectory.t[[0, -1]], 5))
        ]
        narrow = 1e3 * np.mean([np.sqrt(np.trace(each.value[:3, :3])) for each in moments])
        peak = plan.figures.peak_guardrail_torque
        first = excitation.reference.first_hz.min()
        yield name, f"{peak:.0f}", f"{first:.1f}", f"{excitation.rms_mm:.1f}", f"{narrow:.1f}"


def damping(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Sway by the ratio of damping."""
    arm, q = bending_arm(plan.scene, plan.robot), plan.trajectory.q[0]
    for ratio in DAMPING:
        variance = modal_response(arm, q, ratio).tool_variance(flat_band(), BAND_HZ)
        yield f"{100 * ratio:g} %", f"{1e3 * np.sqrt(variance):.1f}"


def dampers(plan: Plan) -> Iterator[tuple[str, ...]]:
    """What the best dampers leave of the sway, over postures and stiffnesses."""
    arm = bending_arm(plan.scene, plan.robot)
    postures = plan.trajectory.evaluate(np.linspace(*plan.trajectory.t[[0, -1]], 4))
    arms = [arm.softened(factor) for factor in STIFFNESS]
    for place in PLACES:
        responses = [modal_response(each, q, 0.01, place=place) for each in arms for q in postures]
        for mass in MASSES:
            gain = best_damper(responses, flat_band(), BAND_HZ, mass, place)
            tuned, share = gain.damper, gain.rms_with / gain.rms_without
            yield (
                place,
                f"{mass:g} kg",
                f"{tuned.frequency:.2f} Hz",
                f"{tuned.damping:.2f}",
                f"{100 * share:.0f} %",
            )


def trains(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Passages of trains over an assumed span."""
    tolerance = {"tolerance": {"across_mm": 5.0, "along_axis_mm": 10.0}}
    for name, speeds in TRAINS.items():
        deck = {"deck": {"trains": {"axles": name, "speeds_km_h": speeds, "span": SPAN}}}
        data = plan.scene.as_data() | {"excitation": deck, "tool": tolerance}
        excitation = cmbot.excite(replace(plan, scene=cmbot.load_scene(data)))
        yield from ((name, *row) for row in passage_rows(excitation))


def against_mujoco(plan: Plan) -> Iterator[tuple[str, ...]]:
    """The table of trains beside axles over an integrated beam and the same arm in MuJoCo on it."""
    names = {"length_m": "length", "first_hz": "first", "damping": "damping", "at_m": "at"}
    span = Span(mass=1e3 * SPAN["mass_t_m"], **{name: SPAN[key] for key, name in names.items()})
    arm, t = bending_arm(plan.scene, plan.robot), plan.trajectory.t
    postures = plan.trajectory.evaluate(np.linspace(t[0], t[-1], 4))
    responses = [modal_response(arm, q, 0.01) for q in postures]
    for name, speeds in TRAINS.items():
        train = train_of(name)
        for speed in speeds:
            load = PassageLoad(span=span, train=train, speed=speed / 3.6)
            ours = passage(load, responses, None, plan.robot, np.zeros((4, 6)))
            each = [passed(arm, q, 0.01, span, train, speed / 3.6, TIMESTEP) for q in postures]
            tool, torque = np.max(each, axis=0)
            off = f"{100 * (ours.tool / tool - 1):+.1f} %", f"{100 * (ours.torque / torque - 1):+.1f} %"
            yield name, f"{speed}", f"{1e3 * ours.tool:.2f}", f"{1e3 * tool:.2f}", *off


def exceedance(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Probability of leaving a tolerance beside 10,000 records, each mode integrated in time."""
    arm, seconds, step, rest, t = bending_arm(plan.scene, plan.robot), 8.0, 1 / 80, 2000, np.zeros(2)
    t[1] = seconds
    two = [modal_response(arm, plan.trajectory.q[0], 0.01)] * 2
    count, rng, axis = rest + round(seconds / step) + 1, np.random.default_rng(11), two[0].axis
    f = np.arange(count + 1) / (2 * count * step)
    scale = np.sqrt(flat_band()(f) / (2 * count * step)) * count
    far = np.empty((10_000, 2))
    for record in far:
        X = rng.normal(size=(2, len(f), 3))
        a = np.fft.irfft((X[0] + 1j * X[1]) * scale, axis=0)[:count]
        y = two[0].history(a, step)[rest:, :3]
        record[:] = np.linalg.norm(y - np.outer(y @ axis, axis), axis=1).max(), np.abs(y @ axis).max()
    typical = np.median(far, axis=0)
    moments = [each.moments(flat_band(), BAND_HZ) for each in two]
    for share in (0.02, 0.05, 0.1, 0.25, 0.5):
        across_mm, along_axis_mm = 1e3 * typical * np.quantile((far / typical).max(axis=1), 1 - share)
        tolerance = Tolerance(across_mm=across_mm, along_axis_mm=along_axis_mm)
        draw = partial(sampled_tool, t, two, flat_band(), BAND_HZ)
        told = sway_of(t, two, moments, tolerance, draw)
        yield f"{share:g}", f"{told.leaves:.3f}", f"{told.leaves / share:.2f}", f"{told.leaves_by}"


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mujoco", action="store_true", help="only the trains, beside MuJoCo")
    parser.add_argument("--records", action="store_true", help="only probabilities, beside 10,000 records")
    options, plan = parser.parse_args(), planned()
    if options.records:
        _print(("10,000 records", "told", "ratio", "by"), exceedance(plan))
        return
    if options.mujoco:
        headings = ("train", "km/h", "tool, mm", "in MuJoCo, mm", "tool off by", "torque off by")
        _print(headings, against_mujoco(plan))
        return
    begun = time.perf_counter()
    reference = cmbot.excite(plan)
    print(f"triangle: {reference.rms_mm:.2f} mm RMS by 1 m/s2, {time.perf_counter() - begun:.1f} s")
    print(f"sway_mm_per_m_s2: {sway_mm_per_m_s2(plan):.2f}\n")
    headings = ("stance", "peak at work, Nm", "first mode, Hz", "0.5-30 Hz, mm", "2-30 Hz, mm")
    _print(headings, stances())
    _print(("damping", "0.5-30 Hz, mm"), damping(plan))
    _print(("damper at", "mass", "frequency", "ratio", "RMS left"), dampers(plan))
    _print(("train", *PASSAGE_HEADINGS), trains(plan))


def _print(headings: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> None:
    print(f"| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)
    print()


if __name__ == "__main__":
    main()
