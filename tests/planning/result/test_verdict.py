"""The verdict on a plan: over the whole job, truthful about gain and loss."""

from dataclasses import replace

import numpy as np
import pytest
from plan_folders import changed, with_baseline, without_approach

from cmbot.common.limit import Limit
from cmbot.planning import Check, Plan, baseline_faults, bound_use, remarks, tightest_check, verdict
from cmbot.planning.result.judgement import further, travels


def test_the_posture_in_which_the_arm_begins_decides_on_the_triangle(triangle_plan: Plan) -> None:
    work, baseline = (
        figures.peak_guardrail_torque for figures in (triangle_plan.figures, triangle_plan.baseline.figures)
    )
    peak = triangle_plan.job.figures.peak_guardrail_torque
    assert (
        f" The guardrail must bear {peak:.1f} Nm over the whole job "
        "(at rest in the posture in which the arm begins), as much as the baseline; "
        f"the work alone {work:.1f} Nm (baseline {baseline:.1f} Nm); the still part adds 74.5 Nm. With "
    ) in verdict(triangle_plan)


def test_the_tightest_promise_is_told_with_its_room(triangle_plan: Plan) -> None:
    segment, check = tightest_check(triangle_plan.job)
    # A rate of the approach and the tool's deviation at work use nearly the same share of their bounds.
    where, factor, unit = {
        "approach": ("on the approach", np.rad2deg(1.0), "deg/s"),
        "work": ("at work", 1e3, "mm"),
    }[segment.name]
    room = f"{factor * (check.bound - check.value):.3g} {unit} left"
    use = f"{100 * bound_use(check):.0f} % of its bound ({room})"
    said = f"Tightest promise: {check.quantity} {where}, at {check.time:.1f} s, {use}."
    assert said in list(remarks(triangle_plan))


def test_a_joint_at_the_end_of_its_range_is_said_to_be_there(triangle_plan: Plan) -> None:
    check = Check(
        quantity="distance of joint_1 from the middle of its range",
        time=3.0,
        value=np.deg2rad(169.7),
        bound=np.deg2rad(170.0),
        unit="rad",
        limit=Limit.POSITION,
        joint="joint_1",
    )
    work = triangle_plan.job.segments[-1]
    certificate = replace(work.certificate, checks=(check,))
    said = list(remarks(changed(without_approach(triangle_plan), "work", certificate=certificate)))
    left = "(0.3 deg left; robot.range_margin_deg keeps more)"
    assert f"Tightest promise: joint_1 stays within its range at work, at 3.0 s {left}." in said


def test_a_job_of_work_alone_gains(triangle_plan: Plan) -> None:
    scene = triangle_plan.scene.with_posture(triangle_plan.start.posture)
    said = verdict(replace(without_approach(triangle_plan), scene=scene))
    assert "the work alone" not in said
    assert "% less than the baseline's 486.4 Nm; the still part adds 74.5 Nm. With" in said


def test_hardly_a_gain_is_called_so(triangle_plan: Plan) -> None:
    """Below 1 % of the peak over the whole job."""
    before = triangle_plan.baseline.job_figures.peak_guardrail_torque
    for share, hardly in ((0.995, True), (0.98, False)):
        figures = replace(triangle_plan.job.segments[-1].figures, peak_guardrail_torque=share * before)
        certificate = replace(triangle_plan.job.segments[-1].certificate, figures=figures)
        work = changed(without_approach(triangle_plan), "work", certificate=certificate)
        work = replace(work, scene=work.scene.with_posture(work.start.posture))
        swung = 1e3 * work.baseline_sway[1]
        told = f"486.4 Nm, but after the stop the tool swings by {work.sway.swing_mm:.3f} in place of"
        assert (f"{told} {swung:.3f} mm" in verdict(work)) == hardly
        # As calm as before.
        work.__dict__["baseline_sway"] = (0.0, 1e-3 * work.sway.swing_mm)
        assert ("less than the baseline's 486.4 Nm: hardly anything is gained" in verdict(work)) == hardly


@pytest.mark.parametrize(("share", "little"), [(0.98, True), (0.9, False)])
def test_a_small_gain_is_told_with_the_joints_that_travel_further(
    triangle_plan: Plan, share: float, little: bool
) -> None:
    before = triangle_plan.baseline.job_figures.peak_guardrail_torque
    figures = replace(triangle_plan.job.segments[-1].figures, peak_guardrail_torque=share * before)
    certificate = replace(triangle_plan.job.segments[-1].certificate, figures=figures)
    work = changed(without_approach(triangle_plan), "work", certificate=certificate)
    work = replace(work, scene=work.scene.with_posture(work.start.posture))
    *others, stroke = work.baseline.segments
    q, once = stroke.samples.q, further(work)
    assert once == pytest.approx(
        np.linalg.norm(np.abs(np.diff(work.trajectory.q, axis=0)).sum(axis=0))
        / np.linalg.norm(np.abs(np.diff(q, axis=0)).sum(axis=0))
    )
    nearer = replace(stroke.samples, q=q[0] + 0.1 * (q - q[0]))
    work = with_baseline(work, segments=(*others, replace(stroke, samples=nearer)))
    assert further(work) == pytest.approx(10 * once)
    assert (f", with joints that travel {10 * once:.1f} times as far at work" in verdict(work)) == little
    (told,) = (remark for remark in remarks(work) if remark.startswith("At work the joints travel"))
    ways = travels(work, work.baseline)
    joint = int((ways[0] - ways[1]).argmax())
    far, less = np.rad2deg([way[joint] for way in ways])
    assert f"most of all {work.robot.joints[joint]}, {far:.3g} deg in place of {less:.3g} deg" in told


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"min_clearance": -0.001}, "collides"),
        ({"velocity": 1.1}, "breaks joint limits"),
        ({"torque": 1.1, "min_clearance": -0.001}, "collides and breaks joint limits"),
        ({"turn": 7.0}, "breaks joint limits"),
        ({"min_clearance": 0.019}, "breaks the safety margin"),
        ({"max_tool_deviation": 0.0021}, "leaves its path by 2.1 mm"),
        (
            {"min_clearance": -0.1, "torque": 1.1, "max_tool_deviation": 0.0021},
            "collides, breaks joint limits and leaves its path by 2.1 mm",
        ),
    ],
)
def test_a_baseline_that_cannot_be_executed_is_called_so(
    triangle_plan: Plan, change: dict[str, float], fault: str
) -> None:
    assert baseline_faults(triangle_plan) == ""
    assert "no gain" not in verdict(triangle_plan)
    plan, change = replace(triangle_plan), dict(change)
    (*others, work) = plan.baseline.segments
    q = work.samples.q + change.pop("turn", 0.0)
    rates = {name: change.pop(name) for name in ("velocity", "torque") if name in change}
    use = replace(work.figures.limit_use, **rates)
    figures = replace(work.figures, limit_use=use, **change)
    work = replace(work, samples=replace(work.samples, q=q), figures=figures)
    plan = with_baseline(plan, segments=(*others, work))
    said = verdict(plan)
    assert f"; no gain is stated, as the baseline (486.4 Nm) {fault}; the work alone" in said
    assert "than the baseline's 486.4 Nm over" not in said
    # At work the baseline keeps all limits.
    work, before = (each.peak_guardrail_torque for each in (plan.figures, plan.baseline.figures))
    less = f"{work:.1f} Nm, {100 * (1 - work / before):.1f} % less than the baseline's {before:.1f} Nm"
    assert (f"the work alone {less}" in said) == (baseline_faults(plan, work=True) == "")


def test_a_heavy_approach_is_a_loss_and_has_its_time(returning_plan: Plan) -> None:
    approach = returning_plan.approach
    assert approach is not None
    figures = replace(approach.figures, peak_guardrail_torque=800.0)
    heavy = changed(returning_plan, "approach", certificate=replace(approach.certificate, figures=figures))
    said = verdict(heavy)
    assert "The guardrail must bear 800.0 Nm over the whole job (on the approach, at " in said
    assert "% more than the baseline's " in said


def test_the_tightest_promise_may_be_any_segments(returning_plan: Plan) -> None:
    back = returning_plan.job.segments[-1]
    tight = Check(quantity="clearance", time=1.5, value=0.0200001, bound=0.02, unit="m", at_least=True)
    certificate = replace(back.certificate, checks=(*back.certificate.checks, tight))
    segment, check = tightest_check(changed(returning_plan, "return", certificate=certificate).job)
    assert (segment.name, check.quantity) == ("return", "clearance")
    assert check.time == pytest.approx(back.begin + 1.5)
