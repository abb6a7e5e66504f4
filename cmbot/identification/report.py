"""The results of an identification in rows and sentences, their file, and what is refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import groupby, permutations, product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import counted
from cmbot.common.reading.yaml_reader import yaml_text
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.stiffness_parameters import symmetric
from cmbot.identification.design import Proposal
from cmbot.identification.estimation import Identification, Part, Slip, estimate, parts
from cmbot.identification.measurements import Measurements
from cmbot.identification.model import DeflectionModel, SagAlong, measured_arm
from cmbot.identification.problem import MatchedFrequency, Problem
from cmbot.robot import Dynamics, Kinematics, Robot
from cmbot.scene import IdentifiedStiffness

HEADINGS = ("", "modelled", "identified", "factor", "sd, %", "before, %", "")
"""Of the columns of `identified_rows`."""

# Share of the prior's standard deviation above which nothing was told.
_UNSEEN_SHARE = 0.9
# By how much errors may be larger than stated, where chance hardly does that.
_MAX_ERROR_RATIO, _PLAIN_MISFIT = 5.0, 1e-3
# How far a stiffness may be from its model, in standard deviations of the prior: bases that mix all
# directions are 5 away. By what share of its bound a joint holds a weight: postures are about those proposed.
_MAX_STIFFNESS_SIGMAS, _HELD_SHARE, _NEVER_HELD_SHARE = 8.0, 1.1, 2.0
# In which deflections may be, by their factors; smaller ones, m, have no direction.
_UNITS = {1e3: "m", 1e-3: "um", 10.0: "cm", 0.1: "tenths of a millimetre", 0.01: "hundredths of a millimetre"}
_ZERO_M = 1e-12
_SLIP = "a slip, a wrong sign or axis, the gauge not at robot.tool_frame? Measure again or write null"
_AS_MODELLED = (
    "postures in deg where the key ends in _deg, the gauge at robot.tool_frame, "
    "a base as modelled (guardrail) or prior: {base: 2} in a sheet"
)
_KG = "kg, not g or N"
_ACCEPT = "--accept-misfit (in Python accept_misfit=True)"
# What a sensor shows of gravity at rest, in g, m/s2 and mm/s2, and by which share it may be off; how far a
# record's rest may be from gravity in its axes and posture, and how near others are that fit, deg.
_GRAVITY, _GRAVITY_SHARE, _MOST_OFF_DEG, _FITS_DEG = (1.0, 9.80665, 9806.65), 0.15, 15.0, 5.0
# Modes of a smaller probability are not told of a frequency.
_LEAST_SHARE_OF_A_MODE = 0.1
# The smallest probability that is told, per cent.
_LEAST_SHARE = 0.01
# Steps in which gauges are read, mm.
_STEPS_MM = (1.0, 0.1, 0.01, 0.001)
MODE_HEADINGS = ("measured in", "Hz", "damping, % of critical", "±", "mode, Hz predicted without it")
"""Of the columns of `mode_rows`."""

_BASE_DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")
_SIDEWAYS = ("base along x", "base along y", "base about z")


def identified_rows(found: Identification) -> Iterator[tuple[str, ...]]:
    """Yield what was identified: of links and joints the stiffness, of the base that against one push each.

    Name, modelled, identified, factor, standard deviation now and before, and whether it was told at all.
    """
    for name, modelled, identified, now, before in stiffness_rows(
        found.stiffness, _modelled_compliance(found)
    ):
        told, factor = "not seen: no finding" if is_unseen(now, before) else "", identified / modelled
        shares = f"{100 * now:.1f}", f"{100 * before:.1f}"
        yield name, f"{modelled:.4g}", f"{identified:.4g}", f"{factor:.3f}", *shares, told


def _modelled_compliance(found: Identification) -> FloatArray | None:
    """That of the base, (6, 6); None where it is rigid."""
    L = found.parameters.factor
    return L @ L.T if found.parameters.has_base else None


def is_unseen(now: float, before: float) -> bool:
    """Whether a standard deviation says that nothing was told beside what was known before."""
    return now > _UNSEEN_SHARE * before


def stiffness_rows(
    stiffness: IdentifiedStiffness, modelled: FloatArray | None
) -> Iterator[tuple[str, float, float, float, float]]:
    """Yield of every stiffness its name, as modelled and as identified, and its logarithm's deviations.

    These are standard deviations now and before, the latter NaN where the file does not tell.

    Parameters
    ----------
    stiffness : IdentifiedStiffness
    modelled : (6, 6), m/N, rad/N, rad/Nm, or None
        Compliance of the base as modelled; None: it is rigid.
    """
    Sigma, first = stiffness.covariance_matrix, len(stiffness.springs)
    springs, measured = (*stiffness.links, *stiffness.joints), stiffness.measured
    told = measured is not None and len(measured.prior_sd) == len(Sigma)
    prior = np.array(measured.prior_sd) if measured and told else np.full(len(Sigma), np.nan)
    deviations = zip(np.sqrt(np.diag(Sigma)).tolist(), prior.tolist(), strict=True)
    for (kind, name), each, deviation in zip(stiffness.springs, springs, deviations, strict=False):
        of = f"{name} E I, N m2" if kind == "link" else f"{name}, Nm/rad"
        yield of, each.modelled, each.factor * each.modelled, *deviation
    if stiffness.base is None:
        return
    C, was, before = np.linalg.inv(np.array(stiffness.base.stiffness)), np.full(6, np.inf), np.full(6, np.nan)
    if modelled is not None:
        was, before = 1 / np.diag(modelled), _base_deviations(modelled, np.diag(prior[first:] ** 2))
    # A push along one direction, all others free.
    each_base = np.stack([was, 1 / np.diag(C), _base_deviations(C, Sigma[first:, first:]), before], axis=1)
    for i, (stiff, now, deviation_now, deviation_before) in enumerate(each_base.tolist()):
        unit = "N/m" if i < 3 else "Nm/rad"
        yield f"base {_BASE_DIRECTIONS[i]}, {unit}", stiff, now, deviation_now, deviation_before


def _base_deviations(C: FloatArray, Sigma: FloatArray) -> FloatArray:
    """Standard deviations (6,) of the logarithms of the diagonal of a base's compliance C (6, 6).

    To first order about it, by the covariance (21, 21) of X: d C_ii = (L dX L')_ii.
    """
    L, basis = np.linalg.cholesky((C + C.T) / 2), np.stack([symmetric(row) for row in np.eye(21)])
    slopes = np.einsum("ia,pab,ib->ip", L, basis, L) / np.diag(C)[:, None]
    return np.asarray(np.sqrt(np.einsum("ip,pr,ir->i", slopes, Sigma, slopes)))


def mode_rows(found: Identification) -> Iterator[tuple[str, ...]]:
    """Yield the measured frequencies: row, Hz, damping and its standard deviation, mode, as predicted."""
    for each in found.matched:
        sheet = found.measurements[each.label.sheet]
        ratios = (each.damping, each.damping_deviation)
        damping = (f"{100 * ratio:.{digits}f}" for ratio, digits in zip(ratios, (2, 3), strict=True))
        told = (text if np.isfinite(each.damping) else "" for text in damping)
        record, key = sheet.modes[each.label.row].source, sheet.key(each.label.row)
        where = f"{record} ({key})" if record else f"{Path(sheet.source).name}: {key}"
        yield where, f"{each.frequency:.4g}", *told, _either(each) or "none is near"


def _either(match: MatchedFrequency) -> str:
    """Modes and the frequencies predicted of them; of those that mix all numbers, and that of the mixture."""
    kept = [k for k, share in enumerate(match.probabilities) if share > _LEAST_SHARE_OF_A_MODE]
    if match.told_apart and len(kept) > 1:
        numbers = " mixed with ".join(str(match.modes[k]) for k in kept)
        return f"{numbers} (the mixture: {match.predicted[0]:.4g} Hz)"
    return " or ".join(f"{match.modes[k]} ({match.predicted[k]:.4g} Hz)" for k in kept)


def _away(match: MatchedFrequency) -> float:
    """By how much a frequency is off, in logarithms."""
    return abs(float(np.log(match.frequency / match.predicted[0])))


def unseen(found: Identification) -> tuple[tuple[str, ...], int]:
    """Return the links and joints that were not seen, and the number of directions of the base's 21."""
    share = np.sqrt(np.diag(found.covariance)) / found.prior
    names = [name for _, name in found.parameters.springs]
    first = len(names)
    kept = tuple(name for name, each in zip(names, share[:first], strict=True) if each > _UNSEEN_SHARE)
    if not found.parameters.has_base:
        return kept, 0
    scale = found.prior[first:]
    values = np.linalg.eigvalsh(found.covariance[first:, first:] / np.outer(scale, scale))
    return kept, int((values > _UNSEEN_SHARE**2).sum())


def remarks(found: Identification) -> Iterator[str]:
    """Yield what an identification means: exactness along the job, what was not seen, doubts, assumptions."""
    yield from _misfits(found)
    for each in found.matched:
        sheet = found.measurements[each.label.sheet]
        key = f"{sheet.source}: {sheet.key(each.label.row)}: {each.frequency:.4g} Hz"
        if not each.modes:
            yield f"{key} is left out, as no mode of the arm is within 30 % of it."
        elif not each.told_apart:
            tells = (
                " record_axes (tool or W) in the sheet or table may tell."
                if sheet.setup.record_axes is None
                else ""
            )
            yield f"{key} may be of mode {_either(each)}: not told apart, it counts for their mean.{tells}"
    if found.before is not None and found.after is not None:
        yield (
            f"Sag along the job: {1e3 * found.after.rms:.2f} mm RMS, modelled {1e3 * found.before.rms:.2f}; "
            f"{_exactness(found.after)}; as modelled {100 * found.before.length_95:.0f} %."
        )
    names, directions = unseen(found)
    unknown = [", ".join(names)] * bool(names)
    unknown += [f"{directions} of the 21 numbers of the base"] * bool(directions)
    if unknown:
        yield f"Not seen, nearly as they were assumed: {' and '.join(unknown)}."
    if any(row[-1] and row[0].startswith(_SIDEWAYS) for row in identified_rows(found)):
        yield "A hanging weight hardly moves a base along x, y or about z; taps in four postures or more do."
    if (damping := found.stiffness.damping) is not None:
        yield (
            f"Damping of the modes in the records: {100 * damping.ratio:.2f} % of critical, standard "
            f"deviation {100 * damping.sd:.2g} % from mode to mode; used by all that sways with this file."
        )
    for weight in found.weights:
        off = round(1e3 * (weight.estimated - weight.stated)) + 0
        yield (
            f"Assumes {weight.stated:g} kg (weight_kg): deflections do not check it; its error, within "
            f"weight_sd_kg, is estimated as {off} g, standard deviation {1e3 * weight.deviation:.0f} g."
        )
    gauges = {sheet.setup.gauge_sd_mm for sheet in found.measurements if np.isfinite(sheet.deflection).any()}
    if gauges:
        errors = ", ".join(f"{gauge:g}" for gauge in sorted(gauges))
        finer = next(filter(None, map(_finer_gauge, found.measurements)), "")
        yield f"Assumes a gauge's error of {errors} mm (gauge_sd_mm), one standard deviation{finer}."
    if not any(sheet.setup.windup_sd_arcmin for sheet in found.measurements):
        yield "Assumes joints without play, which a weight would take up (windup_sd_arcmin: 0)."


def _finer_gauge(sheet: Measurements) -> str:
    """How to state an error that is not stated, where deflections are written in steps that are finer."""
    read = 1e3 * sheet.deflection[np.isfinite(sheet.deflection)]
    step = next(
        (step for step in _STEPS_MM if np.allclose(read / step, np.round(read / step), atol=1e-6)), 1.0
    )
    if "gauge_sd_mm" in sheet.setup.model_fields_set or step >= sheet.setup.gauge_sd_mm:
        return ""
    stated = f"--gauge {step:g}" if sheet.rows else f"gauge_sd_mm: {step:g}"
    return f"; deflections are written to {step:g} mm: if the gauge is as exact, state {stated}"


def _rests(found: Identification) -> Iterator[tuple[str, str, float, str]]:
    """Yield of records along known axes file, key, angle of their rest to gravity, deg, and what would fit.

    The angle of a record without gravity is NaN; in place of what would fit is then what it lacks.
    """
    rows = [(sheet, row) for sheet in found.measurements for row in range(len(sheet.q))]
    R_WT = Kinematics(found.modelled.robot).tool_poses(np.array([sheet.q[row] for sheet, row in rows]))[1]
    up = -found.modelled.model.gravity.linear / np.linalg.norm(found.modelled.model.gravity.linear)
    along = {"tool": up @ R_WT, "W": np.tile(up, (len(rows), 1))}
    for number, (sheet, row) in enumerate(rows):
        axes, modes = sheet.setup.record_axes, sheet.modes[row : row + 1]
        if axes is None or not modes or not modes[0].source:
            continue
        size, key = float(np.linalg.norm(modes[0].rest)), sheet.key(row, "record")
        if not any(abs(size / g - 1) < _GRAVITY_SHARE for g in _GRAVITY):
            without = " and ".join(np.array([*"xyz"])[np.isnan(modes[0].rest)])
            yield sheet.source, key, np.nan, f" (no column of {without})" * bool(without)
            continue
        gravity, rest, other = along[axes][number], modes[0].rest / size, "W" if axes == "tool" else "tool"
        tried = [(f"with record_axes: {other} it fits", rest @ along[other][number])]
        for (of, k), elsewhere in zip(rows, along[axes], strict=True):
            tried.append((f"it fits the posture of {of.key(k)}", rest @ elsewhere))
        for name, X_TF in _other_frames(found.modelled.robot) * (axes == "tool"):
            tried.append((f"with robot.tool_frame: {name} it fits", rest @ (gravity @ X_TF.rotation)))
        for order, signs in product(permutations(range(3)), product((1, -1), repeat=3)):
            if np.linalg.det(np.eye(3)[list(order)] * signs) < 0:
                continue  # a mirror, which no mounting is
            each = ", ".join("-" * (sign < 0) + "xyz"[k] for k, sign in zip(order, signs, strict=True))
            fits = f"with the sensor's {each} in place of x, y, z it fits"
            tried.append((fits, rest[list(order)] * signs @ gravity))
        # Of those that are alike the simplest.
        words, cosine = max(tried, key=lambda each: round(each[1], 2))
        fits = words if cosine > np.cos(np.radians(_FITS_DEG)) else "another posture or mounting?"
        yield sheet.source, key, float(np.degrees(np.arccos(min(1.0, rest @ gravity)))), fits


def _other_frames(robot: Robot) -> list[tuple[str, Any]]:
    """Frames of a robot's last link, the last first, and their poses in the tool's."""
    tool = robot.model.frames[robot.tool_frame_id]
    links = (each for each in robot.model.frames if each.type == pin.FrameType.BODY)
    mine = [each for each in links if each.parentJoint == tool.parentJoint]
    return [(each.name, tool.placement.actInv(each.placement)) for each in reversed(mine)]


def _misfits(found: Identification) -> Iterator[str]:
    """What does not fit, and which errors are larger for it."""
    rests = list(_rests(found))
    for source, key, off, fits in rests:
        if off > _MOST_OFF_DEG:
            away = f"its mean is {off:.0f} deg away from gravity along its record_axes"
            yield f"{source}: {key}: {away}; {fits}."
    if still := [f"{source}: {key}{lacks}" for source, key, off, lacks in rests if np.isnan(off)]:
        yield f"Without gravity along x, y and z in it, axes and posture are as stated: {', '.join(still)}."
    for part in found.parts:
        if part.scale == 1.0:
            continue
        if part.kind == "prior":
            yield (
                f"The arm is farther from its model than the prior says: its standard deviations are taken "
                f"{part.scale:.1f} times as large."
            )
            continue
        gauge = {sheet.setup.gauge_sd_mm for sheet in found.measurements}
        what, as_if = "natural frequencies", ""
        if part.kind == "deflection_mm":
            what = "deflections"
            as_if = f", as with a gauge of {part.scale * max(gauge):.2g} mm" if len(gauge) == 1 else ""
        yield (
            f"The {what} fit {part.scale:.1f} times worse than stated, which chance does with a probability "
            f"of {_percent(part.probability)}; the errors allow for that{as_if}."
        )
    for slip in found.slips:
        source, key, got, expected = _in_words(found, slip)
        yield f"Fits the others worst: {source}: {key}: got {got}, expected {expected}."


def _percent(probability: float) -> str:
    share = 100 * probability
    return f"{share:.1g} %" if share >= _LEAST_SHARE else f"less than {_LEAST_SHARE:g} %"


def _in_words(found: Identification, slip: Slip) -> tuple[str, str, str, str]:
    """File and key of a row that does not fit, its values, and those that the others predict."""
    kind, sheet, row = slip.label
    given = found.measurements[sheet]
    if kind == "frequencies_hz":
        got, about = (
            ", ".join(f"{f:.3g} Hz" for f in each) for each in (given.modes[row].frequencies, slip.expected)
        )
    else:
        seen = ~np.isnan(given.deflection[row])
        axes = [axis for axis, own in zip("xyz", seen, strict=True) if own]
        got, about = (_by_axis(axes, 1e3 * each) for each in (given.deflection[row, seen], slip.expected))
    away = f"by the others, {slip.deviations:.3g} standard deviations of their scatter away"
    return given.source, given.key(row, kind), got, f"about {about} {away}"


def _by_axis(axes: Sequence[str], values: FloatArray) -> str:
    return ", ".join(f"{axis} {value:.2f}" for axis, value in zip(axes, values, strict=True))


def require_fit(found: Identification) -> None:
    """Refuse measurements that plainly do not fit.

    Raises
    ------
    InputError
        A record's rest is not gravity along its axes, a joint cannot hold the weight, a row is far from what
        the others predict, all of them fit several times worse than stated, most frequencies of a posture are
        of no mode, or the arm is far from its model.
    """
    for source, key, off, fits in _rests(found):
        if off > _MOST_OFF_DEG:
            got = f"a mean {off:.0f} deg away from gravity in this posture along its record_axes"
            raise InputError(source, key, got, f"less than {_MOST_OFF_DEG:g}: {fits}; or {_ACCEPT}")
    # So wrong a weight explains what does not fit.
    _require_held(found, _NEVER_HELD_SHARE)
    if wrong := [slip for slip in found.slips if slip.significant]:
        (source, key, got, expected), *others = (_in_words(found, slip) for slip in wrong)
        also = "".join(f"; nor does {other[1]} fit" for other in others)
        todo = (
            "a slip, another posture, the weight still on, a wrong weight_kg? Measure again or leave it out"
        )
        if wrong[0].label.kind == "deflection_mm":
            todo = _mistaken(found, wrong[0]) or _SLIP
        raise InputError(source, key, got, f"{expected}{also}: {todo}; or {_ACCEPT}")
    for part in _plain(found.parts):
        source, key = found.measurements[0].source, "measurements"
        if part.kind == "prior":
            got = f"an arm {part.scale:.0f} times farther from its model than the prior says"
            expected = f"deflections in mm by weight_kg in {_KG}, {_AS_MODELLED}"
        else:
            got = f"{part.kind} that fit {part.scale:.0f} times worse than stated"
            expected = (
                f"right units (mm; {_KG}), places with the weight less those without it, axes, gauge_sd_mm, "
                f"windup_sd_arcmin, {_AS_MODELLED}"
            )
        if part.kind == "frequencies_hz":
            expected = "records of this arm in these postures, without the weight, true weight_kg and errors"
            far = max((each for each in found.matched if each.modes), key=_away)
            sheet = found.measurements[far.label.sheet]
            source, key = sheet.source, sheet.key(far.label.row)
            got = f"{got}: {far.frequency:.4g} Hz of mode {_either(far)}"
        expected = _mistaken(found) or expected
        raise InputError(source, key, got, f"{expected}; or {_ACCEPT}")
    _require_held(found, _HELD_SHARE)
    _require_modes(found)
    _require_prior(found)


def _require_held(found: Identification, most_share: float) -> None:
    """Refuse a weight with which a joint bears more than a share of its bound in a posture."""
    robot = found.modelled.robot
    bound = np.where(robot.limits.assumed_torque, np.inf, robot.limits.torque)
    for sheet in found.measurements:
        rows, kg = np.flatnonzero(np.isfinite(sheet.deflection).any(axis=1)), sheet.setup.weight_kg
        if not len(rows):
            continue
        robots = robot, measured_arm(sheet.scene, kg).robot
        rest, torque = (Dynamics(each).static_efforts(sheet.q[rows]).joint_torque for each in robots)
        # A joint that does not hold the arm without the weight says nothing of the weight.
        use = np.where(np.abs(rest) < bound, np.abs(torque) / bound, 0.0)
        k, joint = np.unravel_index(use.argmax(), use.shape)
        if use[k, joint] <= most_share:
            continue
        by, unit = torque[k, joint] - rest[k, joint], "N" if robot.limits.prismatic[joint] else "Nm"
        most = kg * (bound[joint] - np.sign(by) * rest[k, joint]) / abs(by)
        got = f"{kg:g} kg, with which {robot.joints[joint]} bears {abs(torque[k, joint]):.3g} {unit}"
        expected = f"at most {bound[joint]:.3g} {unit}, which holds {most:.2g} kg in this posture"
        raise InputError(
            sheet.source, sheet.key(rows[k]), got, f"{expected}; weight_kg in {_KG}; or {_ACCEPT}"
        )


def _require_modes(found: Identification) -> None:
    """Refuse frequencies of which most, in a posture, are of no mode of the arm that deflections tell."""
    for label, each in groupby(found.matched, key=lambda match: match.label):
        given, sheet = list(each), found.measurements[label.sheet]
        far = [f"{match.frequency:.4g}" for match in given if not match.modes]
        if 2 * len(far) <= len(given) or not np.isfinite(sheet.deflection).any():
            continue
        slowest = arm_modes(found.arm, sheet.q[label.row]).frequencies[0]
        got = f"{', '.join(far)} Hz, {len(far)} of {len(given)} frequencies, 30 % or more from every mode"
        expected = f"modes as the deflections tell them, the slowest of {slowest:.3g} Hz: a wrong weight_kg?"
        raise InputError(sheet.source, sheet.key(label.row), got, f"{expected} Or {_ACCEPT}")


def _require_prior(found: Identification) -> None:
    """Refuse a stiffness that is farther from its model than what was known before allows."""
    rows = stiffness_rows(found.stiffness, _modelled_compliance(found))
    away = ((name, now / was, before) for name, was, now, _, before in rows)
    off, name, factor, before = max((abs(float(np.log(by))) / sd, name, by, sd) for name, by, sd in away)
    if off <= _MAX_STIFFNESS_SIGMAS:
        return
    got = (
        f"{name.partition(',')[0]} {factor:.3g} times as stiff as modelled, {off:.1f} standard deviations of "
        f"what is known before ({100 * before:.0f} %)"
    )
    expected = f"deflections in mm by weight_kg in {_KG}, {_AS_MODELLED}"
    raise InputError(found.measurements[0].source, "measurements", got, f"{expected}; or {_ACCEPT}")


def _mistaken(found: Identification, slip: Slip | None = None) -> str:
    """What deflections are in place of mm along W, all of them or a row; empty where nothing tried fits."""
    sheets, zero = found.measurements, np.zeros(found.parameters.count)
    models = (DeflectionModel(found.modelled, each.setup, each.q) for each in sheets)
    modelled = np.concatenate([model.at(zero)[0] for model in models])
    given = np.concatenate([each.deflection for each in sheets])
    starts = np.cumsum([0, *(len(each.q) for each in sheets)])
    row = starts[-1] if slip is None else starts[slip.label.sheet] + slip.label.row
    for own in (slice(None), slice(row, row + 1)):
        off = partial(_off, expected=modelled[own])
        tried = ((given[own][:, order] * factors, words) for words, order, factors in _mistakes())
        # Of those that are alike the simplest.
        righted, words = min(tried, key=lambda each: round(off(each[0]), 2))
        if off(righted) >= off(given[own]) / 2:
            continue
        every = given.copy()
        every[own] = righted
        parts = zip(sheets, np.split(every, starts[1:-1]), strict=True)
        with suppress(InputError):
            trial = estimate([replace(sheet, deflection=part) for sheet, part in parts], found.modelled)
            wrong, before = (sum(slip.significant for slip in each.slips) for each in (trial, found))
            if not _plain(trial.parts) and (wrong < before or not wrong):
                return words
    robot = found.modelled.robot
    frames = (name for name, X_TF in _other_frames(robot) if np.linalg.norm(X_TF.translation) > _ZERO_M)
    if _fits_at(found, robot.tool_frame) or not (
        places := [name for name in frames if _fits_at(found, name)]
    ):
        return ""
    return f"the gauge at robot.tool_frame ({robot.tool_frame}): at {' or '.join(places)} it fits"


def _fits_at(found: Identification, frame: str) -> bool:
    """Whether deflections alone fit as those of a frame of the last link."""
    arm, sheets = found.modelled, [replace(sheet, modes=()) for sheet in found.measurements]
    with suppress(InputError):
        robot = replace(arm.robot, tool_frame=frame)
        problem = Problem(sheets, elastic_arm(robot, arm.base, arm.options))
        return all(part.probability > _PLAIN_MISFIT for part in parts(problem, problem.first()))
    return False


def _off(measured: FloatArray, expected: FloatArray) -> float:
    """How far deflections (k, 3) are off in direction, one less the cosine, and size, powers of ten."""
    a, b = np.nan_to_num(measured), np.where(np.isnan(measured), 0.0, expected)
    sizes = np.linalg.norm([a.ravel(), b.ravel()], axis=1) + _ZERO_M
    return float(1 - (a * b).sum() / sizes.prod() + abs(np.log10(sizes[0] / sizes[1])))


def _mistakes() -> Iterator[tuple[str, list[int], list[float]]]:
    """Yield in words what deflections may be, and the order of their axes and the factors that right them."""
    for factor, unit in _UNITS.items():
        yield f"deflections in mm: times {factor:g} these fit, as if in {unit}", [0, 1, 2], 3 * [factor]
    for axes, order in (("x and y", [1, 0, 2]), ("x and z", [2, 1, 0]), ("y and z", [0, 2, 1])):
        yield f"columns along x, y, z of W: with {axes} exchanged it fits", order, 3 * [1.0]
    for axes in ("x", "y", "z", "x, y", "x, z", "y, z", "x, y, z"):
        words = f"the place with the weight less that without it: the other sign of {axes} fits"
        yield words, [0, 1, 2], [-1.0 if axis in axes else 1.0 for axis in "xyz"]


def _plain(parts: Sequence[Part]) -> list[Part]:
    """Those whose errors are larger by more than is taken for chance.

    Frequencies that contradict an arm far from its model do so twice, as by a wrong weight.
    """
    twice = {part.kind for part in parts if part.scale > 1} >= {"prior", "frequencies_hz"}
    levels = (1.0 if twice and part.kind == "frequencies_hz" else _PLAIN_MISFIT for part in parts)
    pairs = zip(parts, levels, strict=True)
    return [part for part, p in pairs if part.scale > _MAX_ERROR_RATIO and part.probability <= p]


def proposal_remarks(found: Proposal) -> Iterator[str]:
    """Yield how exact the tool will be after the proposed measurements, and on what that rests."""
    setup = found.setup
    so_far, noun = "as modelled, joints bending", "posture"
    if found.measured:
        so_far, noun = f"as {counted(found.measured, 'posture')} told", "more posture"
    number, axes = counted(len(found.q), noun), "".join(np.array(list("xyz"))[found.seen])
    yield (
        f"The sag along the job is {1e3 * found.after.rms:.2f} mm RMS {so_far}, known within "
        f"{100 * found.before.length_95:.2g} %."
    )
    error = 1e3 * found.after.rms * found.after.share
    yield (
        f"After {number} with {setup.weight_kg:g} kg, {axes} to {setup.gauge_sd_mm:g} mm: "
        f"{_exactness(found.after)}; with that compensated, {error:.2f} mm RMS of it would be left."
    )
    yield (
        f"Chosen from {found.candidates} postures that are clear of everything and that the joints can hold "
        "with the weight, in the order of a short tour; the ways between them are not checked."
    )


def _exactness(sag: SagAlong) -> str:
    return (
        f"it is known within {100 * sag.length_95:.1f} %, as a vector within {100 * sag.share_95:.1f} %, "
        "with a probability of 95 %"
    )


def stiffness_text(stiffness: IdentifiedStiffness, source: str) -> str:
    """Return the file of an identified stiffness; `source` is where the measurements came from."""
    data = stiffness.model_dump(mode="json", exclude_none=True)
    return f"# Written by cmbot identify from {source}. In a scene: identified: THIS_FILE\n{yaml_text(data)}"
