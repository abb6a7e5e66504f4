"""How far tools sway on shaken decks: prints the tables of docs/excitation.md.

``python benchmarks/excitation.py`` plans the triangle as it stands and elsewhere; some minutes.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.fft import irfft, next_fast_len
from scipy.linalg import expm

import cmbot
from cmbot.common.errors import CmbotError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.excitation import PASSAGE_HEADINGS, passage_rows, sway_mm_per_m_s2
from cmbot.excitation.damper import best_damper
from cmbot.excitation.response import BAND_HZ, flat_band, ground_loads, modal_response
from cmbot.excitation.sway import PassageLoad, passage
from cmbot.excitation.trains import Span, train_of
from cmbot.planning import Plan, bending_arm
from cmbot.simulation import PrescribedWork

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
# Of the records: ratio of every mode, how many, at once, step, s, how long modes are kept, how long the arm
# stands still before, s.
DAMPING_RATIO, RECORDS, AT_ONCE = 0.01, 10_000, 500
RECORD_STEP_S, BLOCK_S, REST_S = 1 / 240, 0.1, 25.0


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


def recorded(plan: Plan) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Largest distances (R, 2) across and along the tool's axis of records, and mean squares (N,), m2.

    In batches; nothing is by modes. The deck's acceleration is linear between steps, by which it lacks 0.1 %
    at 4 Hz and 2 % at 20 Hz, and goes through the matrices of all elastic coordinates, which are renewed as
    the arm moves along its work. The first seconds it stands still.
    """
    work, arm = PrescribedWork.planned(plan), bending_arm(plan.scene, plan.robot)
    blocks = round(work.duration / BLOCK_S)
    rest, steps = round(REST_S / BLOCK_S), round(BLOCK_S / RECORD_STEP_S)
    each = [_recursion(arm, q) for q in work.postures((np.arange(blocks) + 0.5) * BLOCK_S)]
    count, size = steps * (rest + blocks) + 1, next_fast_len(2 * steps * (rest + blocks), real=True)
    f, rng = np.fft.rfftfreq(size, RECORD_STEP_S), np.random.default_rng(11)
    level = (np.sqrt(flat_band()(f) / (size * RECORD_STEP_S)) * size / 2)[:, :, None].astype(np.float32)
    for _ in range(RECORDS // AT_ONCE):
        X = rng.standard_normal((2, len(f), 3, AT_ONCE), dtype=np.float32)
        a = irfft((X[0] + 1j * X[1]) * level, size, axis=0)[:count]
        x = np.zeros((each[0][0].shape[0], AT_ONCE), dtype=np.float32)
        far, square = np.zeros((AT_ONCE, 2)), list[float]()
        for block in range(-rest, blocks):
            E, J, axis = each[max(block, 0)]
            for step in range(steps):
                at = (rest + block) * steps + step
                x = E @ np.vstack([x, a[at : at + 2].reshape(6, AT_ONCE)])
                if block >= 0:
                    y = J @ x[: len(x) // 2]
                    along, whole = axis @ y, (y**2).sum(axis=0)
                    across = np.sqrt(np.maximum(whole - along**2, 0.0))
                    np.maximum(far, np.stack([across, np.abs(along)], axis=1), out=far)
                    square.append(float(whole.mean()))
        yield far, np.array(square)


def _recursion(arm: ElasticArm, q: np.ndarray) -> tuple[np.ndarray, ...]:
    """What makes a state of the one before and two inputs, the tool by elastic coordinates, and its axis."""
    modes = arm_modes(arm, q)
    configuration, n = arm.configuration(q, modes.u), len(modes.u)
    rates = np.zeros((2 * n + 6, 2 * n + 6))
    forces = [modes.stiffness, modes.damping(DAMPING_RATIO) + arm.damping, ground_loads(arm, configuration)]
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n, :-3] = -np.linalg.solve(modes.mass, np.hstack(forces))
    # Inputs, and how they change, over one step.
    rates[2 * n : -3, -3:] = np.eye(3) / RECORD_STEP_S
    E = expm(rates * RECORD_STEP_S)[: 2 * n]
    E[:, 2 * n : -3] -= E[:, -3:]
    pose, J = arm.tool_jacobian(configuration, arm.model.createData())
    parts = E, J[:3, arm.elastic], pose.rotation[:, 2]
    return tuple(part.astype(np.float32) for part in parts)


def exceedance(plan: Plan) -> Iterator[tuple[str, ...]]:
    """RMS and the probability of leaving a tolerance beside 10,000 records, each integrated in time."""
    each = list(recorded(plan))
    far = np.concatenate([some for some, _ in each])
    rms = float(np.sqrt(np.mean([square for _, square in each], axis=0)).mean())
    spectrum = [[hz, *3 * [1 / (BAND_HZ[1] - BAND_HZ[0])]] for hz in BAND_HZ]
    typical = np.median(far, axis=0)
    for share in (0.02, 0.05, 0.1, 0.25, 0.5):
        across, along = typical * np.quantile((far / typical).max(axis=1), 1 - share)
        tolerance = {"across_mm": 1e3 * float(across), "along_axis_mm": 1e3 * float(along)}
        data = plan.scene.as_data() | {
            "excitation": {"damping": DAMPING_RATIO, "deck": {"spectrum": spectrum}}
        }
        data["tool"] = dict(data.get("tool") or {}) | {"tolerance": tolerance}
        told = cmbot.excite(replace(plan, scene=cmbot.load_scene(data))).sway
        off = f"{1e-3 * told.rms_mm / rms - 1:+.1%}"
        yield (
            plan.scene.name,
            off,
            f"{share:g}",
            f"{told.leaves:.3f}",
            f"{told.leaves / share:.2f}",
            told.leaves_by,
        )


def shaken_scenes() -> Iterator[Plan]:
    """The triangle, the line, and a Panda that sands on a bench which bends by its modes."""
    yield planned()
    yield cmbot.plan(cmbot.load_scene("line"), progress=False)
    shapes = np.diag([0.1, 0.1, 0.1, 0.3, 0.3, 0.3])
    modes = {
        "frequencies_hz": [6.0, 7.0, 12.0, 15.0, 18.0, 25.0],
        "damping": [0.01] * 6,
        "shapes": shapes.tolist(),
    }
    data = cmbot.load_scene("panda_sanding").as_data()
    data |= {"base": {"name": "bench", "modes": modes}, "guardrail": {}}
    yield cmbot.plan(cmbot.load_scene(data), progress=False)


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mujoco", action="store_true", help="only the trains, beside MuJoCo")
    parser.add_argument("--records", action="store_true", help="only probabilities, beside 10,000 records")
    options = parser.parse_args()
    if options.records:
        headings = ("scene", "RMS off by", "10,000 records", "told", "ratio", "by")
        _print(headings, (row for plan in shaken_scenes() for row in exceedance(plan)))
        return
    plan = planned()
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
