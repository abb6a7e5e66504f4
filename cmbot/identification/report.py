"""What an identification tells, in rows and sentences, and the file of it."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from cmbot.common.validation import counted
from cmbot.elastic.stiffness_parameters import symmetric
from cmbot.identification.design import Proposal
from cmbot.identification.estimation import Identification
from cmbot.identification.model import SagAlong
from cmbot.scene import IdentifiedStiffness

__all__ = ["HEADINGS", "identified_rows", "proposal_remarks", "remarks", "stiffness_text", "unseen"]

HEADINGS = ("", "modelled", "identified", "factor", "sd, %", "before, %", "")
"""Of the columns of `identified_rows`."""

# Share of the prior's standard deviation above which nothing was told.
_UNSEEN = 0.9
# Probability of a larger misfit below which the model is doubted.
_DOUBTED = 0.01
# The smallest probability that is told, per cent.
_LEAST_SHARE = 0.01
_BASE = ("along x", "along y", "along z", "about x", "about y", "about z")


def identified_rows(found: Identification) -> Iterator[tuple[str, ...]]:
    """Yield what was identified: of links and joints the stiffness, of the base that against one push each.

    Name, modelled, identified, factor, standard deviation now and before, and whether it was told at all.
    """
    deviation = np.sqrt(np.diag(found.covariance))
    given = (*found.stiffness.links, *found.stiffness.joints)
    units = [("E I", "N m2") if kind == "link" else ("", "Nm/rad") for kind, _ in found.parameters.springs]
    for k, (each, (letter, unit)) in enumerate(zip(given, units, strict=True)):
        name = f"{each.name} {letter}".rstrip()
        numbers = (each.modelled, each.factor * each.modelled, deviation[k], found.prior[k])
        yield _row(f"{name}, {unit}", *numbers)
    if not found.parameters.has_base:
        return
    first, L = len(found.parameters.springs), found.parameters.factor
    basis = np.stack([symmetric(row) for row in np.eye(21)])
    before = found.prior[first:]
    C = np.linalg.inv(np.array(found.stiffness.base.stiffness)) if found.stiffness.base else L @ L.T
    # To first order about the modelled one: d C_ii = (L dX L')_ii.
    slopes = np.einsum("ia,pab,ib->ip", L, basis, L) / np.diag(L @ L.T)[:, None]
    Sigma = found.covariance[first:, first:]
    for i, name in enumerate(_BASE):
        now, was = np.sqrt(slopes[i] @ Sigma @ slopes[i]), np.sqrt(slopes[i] ** 2 @ before**2)
        unit = "N/m" if i < 3 else "Nm/rad"
        yield _row(f"base {name}, {unit}", 1 / (L @ L.T)[i, i], 1 / C[i, i], now, was)


def _row(name: str, modelled: float, identified: float, now: float, before: float) -> tuple[str, ...]:
    told = "" if now <= _UNSEEN * before else "not seen"
    factor = identified / modelled
    shares = f"{100 * now:.1f}", f"{100 * before:.1f}"
    return name, f"{modelled:.4g}", f"{identified:.4g}", f"{factor:.3f}", *shares, told


def unseen(found: Identification) -> tuple[tuple[str, ...], int]:
    """Return the links and joints that were not seen, and the number of directions of the base's 21."""
    share = np.sqrt(np.diag(found.covariance)) / found.prior
    names = [name for _, name in found.parameters.springs]
    first = len(names)
    kept = tuple(name for name, each in zip(names, share[:first], strict=True) if each > _UNSEEN)
    if not found.parameters.has_base:
        return kept, 0
    scale = found.prior[first:]
    values = np.linalg.eigvalsh(found.covariance[first:, first:] / np.outer(scale, scale))
    return kept, int((values > _UNSEEN**2).sum())


def remarks(found: Identification) -> Iterator[str]:
    """Yield what an identification means: exactness along the job, what was not seen, doubts, assumptions."""
    setup, names = found.measurements.setup, unseen(found)
    if found.misfit_share < _DOUBTED:
        share = 100 * found.misfit_share
        probability = f"{share:.1g} %" if share >= _LEAST_SHARE else f"less than {_LEAST_SHARE:g} %"
        yield (
            "Do not use this: the measurements do not fit, a misfit as large has a probability of "
            f"{probability}. Look for a slip, a wrong sign or unit in a row, for play in the joints "
            "(windup_sd_arcmin), or for a gauge or a weight that is less exact than stated."
        )
    if found.before is not None and found.after is not None:
        yield (
            f"Sag along the job: {1e3 * found.after.rms:.2f} mm RMS, modelled {1e3 * found.before.rms:.2f}; "
            f"{_exactness(found.after)}; as modelled {100 * found.before.length_95:.0f} %."
        )
    parts = [", ".join(names[0])] * bool(names[0])
    parts += [f"{names[1]} of the 21 numbers of the base"] * bool(names[1])
    if parts:
        yield f"Not seen, nearly as they were assumed: {' and '.join(parts)}."
    if found.measurements.damping:
        ratio = float(np.median(found.measurements.damping))
        yield f"Damping of the modes in the records: {100 * ratio:.1f} % of critical (simulate --damping)."
    if setup.weight_sd_kg:
        yield f"Weight: {found.weight_kg:.3f} kg, standard deviation {1e3 * found.weight_sd_kg:.0f} g."
    if not setup.windup_sd_arcmin:
        yield "Assumes joints without play, which a weight would take up (windup_sd_arcmin: 0)."


def proposal_remarks(found: Proposal) -> Iterator[str]:
    """Yield how exact the tool will be after the proposed measurements, and on what that rests."""
    setup = found.setup
    number, axes = counted(len(found.q), "posture"), "".join(np.array(list("xyz"))[found.seen])
    yield (
        f"The sag along the job is {1e3 * found.after.rms:.2f} mm RMS as modelled, joints bending, known "
        f"within {100 * found.before.length_95:.0f} %."
    )
    error = 1e3 * found.after.rms * found.after.share
    yield (
        f"After {number} with {setup.weight_kg:g} kg, {axes} to {setup.gauge_sd_mm:g} mm: "
        f"{_exactness(found.after)}; with that compensated, {error:.2f} mm RMS of it would be left."
    )
    yield (
        f"Chosen from {found.candidates} postures that are clear of everything and that the joints can hold "
        "with the weight; how to get from one to the next is for you to see."
    )


def _exactness(sag: SagAlong) -> str:
    return (
        f"it is known within {100 * sag.length_95:.1f} %, as a vector within {100 * sag.share_95:.1f} %, "
        "with a probability of 95 %"
    )


def stiffness_text(stiffness: IdentifiedStiffness, source: str) -> str:
    """Return the file of an identified stiffness; `source` is where the measurements came from."""
    data = stiffness.model_dump(mode="json", exclude_none=True)
    lines = [
        f"# Written by cmbot identify from {source}. In a scene of cmbot-scene/2: identified: THIS_FILE",
        f"format: {data['format']}",
    ]
    for kind in ("links", "joints"):
        lines.append(f"{kind}:" if data[kind] else f"{kind}: []")
        lines += [f"  - {json.dumps(each)}" for each in data[kind]]
    if "base" in data:
        lines.append("base:")
        lines.append(f"  footholds: {json.dumps(data['base']['footholds'])}")
        for key in ("stiffness", "mass"):
            if key in data["base"]:
                lines.append(f"  {key}:")
                lines += [f"    - {json.dumps(row)}" for row in data["base"][key]]
    lines.append("covariance:")
    lines += [f"  - {json.dumps(row)}" for row in data["covariance"]]
    return "\n".join(lines) + "\n"
