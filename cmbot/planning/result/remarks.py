"""Remarks on a plan: what its metrics alone do not say, in sentences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.errors import InputError
from cmbot.common.limit import Limit
from cmbot.common.validation import counted
from cmbot.elastic.sag import Sag
from cmbot.planning.certification.sag_spread import spread_times
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression
from cmbot.planning.job import RETURN
from cmbot.planning.result.baseline import Baseline
from cmbot.planning.result.holding import holding_remarks
from cmbot.planning.result.plan import Plan
from cmbot.planning.result.stroke_plan import ObjectiveMetrics
from cmbot.planning.result.verdict import baseline_faults, further, strays, travels, verdict
from cmbot.planning.workcell.stiffness import identified_in_words
from cmbot.planning.workcell.units import mistaken_units
from cmbot.planning.workcell.workcell import bending_arm, rigid_arm_remark
from cmbot.robot import Kinematics, postures_in_words
from cmbot.scene import STOW

# A peak lower by less than this share is no gain; a baseline this near to the lower bound leaves none, and
# the peak of sequences of postures is told where it is further away.
_GAIN, _NEAR_BOUND = 1e-2, 1e-2
# Areas that differ by less are the same, relative.
_SAME_AREA = 1e-6
# Largest error of a lower bound that the search closed, as a share of it.
_CLOSED = 1e-2
# More jerk than so many times the baseline's, and than that share of the limits, may well make the tool sway
# more.
_MORE_JERK, _LITTLE_JERK = 2.0, 1e-3
# Joints that travel so many times as far as the baseline's are told.
_FURTHER = 2.0
# A lower bound below this share of the baseline's peak counts as zero.
_NOTHING = 1e-9


def remarks(plan: Plan) -> Iterator[str]:
    """Yield what should be known of a plan besides its metrics, a sentence or two each."""
    yield verdict(plan)
    yield from _start(plan)
    yield from _between(plan)
    yield from _return(plan)
    yield from _shortest_time(plan)
    yield from _process_speed(plan)
    yield from _coverage(plan)
    if plan.baseline is not None:
        yield from _compared(plan, plan.baseline)
    yield from _lower_bound(plan)
    yield from holding_remarks(plan)
    yield from plan.fallbacks
    yield from plan.robot.remarks
    yield from _bending(plan)
    for key, looks, units in mistaken_units(plan.scene):
        yield f"Numbers of {key} look like {looks}; they were taken as {units}."
    objective = plan.objective
    if objective.floor is not None and objective.floor <= _NOTHING * objective.planned_peak:
        yield (
            "Gravity has no part in what was minimised: at rest that is 0 everywhere, so no posture was "
            "chosen by it, and only the motion's own share could be lowered. axis_weights with x or y above "
            "0 count gravity's torque, too."
        )
    whole = plan.job.certificate
    checks, passes = len(whole.checks), counted(len(plan.passes), "pass", "passes")
    yield (
        f"Certified: {counted(checks, 'check')} {'holds' if checks == 1 else 'hold'}, computed again from "
        "the finished motion by code that the optimiser does not use; at all times of the job "
        f"{whole.at_all_times(plan.scene.base_name)}."
    )
    seconds, done = plan.seconds, plan.compensation
    if done is not None and done.rounds:
        passes += f" in the last of {counted(done.rounds, 'round')}"
    yield (
        f"Time: path {seconds.path:.2f} s, optimisation {seconds.optimise:.2f} s ({passes}), free moves and "
        f"certificates {seconds.certify:.2f} s, in all {seconds.total:.2f} s."
    )


def _bending(plan: Plan) -> Iterator[str]:
    if rigid := rigid_arm_remark(plan.scene, plan.robot):
        yield rigid
    if identified := identified_in_words(plan.scene):
        yield identified
    done = plan.compensation
    if done is not None:
        rounds = counted(done.rounds, "round")
        yield (
            f"Sag compensated in {rounds}: the joints aim up to {1e3 * done.largest_shift:.2f} mm beside the "
            "path, so that the bent arm follows it; the tool deviation is the bent arm's, as predicted."
        )
        if done.deviation:
            promised = plan.options.deviation_sigmas
            part = f"{promised:g} of them are" if promised else "planner.deviation_sigmas makes it"
            yield (
                "By the errors of the identified stiffness the tool's place across its path has a standard "
                f"deviation of {1e3 * done.deviation:.2f} mm at most; {part} part of what is certified."
            )
    yield from _sag(plan)
    if plan.suppression is not None:
        yield _suppression(plan.suppression, plan.scene.base_name)


def _sag(plan: Plan) -> Iterator[str]:
    """How far the tool is from its path as the arm sags, where that is not compensated and too far."""
    allowed = plan.options.max_tool_deviation_m
    if plan.options.compensate or (arm := bending_arm(plan.scene, plan.robot)) is None:
        return
    sag, largest = Sag(arm), 0.0
    rigid, load = Kinematics(plan.robot), "its own weight" + " and the process force" * plan.robot.pushed
    for segment in plan.job.strokes:
        t = spread_times(segment.trajectory)
        q = segment.trajectory.evaluate(t)
        try:
            bent = rigid.tool_poses(q)[0] + sag.following(q)
        except InputError:
            base = plan.scene.base_name
            yield f"NOT STIFF ENOUGH: bent by {load} the arm on its {base} has no stable equilibrium."
            return
        largest = max(largest, float(np.linalg.norm(segment.task.path.leg_offset(t, bent), axis=1).max()))
    if largest > allowed:
        yield (
            f"Bent by {load} the tool is up to {1e3 * largest:.2f} mm off its path, more than "
            f"max_tool_deviation_m ({1e3 * allowed:g} mm), which the rigid arm keeps; "
            "compensate: true can make up for the sag."
        )


def _suppression(done: VibrationSuppression, base: str) -> str:
    modes = "slowest vibration" if done.modes == 1 else f"{done.modes} slowest vibrations"
    what = f"Vibration suppression: the {modes} of {base} and links "
    if done.at_rest:
        return f"{what}{'is' if done.modes == 1 else 'are'} next to none at the ends of the legs anyway."
    # Of several strokes one may be left as it is, and another one not.
    if any(done.shares):
        return (
            f"{what}{'is' if done.modes == 1 else 'are'} made {100 * done.share:.0f} % smaller"
            f"{' on average' if len(done.shares) > 1 else ''} at the ends of "
            f"{_suppressed_legs(done.shares)}, as predicted. {_swings(done, made=True)}"
        )
    if not done.worth_it and done.swing_with != done.swing_without:
        return (
            f"{what}{'is left as it is' if done.modes == 1 else 'are left as they are'}: the change that was "
            f"tried makes the largest swing hardly smaller. {_swings(done, made=False)}"
        )
    return (
        f"{what}could not be brought to rest at the ends of the legs: no change of the motion that was "
        f"tried keeps every bound. {_swings(done, made=False)}"
    )


def _swings(done: VibrationSuppression, *, made: bool) -> str:
    """What the tool swings through after the stop: the most of all that was simulated, and as modelled."""
    if not done.stiffness:
        return (
            f"As predicted, they would leave the tool swinging by {1e3 * done.before:.4f} mm to either side "
            f"without that, and by {1e3 * done.after:.4f} mm with it."
        )
    cases, word = [*zip(done.swing_with, done.swing_without, strict=True)], "without" if made else "with"

    def told(with_it: float, without: float) -> str:
        here, other = (f"{1e3 * each:.3f}" for each in ((with_it, without) if made else (without, with_it)))
        return f"{here} mm" if here == other else f"{here} mm ({word} that {other})"

    most = told(*(max(each) for each in zip(*cases, strict=True)))
    low, high, load = min(done.stiffness), max(done.stiffness), max(done.load_kg)
    carried = f" and with up to {load:g} kg more" if load else ""
    modelled = [
        case for *at, case in zip(done.stiffness, done.load_kg, cases, strict=True) if at == [1.0, 0.0]
    ]
    return (
        f"In the 2 s after the stop the tool swings through {most} at most, simulated at {low:.3g} to "
        f"{high:.3g} times the stiffness{carried}{f'; as modelled {told(*modelled[0])}' if modelled else ''}."
    )


def _suppressed_legs(shares: tuple[float, ...]) -> str:
    """Name the legs whose vibration is suppressed, and the others."""
    legs, none = len(shares), shares.count(0.0)
    if not none:
        return "the legs"
    return (
        f"{legs - none} of the {legs} legs, and not at those of {none}, where no change that was tried keeps "
        "every bound"
    )


def _start(plan: Plan) -> Iterator[str]:
    if plan.start.moved == 0:
        yield "Starts in the scene's posture."
        if plan.start.failures:
            yield f"A better start was found, but is not used: {plan.start.failures[0].reason}."
        return
    posture = postures_in_words(plan.robot.limits.prismatic, plan.start.posture)
    where = f"{posture}, up to {_furthest(plan)} a joint away"
    if plan.start.failures:
        # The others that failed, and the one that led to the end.
        tried = len(plan.start.failures)
        other = "Another one" if tried == 1 else f"The last of {tried} others tried"
        yield (
            f"Starts elsewhere: from the scene's posture, {plan.start.failures[0].reason}. "
            f"{other} with the same tool pose leads to the end, {where}. Bring the arm there first."
        )
    elif plan.compensation is not None and _next_to_it(plan):
        yield (
            f"Starts in the {plan.scene.pinned_posture}, with the sag compensated: up to {_furthest(plan)} a "
            "joint from it, so that the bent arm's tool is where the path begins."
        )
    elif plan.scene.begins_elsewhere:
        yield f"Starts where the tool path begins, in the posture {where}."
    else:
        yield f"Starts in a better posture with the same tool pose, {where} (start: free)."
    if plan.approach is not None:
        figures = plan.approach.certificate.figures
        how = "along the self-motion, the tool stays" if plan.approach.along_self_motion else "tool off"
        yield (
            f"Approach: before the work the arm goes there from the scene's posture, in "
            f"{plan.approach.trajectory.duration:.1f} s ({how}), "
            f"peak torque {figures.peak_guardrail_torque:.2f} Nm, "
            f"clearance {1e3 * figures.min_clearance:.1f} mm, certified."
        )


def _coverage(plan: Plan) -> Iterator[str]:
    """What rasters cover, and what they leave out."""
    if not plan.coverage:
        return
    several = len(plan.coverage) > 1 or plan.several
    covered = ", ".join(
        f"{one.covered:.4g} of {one.area:.4g} m2{f' ({name})' if several else ''}"
        for name, one in plan.coverage.items()
    )
    missing, unreached = (
        sum(getattr(one, name) for one in plan.coverage.values()) for name in ("left_out", "unreached")
    )
    beside, left = missing - unreached, list[str]()
    if beside > _SAME_AREA * missing:
        left.append(f"{beside:.3g} m2 are left out, beyond the rows' ends or too far beside them")
    if unreached:
        left.append(f"{unreached:.3g} m2 are NOT REACHED")
    end = " and ".join(left) or "no place is left out"
    yield f"Coverage: {covered}, within half the distance of two rows; {end}."
    if unreached:
        yield ("Where no posture goes on, rows are cut; raster.cover: all refuses such a plan.")


def _compared(plan: Plan, baseline: Baseline) -> Iterator[str]:
    """What the baseline is, and how the plan compares with it."""
    yield from _baseline(plan, baseline)
    yield _gain(plan, baseline)
    yield from _travel(plan, baseline)
    yield from _jerk(plan, baseline)
    if plan.objective.baseline_peak is not None:
        yield from _nothing_gained(plan, plan.objective.baseline_peak)


def _jerk(plan: Plan, baseline: Baseline) -> Iterator[str]:
    """Where something bends, whether the joints jerk much harder than the baseline's."""
    before, after = (each.limit_use.jerk for each in (baseline.figures, plan.figures))
    if plan.suppression is not None and after > max(_MORE_JERK * before, _LITTLE_JERK):
        yield (
            f"The joints jerk {after / before:.1f} times as hard as the baseline's, {100 * after:.0f} % "
            "of a limit: tool and base may sway more than the baseline's; cmbot simulate tells."
        )


def _baseline(plan: Plan, baseline: Baseline) -> Iterator[str]:
    """What the baseline does that no plan may."""
    clearance, shown = baseline.job_figures.min_clearance, "it is shown for comparison and is no plan"
    if clearance < 0:
        yield f"The baseline collides (clearance {1e3 * clearance:.1f} mm): {shown}."
    elif clearance < plan.options.safety_margin_m:
        yield f"The baseline breaks the safety margin: {shown}."
    if strays(plan):
        yield (
            f"The baseline leaves its path by up to {1e3 * baseline.drift:.1f} mm, as near a singular "
            "posture it cannot follow: its torque there is no measure."
        )


def _between(plan: Plan) -> Iterator[str]:
    """How the arm goes from one stroke to the next."""
    moves = [segment for segment in plan.work.segments if segment.kind == "free"]
    if moves:
        hardest = max(moves, key=lambda move: move.figures.peak_guardrail_torque)
        seconds = sum(move.duration for move in moves)
        yield (
            f"Between the {len(plan.several)} strokes: {counted(len(moves), 'free move')} in {seconds:.1f} s "
            f"(tool off), peak torque {hardest.figures.peak_guardrail_torque:.2f} Nm (on {hardest.name}), "
            f"clearance {1e3 * min(move.figures.min_clearance for move in moves):.1f} mm, certified."
        )


def _return(plan: Plan) -> Iterator[str]:
    """How the arm goes back, where the scene asks for it."""
    if plan.scene.return_to == "none":
        return
    lacks = plan.scene.return_to == "stow" and STOW not in plan.robot.group_states
    named = {"stow": "where it started" if lacks else "its stow posture", "start": "where it started"}
    where = named.get(str(plan.scene.return_to), f"its state {plan.scene.return_to}")
    why = f" (its SRDF has no group state {STOW})" if lacks else ""
    back = plan.job.segment(RETURN)
    if back is None:
        yield f"The work ends in the posture to which the arm is to return{why}."
        return
    peak, clearance = back.figures.peak_guardrail_torque, 1e3 * back.figures.min_clearance
    yield (
        f"Return: after the work the arm goes to {where}{why} in {back.duration:.1f} s (tool off), "
        f"peak torque {peak:.2f} Nm, clearance {clearance:.1f} mm, certified."
    )


def _shortest_time(plan: Plan) -> Iterator[str]:
    """How long legs take whose seconds were to be found."""
    for file, segment in zip(plan.scene.strokes, plan.job.strokes, strict=True):
        if not file.time_laws:
            continue
        of = f" of {segment.name}" if plan.several else ""
        legs = "the leg" if len(file.time_laws) == 1 else f"{len(file.time_laws)} legs"
        seconds, use = sum(law.duration for law in file.time_laws), segment.figures.limit_use
        most = "" if file.max_base_torque_nm is None else f" and {file.max_base_torque_nm:g} Nm on the base"
        yield (
            f"Shortest time{of}: {legs} in {seconds:.4g} s, along the joint path that was found, within the "
            f"limits{most}; used are {100 * use.velocity:.0f} % of a velocity, "
            f"{100 * use.acceleration:.0f} % of an acceleration, {100 * use.jerk:.0f} % of a jerk, "
            f"{100 * use.torque:.0f} % of a torque."
        )


def _process_speed(plan: Plan) -> Iterator[str]:
    """How well the tool keeps the process speed, where the scene bounds that."""
    for stroke, segment in zip(plan.strokes, plan.job.strokes, strict=True):
        parts, tolerance = stroke.task.path.process_parts, stroke.task.speed_tolerance
        kept = [check for check in segment.certificate.checks if check.limit is Limit.PROCESS_SPEED]
        if tolerance is None or not len(parts) or not kept:
            continue
        of = f" of {stroke.name}" if plan.several else ""
        slow, fast = parts[:, 2].min(), parts[:, 2].max()
        speeds = f"{slow:.4g} m/s" if fast - slow < _NOTHING * fast else f"{slow:.4g} to {fast:.4g} m/s"
        length = ((parts[:, 1] - parts[:, 0]) * parts[:, 2]).sum()
        yield (
            f"Process speed{of}: {speeds} on {length:.3f} m between the leads, kept within "
            f"{100 * kept[0].value:.2f} % at all times (allowed: {100 * tolerance:g} %)."
        )


def _next_to_it(plan: Plan) -> bool:
    """Whether the start is nearer to the scene's posture than postures of a chart are to each other."""
    moves = plan.start.posture - plan.scene.posture
    return bool(plan.robot.metric.lengths(moves) < plan.options.chart_spacing)


def _furthest(plan: Plan) -> str:
    """How far joints of each kind are moved at most before the work."""
    slides, moves = plan.robot.limits.prismatic, np.abs(plan.start.posture - plan.scene.posture)
    turned, slid = (float(moves[kind].max(initial=0.0)) for kind in (~slides, slides))
    each = [f"{np.rad2deg(turned):.1f} deg"] if turned or not slid else []
    return " and ".join([*each, *([f"{slid:.3f} m"] if slid else [])])


def _gain(plan: Plan, baseline: Baseline) -> str:
    motion = "the paper's motion" if plan.options.baseline == "paper" else "straight steps along the path"
    begin = f"Against the baseline, {motion} without optimisation"
    if faults := baseline_faults(plan, work=True):
        return f"{begin}, no gain at work is stated: it {faults}."
    static, before = (each.peak_static_guardrail_torque for each in (plan.figures, baseline.figures))
    change = 100 * (static / before - 1)
    mean = plan.figures.mean_guardrail_torque / baseline.figures.mean_guardrail_torque - 1
    difference, time = plan.largest_torque_difference or (0.0, 0.0)
    fixed = plan.options.knots == "fixed" and plan.start.moved == 0
    why = " (fixed via-points cannot lower it)" if fixed else ""
    peak = "the static peak" if plan.robot.pushed else "the peak of the gravity torque"
    return (
        f"{begin}: {peak} "
        f"{change:+z.2f} %{why}, the mean {100 * mean:+.2f} %; at most {difference:.1f} Nm less, "
        f"at {time:.1f} s."
    )


def _travel(plan: Plan, baseline: Baseline) -> Iterator[str]:
    """Where the joints travel much further than the baseline's: how far, and which one most."""
    factor = further(plan)
    if factor < _FURTHER:
        return
    ours, theirs = travels(plan, baseline)
    joint = int(plan.robot.metric.coordinates(ours - theirs).argmax())
    units = plan.robot.limits.units(joint, shown=True)
    far, other = (f"{units.factor * each[joint]:.3g} {units.position}" for each in (ours, theirs))
    yield (
        f"At work the joints travel {factor:.1f} times as far as the baseline's, most of all "
        f"{plan.robot.joints[joint]}, {far} in place of {other}: by self-motion, which lowers the torque; "
        "planner.knots: fixed does without."
    )


def _nothing_gained(plan: Plan, before: float) -> Iterator[str]:
    """Where the objective is no better than the baseline's, whose peak was `before`: that, and why."""
    objective = plan.objective
    if objective.planned_peak < before * (1 - _GAIN):
        return
    if objective.planned_peak > before * (1 + _GAIN):
        higher = 100 * (objective.planned_peak / before - 1)
        yield (
            f"The peak is {higher:.2f} % higher than the baseline's, which does not have to keep limits, "
            "clearances or rest at both ends."
        )
        return
    if baseline_faults(plan, work=True):
        return
    near = objective.floor is not None and before < objective.floor * (1 + _NEAR_BOUND)
    why = " The baseline is near the lower bound already: there is nothing to gain." if near else ""
    yield f"Hardly anything is gained at the peak; what the plan adds is that limits are kept.{why}"


def _lower_bound(plan: Plan) -> Iterator[str]:
    objective = plan.objective
    if not objective.is_guardrail_torque:
        faults = baseline_faults(plan, work=True)
        which = f", which {faults}," if faults else ""
        before, after = objective.baseline_peak, _value(objective, objective.planned_peak)
        change = f"to a peak of {after}"
        if before is not None:
            change = f"from a peak of {_value(objective, before)} in the baseline{which} to {after}"
        yield f"Minimised: {_objective(plan)}, {change}."
    bound = plan.lower_bound
    if bound is None or plan.choice is None:
        return
    gap = "" if objective.gap is None else f"; the peak is {100 * objective.gap:+.3f} % from it"
    value, error = _value(objective, bound.value), _value(objective, bound.error, 1)
    at, all_ = bound.via_point + 1, len(bound.each)
    pinned = plan.options.start == "pinned"
    name = "Lower bound for any start" if pinned else "Lower bound"
    if plan.compensation is not None:
        # The postures that were sought hold the rigid tool on the path; those of the plan, the bent one.
        name += ", of the path before the sag is compensated"
    where = f"at via-point {at} of the {all_} that the motion passes through, no posture"
    basis = f"({bound.basis}; error {error})"
    if bound.kind == "proven":
        yield (
            f"{name}: no plan within the limits has a static peak below {value} {basis}: {where} has "
            f"a smaller value{gap}."
        )
    elif bound.error <= _CLOSED * bound.value:
        yield (
            f"{name}: no plan within the limits was found with a static peak below {value} {basis}: {where} "
            f"was found with a smaller value{gap}."
        )
    else:
        yield (
            f"{name}, not closed: {where} was found with less than {value}, but the search ended "
            f"with {error} open{gap}."
        )
    yield from _sequences(plan)
    if plan.several:
        return  # each stroke has starts of its own
    if plan.start.moved == 0 and not pinned:
        return  # that is where it starts
    other, peak = (
        ("in another posture (start: free)", plan.choice.free)
        if pinned
        else (f"in the {plan.scene.pinned_posture} (start: pinned)", plan.choice.pinned)
    )
    if peak is None:
        yield f"Had it started {other}: no sequence of postures through the charts was found."
    else:
        yield f"Had it started {other}, the peak at rest would be {_value(objective, peak)}."


def _sequences(plan: Plan) -> Iterator[str]:
    """By how much the peak between via-points exceeds that at the worst of them."""
    objective, bound, choice = plan.objective, plan.lower_bound, plan.choice
    if bound is None or choice is None:
        return
    start, least = "", choice.free
    if plan.options.start == "pinned" and choice.pinned is not None:
        start, least = f" from the {plan.scene.pinned_posture}", choice.pinned
    if least is None or least <= bound.value + _NEAR_BOUND * objective.planned_peak:
        return
    gap = 100 * (objective.planned_peak / least - 1)
    yield (
        f"Sequences: no way{start} through the charts of all via-points has a static peak below "
        f"{_value(objective, least)} (estimate); the peak is {gap:+.3f} % from that."
    )


def _value(objective: ObjectiveMetrics, value: float, more_digits: int = 0) -> str:
    """Write a value of the objective with its unit, which custom functions lack."""
    factor, unit = (1e3, "mm") if objective.unit == "m" else (1.0, objective.unit)
    return f"{factor * value:.{2 + more_digits}f} {unit}".rstrip()


def _objective(plan: Plan) -> str:
    objective, holding = plan.objective, plan.robot.holding
    if objective.own:
        return objective.name
    if objective.name == "hold":
        magnets = holding is not None and holding.adhesive
        return "the adhesion that the feet need" if magnets else "the pull of magnets in place of the clamps"
    if objective.axis_weights is None:
        return f"the tool's {objective.name}"
    weights = ", ".join(f"{weight:g}" for weight in objective.axis_weights)
    return f"the torque about the {objective.moment_about}, axes weighted {weights}"
