"""Which of the paper's results agree with ours, and why others do not: computed from the figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from chang2021.experiment import Experiment, Run, axes, reduction, unoptimised
from chang2021.tables import decimals
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.simulation import MotionTracking

# Tolerances of agreement: of reductions in points of per cent, of sizes a factor, of the torque difference a
# share.
POINTS, FACTOR, SHARE = 10.0, 2.0, 0.1


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Whether one of the paper's results agrees with ours."""

    agrees: bool
    text: str


def findings(experiment: Experiment) -> Iterator[Finding]:
    """Compare our planned run with the paper, one result after the other."""
    paper, run = experiment.paper, experiment.planned
    left, right = axes(unoptimised(run.equilibrium)), axes(run.equilibrium.planned)
    for name, key in (("absolute mean", "mean"), ("standard deviation", "standard_deviation")):
        errors = (left, right, paper.without, paper.planned)
        without, planned, their_without, their_planned = (getattr(each, key) for each in errors)
        yield from _reductions(name, reduction(without, planned), reduction(their_without, their_planned))
        yield _size(name, without, their_without)
    same = np.sign(left.mean) == np.sign(paper.without.mean)
    yield Finding(
        agrees=bool(same.all()),
        text=f"The mean without optimisation has the paper's sign along {_which(same)}; the paper does not "
        "give the directions of its axes.",
    )
    here, there = (_which(each.standard_deviation > np.abs(each.mean)) for each in (left, paper.without))
    yield Finding(
        agrees=here == there,
        text=f"Without optimisation the standard deviation exceeds the absolute mean along {here} here, "
        f"along {there} in the paper.",
    )
    ours, theirs = run.torque_difference, paper.torque_difference
    yield Finding(
        agrees=abs(ours - theirs) <= SHARE * theirs,
        text=f"The largest difference of the torque on the guardrail is {ours:.1f} Nm here, {theirs:g} Nm in "
        f"the paper (agreement: within {100 * SHARE:g} %).",
    )


def reasons(experiment: Experiment) -> Iterator[str]:
    """Yield what our own figures say about the causes of the differences."""
    run = experiment.planned
    yield _sag(run)
    yield _release(experiment)
    if experiment.fixed is None:
        yield f"With fixed via-points (Eq. (30)) there is no plan here: {experiment.why_not}."
    else:
        yield _knots(run, experiment.fixed)


def _reductions(name: str, ours: FloatArray, theirs: FloatArray) -> Iterator[Finding]:
    falls, should = _which(ours > 0), _which(theirs > 0)
    text = f"The {name} falls along {falls} here, along {should} in the paper."
    yield Finding(agrees=falls == should, text=text)
    yield Finding(
        agrees=bool(np.abs(ours - theirs).max() <= POINTS),
        text=f"The {name} falls by {_list(ours, 1)} % here, by {_list(theirs, 1)} % in the paper "
        f"(agreement: within {POINTS:g} points on every axis).",
    )


def _size(name: str, ours: FloatArray, theirs: FloatArray) -> Finding:
    ratio = np.abs(ours) / np.abs(theirs)
    return Finding(
        agrees=bool((np.maximum(ratio, 1 / np.maximum(ratio, 1e-300)) <= FACTOR).all()),
        text=f"Without optimisation the {name} is {_list(ratio, 2)} times the paper's "
        f"(agreement: within a factor of {FACTOR:g} on every axis).",
    )


def _sag(run: Run) -> str:
    shares = [_dynamic_share(motion) for motion in (unoptimised(run.equilibrium), run.equilibrium.planned)]
    text = (
        f"Of the mean square of our error {_percent(shares[0])} (baseline) and {_percent(shares[1])} "
        "(planned) is dynamic, the rest the sag of the postures"
    )
    if max(shares) < 0.5:
        return f"{text}: the means are those of the sag, the deviations come from changing postures."
    return f"{text}: vibration is a large part of the error."


def _dynamic_share(motion: MotionTracking) -> float:
    figures = motion.metrics
    return float((figures.dynamic.rms[3] / figures.total.rms[3]) ** 2)


def _release(experiment: Experiment) -> str:
    run, paper = experiment.planned, experiment.paper
    theirs = np.array([paper.without.standard_deviation, paper.planned.standard_deviation])
    before, after = (
        np.array([axes(motion).standard_deviation for motion in (unoptimised(tracking), tracking.planned)])
        for tracking in (run.equilibrium, run.undeformed)
    )
    nearer = np.linalg.norm(after - theirs) < np.linalg.norm(before - theirs)
    changes = [
        f"{_list(1e3 * after[k], 2)} mm instead of {_list(1e3 * before[k], 2)} mm ({name})"
        for k, name in enumerate(("baseline", "planned"))
    ]
    return (
        f"Released undeformed, the arm vibrates: the standard deviations become {changes[0]} and "
        f"{changes[1]}, {'nearer to' if nearer else 'further from'} the paper's as a whole."
    )


def _knots(run: Run, fixed: Run) -> str:
    sliding_cut, fixed_cut = (
        reduction(axes(unoptimised(each.equilibrium)).mean, axes(each.equilibrium.planned).mean)
        for each in (run, fixed)
    )
    moved = float(np.rad2deg(fixed.plan.start.moved))
    start = f", from another start ({moved:.1f} deg away)," if moved else ""
    text = (
        f"With fixed via-points (Eq. (30)){start} the largest torque difference is "
        f"{fixed.torque_difference:.1f} Nm and the absolute mean falls by {_list(fixed_cut, 1)} %; with "
        f"sliding via-points it is {run.torque_difference:.1f} Nm and {_list(sliding_cut, 1)} %"
    )
    if not moved and abs(fixed.torque_difference) < 0.5 * abs(run.torque_difference):
        return f"{text}: the gain comes from other postures, not from the splines."
    return f"{text}."


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %" if share >= 1e-4 else "less than 0.01 %"


def _which(true: BoolArray) -> str:
    named = [axis for axis, yes in zip("xyz", true, strict=True) if yes]
    return ", ".join(named) if named else "no axis"


def _list(values: FloatArray, digits: int) -> str:
    return ", ".join(decimals(values, digits))
