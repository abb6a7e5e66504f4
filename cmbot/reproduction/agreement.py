"""What agrees with the paper and what does not, and why: computed from the figures, whatever they are."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.reproduction.experiment import Experiment, Run, axes, reduction
from cmbot.simulation import MotionTracking

__all__ = ["Finding", "findings", "reasons"]

# What counts as agreement: reductions within so many points of per cent, sizes within such a factor, the
# torque difference within such a share.
POINTS, FACTOR, SHARE = 10.0, 2.0, 0.1


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Whether one of the paper's results is found here, too.

    Attributes
    ----------
    agrees : bool
    text : str
    """

    agrees: bool
    text: str


def findings(experiment: Experiment) -> Iterator[Finding]:
    """Compare our planned run with the paper, one result after the other."""
    paper, run = experiment.paper, experiment.planned
    left, right = axes(run.equilibrium.baseline), axes(run.equilibrium.planned)
    theirs = (
        (paper.without.mean, paper.planned.mean),
        (paper.without.standard_deviation, paper.planned.standard_deviation),
    )
    for name, ours, pair in zip(
        ("absolute mean", "standard deviation"), zip(left, right, strict=True), theirs, strict=True
    ):
        yield _falls(name, reduction(*ours), reduction(*pair))
        yield _as_much(name, reduction(*ours), reduction(*pair))
        yield _size(name, ours[0], pair[0])
    yield _signs(left[0], paper.without.mean)
    yield _spread(left, (paper.without.mean, paper.without.standard_deviation))
    yield _torque(run.torque_difference, paper.torque_difference)


def reasons(experiment: Experiment) -> Iterator[str]:
    """Yield what our own figures say about where the differences come from."""
    run = experiment.planned
    yield _sag(run)
    yield _release(experiment)
    if experiment.fixed is None:
        yield f"With fixed via-points (Eq. (30)) there is no plan here: {experiment.why_not}."
    else:
        yield _knots(run, experiment.fixed)


def _falls(name: str, ours: FloatArray, theirs: FloatArray) -> Finding:
    falls, should = _which(ours > 0), _which(theirs > 0)
    text = f"The {name} falls along {falls} here, along {should} in the paper."
    return Finding(agrees=falls == should, text=text)


def _as_much(name: str, ours: FloatArray, theirs: FloatArray) -> Finding:
    agrees = bool(np.abs(ours - theirs).max() <= POINTS)
    return Finding(
        agrees=agrees,
        text=f"The {name} falls by {_list(ours, 1)} % here, by {_list(theirs, 1)} % in the paper "
        f"(agreement: within {POINTS:g} points on every axis).",
    )


def _size(name: str, ours: FloatArray, theirs: FloatArray) -> Finding:
    ratio = np.abs(ours) / np.abs(theirs)
    agrees = bool((np.maximum(ratio, 1 / np.maximum(ratio, 1e-300)) <= FACTOR).all())
    return Finding(
        agrees=agrees,
        text=f"Without optimisation the {name} is {_list(ratio, 2)} times the paper's "
        f"(agreement: within a factor of {FACTOR:g} on every axis).",
    )


def _signs(ours: FloatArray, theirs: FloatArray) -> Finding:
    same = np.sign(ours) == np.sign(theirs)
    return Finding(
        agrees=bool(same.all()),
        text=f"The mean without optimisation has the paper's sign along {_which(same)}; the paper does not "
        "say which way its axes point.",
    )


def _spread(ours: tuple[FloatArray, FloatArray], theirs: tuple[FloatArray, FloatArray]) -> Finding:
    here, there = (_which(deviation > np.abs(mean)) for mean, deviation in (ours, theirs))
    return Finding(
        agrees=here == there,
        text=f"Without optimisation the standard deviation exceeds the absolute mean along {here} here, "
        f"along {there} in the paper.",
    )


def _torque(ours: float, theirs: float) -> Finding:
    return Finding(
        agrees=abs(ours - theirs) <= SHARE * theirs,
        text=f"The largest difference of the torque on the guardrail is {ours:.1f} Nm here, {theirs:g} Nm in "
        f"the paper (agreement: within {100 * SHARE:g} %).",
    )


def _sag(run: Run) -> str:
    shares = [_dynamic_share(motion) for motion in (run.equilibrium.baseline, run.equilibrium.planned)]
    text = (
        f"Of the mean square of our error {_percent(shares[0])} (baseline) and {_percent(shares[1])} "
        "(planned) is dynamic, the rest the sag of the postures"
    )
    if max(shares) < 0.5:
        return f"{text}: means are those of the sag, and deviations come from postures that change."
    return f"{text}: vibration is a large part of the error."


def _dynamic_share(motion: MotionTracking) -> float:
    figures = motion.figures
    return float((figures.dynamic.rms[3] / figures.total.rms[3]) ** 2)


def _release(experiment: Experiment) -> str:
    run, paper = experiment.planned, experiment.paper
    theirs = np.array([paper.without.standard_deviation, paper.planned.standard_deviation])
    before, after = (
        np.array([axes(tracking.baseline)[1], axes(tracking.planned)[1]])
        for tracking in (run.equilibrium, run.undeformed)
    )
    nearer = (
        "nearer to" if np.linalg.norm(after - theirs) < np.linalg.norm(before - theirs) else "further from"
    )
    told = [
        f"{_list(1e3 * after[k], 2)} mm instead of {_list(1e3 * before[k], 2)} mm ({name})"
        for k, name in enumerate(("baseline", "planned"))
    ]
    return (
        f"Let go undeformed, the arm shakes: the standard deviations become {told[0]} and {told[1]}, "
        f"{nearer} the paper's as a whole."
    )


def _knots(run: Run, fixed: Run) -> str:
    both = [
        (r.torque_difference, reduction(axes(r.equilibrium.baseline)[0], axes(r.equilibrium.planned)[0]))
        for r in (run, fixed)
    ]
    (sliding_torque, sliding_cut), (fixed_torque, fixed_cut) = both
    moved = float(np.rad2deg(fixed.plan.start.moved))
    start = f", from another start ({moved:.1f} deg away)," if moved else ""
    text = (
        f"With fixed via-points (Eq. (30)){start} the largest torque difference is {fixed_torque:.1f} Nm and "
        f"the absolute mean falls by {_list(fixed_cut, 1)} %; with via-points that slide it is "
        f"{sliding_torque:.1f} Nm and {_list(sliding_cut, 1)} %"
    )
    if not moved and abs(fixed_torque) < 0.5 * abs(sliding_torque):
        return f"{text}: the gain is that of other postures, not of the splines."
    return f"{text}."


def _percent(share: float) -> str:
    return f"{100 * share:.2f} %" if share >= 1e-4 else "less than 0.01 %"


def _which(true: BoolArray) -> str:
    named = [axis for axis, yes in zip("xyz", true, strict=True) if yes]
    return ", ".join(named) if named else "no axis"


def _list(values: FloatArray, digits: int) -> str:
    # Adding zero turns -0.0 into 0.0.
    return ", ".join(f"{round(float(value), digits) + 0.0:.{digits}f}" for value in values)
