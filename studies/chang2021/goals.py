"""What a better plan is to gain against the baseline, and whether it does: computed from the figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from chang2021.experiment import Experiment, Run, Variant, axes, reduction, unoptimised, unoptimised_figures
from chang2021.tables import GoalRow, GoalTable, Verdict, numbers
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.planning import Plan
from cmbot.simulation import Statistics, Tracking, statistics

# Least reductions, per cent: at the modelled stiffness, and at any other within this share of it.
_NOMINAL_CUT, _OTHER_CUT, _SHARE = 90.0, 65.0, 0.3
_ASKED = "sag compensated: errors"
# A smaller figure of the baseline, m, is not judged.
_SMALLEST = 1e-3
# Largest swing after the stop over all stiffnesses with quiet laws, per cent of that with the paper's.
_MOST_RESIDUAL = 40.0
_REST_COLUMNS = ("baseline", "the paper's law", "quiet laws", "share, %")
_SAG_COLUMNS = ("without", "objective: torque", "objective: sag", "sag against torque, %")


def goals(experiment: Experiment) -> Iterator[GoalTable]:
    """Yield the goals of one experiment, each with its figures and whether it holds.

    All of them are against the baseline in the same simulation: stiffness, damping and start are the same.
    """
    yield posture_goal(experiment.planned)
    yield compensation_goal(experiment.compensated)
    rest = rest_goal(experiment)
    if rest is not None:
        yield rest
    if experiment.least_sag is not None:
        yield least_sag(experiment.planned, experiment.least_sag)


def posture_goal(run: Run) -> GoalTable:
    """Compare the norms of the mean errors, and name the axes along which the mean grows."""
    before, after = (axes(motion).mean for motion in (unoptimised(run.equilibrium), run.equilibrium.planned))
    norms = [float(np.linalg.norm(mean)) for mean in (before, after)]
    cut = 100 * (1 - norms[1] / norms[0])
    holds = cut > 0
    rows = (
        GoalRow(setting="without", what="mean, mm", values=numbers(1e3 * before, 1e3 * norms[0])),
        GoalRow(setting="with", what="mean, mm", values=numbers(1e3 * after, 1e3 * norms[1])),
        GoalRow(
            setting="with",
            what="reduction, %",
            values=numbers(reduction(before, after), cut),
            goal="norm: above 0",
            holds=holds,
        ),
    )
    text = (
        f"The norm of the mean error goes from {1e3 * norms[0]:.2f} to {1e3 * norms[1]:.2f} mm, {cut:.1f} % "
        f"less: {_verdict(holds)}."
    )
    found = f"{1e3 * norms[0]:.2f} -> {1e3 * norms[1]:.2f} mm"
    return GoalTable(
        title="Postures: sliding via-points, a free start, no compensation",
        columns=("x", "y", "z", "norm"),
        rows=rows,
        remarks=(text, *_growing(run)),
        verdicts=(Verdict(asked="better postures: a smaller mean error", found=found, holds=holds),),
    )


def _growing(run: Run) -> Iterator[str]:
    figures = [motion.metrics for motion in (unoptimised(run.equilibrium), run.equilibrium.planned)]
    means, sags = (
        np.array([1e3 * np.abs(getattr(found, part).mean[:3]) for found in figures])
        for part in ("total", "static")
    )
    for axis in np.flatnonzero(means[1] > means[0]):
        yield (
            f"Along {'xyz'[axis]} the absolute mean grows from {means[0, axis]:.2f} to {means[1, axis]:.2f} "
            f"mm. That of the sag is {sags[0, axis]:.2f} and {sags[1, axis]:.2f} mm there: the objective is "
            "the torque on the guardrail, not the sag along an axis."
        )


def compensation_goal(variant: Variant) -> GoalTable:
    """Compare means and standard deviations at every stiffness that was simulated."""
    title = "Compensation: with the predicted sag compensated, where the baseline has more than 1 mm"
    if variant.plan is None:
        none = Verdict(asked=f"{_ASKED} {_NOMINAL_CUT:g} % less", found="no plan", holds=False)
        return _without_plan(title, ("x", "y", "z"), variant, none)
    predicted = _predicted(variant.plan)
    cases = [
        _compared(tracking, name, predicted)
        for tracking in variant.trackings
        for name in ("mean", "standard deviation")
    ]
    judged = list(_judged(cases))
    reasons = (reason for case in cases for reason in case.reasons())
    return GoalTable(
        title=title,
        columns=("x", "y", "z"),
        rows=tuple(row for case in cases for row in case.rows()),
        remarks=(*(remark for _, remark in judged), *reasons, _off_path(variant)),
        verdicts=tuple(verdict for verdict, _ in judged),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Case:
    """One quantity at one stiffness; arrays are (3,)."""

    stiffness: float  # as a multiple of the modelled one
    name: str
    asked: BoolArray  # where the baseline's figure is large enough to be judged
    cut: FloatArray  # reduction, per cent
    ratio: FloatArray  # predicted sag of the planned motion over the baseline's figure at that stiffness
    vibration: FloatArray  # the same quantity of the dynamic part, m

    @property
    def goal(self) -> float:
        return _NOMINAL_CUT if self.stiffness == 1.0 else _OTHER_CUT

    @property
    def allowed(self) -> FloatArray:
        """Approximate bound of the reduction, (3,), per cent, if all error is sag.

        At stiffness f the sag is 1/f of the predicted one, so the share abs(1/f - 1) of the latter stays. The
        bound is approximate: the sag is not exactly 1/f, and vibration may cancel part of the rest.
        """
        return np.asarray(100 * (1 - abs(1 / self.stiffness - 1) * self.ratio))

    @property
    def judged(self) -> bool:
        """Whether the goal covers this stiffness."""
        return abs(self.stiffness - 1.0) <= _SHARE * (1 + 1e-9)

    @property
    def missed(self) -> BoolArray:
        return np.asarray(self.judged & self.asked & (self.cut < self.goal))

    def rows(self) -> Iterator[GoalRow]:
        setting, judged = f"stiffness times {self.stiffness:g}", self.judged and bool(self.asked.any())
        yield GoalRow(
            setting=setting,
            what=f"reduction of {self.name}, %",
            values=self._where_asked(self.cut),
            goal=f"at least {self.goal:g}" if judged else "",
            holds=not self.missed.any() if judged else None,
        )
        if self.stiffness != 1.0:
            bound = self._where_asked(self.allowed)
            yield GoalRow(setting=setting, what=f"approximate bound of {self.name}, %", values=bound)

    def reasons(self) -> Iterator[str]:
        for axis in np.flatnonzero(self.missed):
            found = (
                f"At stiffness times {self.stiffness:g} the {self.name} along {'xyz'[axis]} falls by "
                f"{self.cut[axis]:.1f} %"
            )
            if self.allowed[axis] < self.goal:
                yield (
                    f"{found}: {100 * abs(1 - self.stiffness):.0f} % of the sag was not predicted, and "
                    f"along this axis the planned motion's sag is {self.ratio[axis] / self.stiffness:.2f} "
                    f"times the baseline's {self.name}. That bounds the reduction at about "
                    f"{self.allowed[axis]:.1f} %."
                )
            else:
                yield (
                    f"{found}, the sag alone would allow {self.allowed[axis]:.1f} %: vibration has a "
                    f"{self.name} of {1e3 * abs(self.vibration[axis]):.3f} mm there."
                )

    def _where_asked(self, values: FloatArray) -> tuple[float | None, ...]:
        return tuple(float(x) if asked else None for asked, x in zip(self.asked, values, strict=True))


def _compared(tracking: Tracking, name: str, predicted: Statistics) -> _Case:
    attribute = name.replace(" ", "_")
    baseline, planned = unoptimised(tracking).metrics, tracking.planned.metrics
    before = np.abs(getattr(baseline.total, attribute)[:3])
    return _Case(
        stiffness=tracking.options.guardrail_factor,
        name=name,
        asked=before > _SMALLEST,
        cut=reduction(before, getattr(planned.total, attribute)[:3]),
        ratio=np.abs(getattr(predicted, attribute)[:3]) / before,
        vibration=getattr(planned.dynamic, attribute)[:3],
    )


def _predicted(plan: Plan) -> Statistics:
    """Of the predicted sag along the planned motion; zeros where the plan predicts none."""
    samples = plan.samples
    expected = samples.tool_point if samples.expected_tool_point is None else samples.expected_tool_point
    return statistics(samples.t, expected - samples.tool_point)


def _judged(cases: list[_Case]) -> Iterator[tuple[Verdict, str]]:
    """Yield verdict and sentence at the modelled stiffness, then at the others; none without figures."""
    for nominal, where, less in (
        (True, "At the modelled stiffness", f"{_NOMINAL_CUT:g} % less"),
        (False, f"At any other stiffness within {100 * _SHARE:g} % of it", f"{_OTHER_CUT:g} % less"),
    ):
        judged = [case for case in cases if case.judged and (case.stiffness == 1.0) == nominal]
        count = sum(int(case.asked.sum()) for case in judged)
        if not count:
            continue
        missed = sum(int(case.missed.sum()) for case in judged)
        found, goal = f"{count - missed} of {count} figures", "does not hold" if missed else "holds"
        asked = f"{_ASKED} {less}" + ("" if nominal else f", stiffness up to {100 * _SHARE:g} % off")
        yield (
            Verdict(asked=asked, found=found, holds=not missed),
            f"{where}, {found} are at least {less}; the goal {goal}.",
        )


def _off_path(variant: Variant) -> str:
    parts = []
    for tracking in variant.trackings:
        left, right = (motion.metrics.path.rms[3] for motion in (unoptimised(tracking), tracking.planned))
        stiffness = tracking.options.guardrail_factor
        parts.append(f"{1e3 * right:.2f} instead of {1e3 * left:.2f} at stiffness times {stiffness:g}")
    return f"Distance of the elastic arm's tool from its path, RMS, mm: {', '.join(parts)}."


def rest_goal(experiment: Experiment) -> GoalTable | None:
    """Compare the swing after the stop with the paper's time law and with quiet ones; None without any.

    What counts is the largest swing over the stiffnesses, not that at the modelled one alone.
    """
    quiet = {each.options.guardrail_factor: each for each in experiment.quiet.trackings}
    rows = list[GoalRow]()
    swings = list[FloatArray]()
    for tracking in sorted(
        (experiment.planned.equilibrium, *experiment.planned.others),
        key=lambda each: each.options.guardrail_factor,
    ):
        factor = tracking.options.guardrail_factor
        motions = [unoptimised(tracking), tracking.planned]
        motions += [quiet[factor].planned] if factor in quiet else []
        rests = [motion.metrics.residual for motion in motions]
        found = [1e3 * rest.diameter for rest in rests if rest is not None]
        if len(found) == len(_REST_COLUMNS) - 1:
            swings.append(np.array(found))
            setting = f"stiffness times {factor:g}"
            share = 100 * found[2] / found[1]
            rows.append(GoalRow(setting=setting, what="largest distance, mm", values=numbers(found, share)))
    if not swings:
        return None
    baseline, paper, own = np.max(swings, axis=0)
    share = 100 * own / paper
    holds = bool(share <= _MOST_RESIDUAL)
    rows.append(
        GoalRow(
            setting="the largest of them",
            what="largest distance, mm",
            values=numbers((baseline, paper, own), share),
            goal=f"share: at most {_MOST_RESIDUAL:g}",
            holds=holds,
        )
    )
    of = f"stiffness times {rows[0].setting.split()[-1]} to {rows[-2].setting.split()[-1]}"
    text = (
        f"At {of} the tool swings through at most {own:.4f} mm after the stop with quiet time laws, "
        f"{paper:.4f} mm with the paper's, and {baseline:.4f} mm in the baseline: {share:.1f} % of what it "
        f"does with the paper's. {_verdict(holds).capitalize()}."
    )
    asked = f"quiet laws: swing after the stop, over all stiffnesses, at most {_MOST_RESIDUAL:g} %"
    return GoalTable(
        title="Rest: swing of the tool after the stop, with the paper's time law and with quiet ones",
        columns=_REST_COLUMNS,
        rows=tuple(rows),
        remarks=(text,),
        verdicts=(Verdict(asked=asked, found=f"{share:.1f} %", holds=holds),),
    )


def least_sag(torque: Run, variant: Variant) -> GoalTable:
    """Compare a plan of least torque with one of least sag, both of them and the baseline simulated."""
    title = "Another objective: the sag minimised in place of the torque"
    if variant.plan is None:
        return _without_plan(title, _SAG_COLUMNS, variant)
    motions = unoptimised(torque.equilibrium), torque.equilibrium.planned, variant.trackings[0].planned
    figures = unoptimised_figures(torque.plan), torque.plan.figures, variant.plan.figures
    # The sag stays constant after the stop.
    sags = 1e3 * np.array([np.linalg.norm(motion.static, axis=1).max() for motion in motions])
    torques = np.array([found.peak_guardrail_torque for found in figures])
    rows = (
        _sag_row("sag of the tool", "peak, mm", sags),
        _sag_row("sag of the tool", "mean, mm", [1e3 * motion.metrics.static.mean[3] for motion in motions]),
        _sag_row("torque on the guardrail", "peak, Nm", torques),
        _sag_row("torque on the guardrail", "mean, Nm", [found.mean_guardrail_torque for found in figures]),
    )
    text = f"The sag's peak is {_change(sags)}, the torque's {_change(torques)} than at the least torque."
    return GoalTable(title=title, columns=_SAG_COLUMNS, rows=rows, remarks=(text,))


def _sag_row(setting: str, what: str, three: FloatArray | list[float]) -> GoalRow:
    return GoalRow(setting=setting, what=what, values=numbers(three, 100 * (three[2] / three[1] - 1)))


def _change(three: FloatArray) -> str:
    change = 100 * (three[2] / three[1] - 1)
    return f"{abs(change):.2f} % {'higher' if change > 0 else 'lower'}"


def _verdict(holds: bool) -> str:
    return "the goal holds" if holds else "the goal does not hold"


def _without_plan(title: str, columns: tuple[str, ...], variant: Variant, *verdicts: Verdict) -> GoalTable:
    remark = f"There is no plan: {variant.why_not}."
    return GoalTable(title=title, columns=columns, rows=(), remarks=(remark,), verdicts=verdicts)
