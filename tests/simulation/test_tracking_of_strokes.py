"""Jobs of several strokes simulated: as their strokes alone, and without process force between them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_motions import track

from cmbot.elastic.sag import Sag
from cmbot.planning import Job, Plan
from cmbot.robot import Kinematics
from cmbot.simulation import (
    MotionTracking,
    PrescribedWork,
    SimulationOptions,
    Tracking,
    base_movement,
    simulate,
    statistics,
    track_work,
    tracking_summary,
    tracking_verdict,
)
from cmbot.simulation.tracking import elastic_arm_of
from cmbot.trajectory import QuinticTrajectory

OPTIONS = SimulationOptions(settle_s=0.5)


def works(plan: Plan, tracking: Tracking) -> list[tuple[PrescribedWork, MotionTracking]]:
    return [
        (PrescribedWork.baseline(plan), tracking.baseline),
        (PrescribedWork.planned(plan), tracking.planned),
    ]


def alone(plan: Plan) -> Plan:
    """A plan of the first stroke, its motion as it is in the job."""
    job = Job(segments=plan.work.segments[:1])
    first = dict(vars(plan.strokes[0]))
    first["baseline"] = replace(plan.baseline, **vars(first["baseline"]), segments=plan.baseline.work[:1])
    return replace(plan, **first, several=(), job=job)


def test_the_first_stroke_errs_as_one_alone(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    single = simulate(alone(strokes_plan), replace(OPTIONS, settle_s=0.0))
    for (_, one), (_, both) in zip(single.motions, strokes_tracking.motions, strict=True):
        assert one.stop == pytest.approx(3.0)
        for name in ("t", "error", "static", "command", "path_error"):
            ours = getattr(both, name)[: len(one.t)]
            np.testing.assert_allclose(ours, getattr(one, name), rtol=0, atol=1e-12)


def test_both_works_are_simulated_whole(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    ends = strokes_plan.baseline.samples.t[-1], strokes_plan.work.duration
    for (work, motion), end in zip(works(strokes_plan, strokes_tracking), ends, strict=True):
        assert [part.path is None for part in work.parts] == [False, True, False]
        assert motion.stop == pytest.approx(end, rel=1e-12)
        assert motion.t[-1] == pytest.approx(end + OPTIONS.settle_s, abs=OPTIONS.output_step_s)
        samples = (
            strokes_plan.baseline.samples if motion is strokes_tracking.baseline else strokes_plan.samples
        )
        np.testing.assert_allclose(work.postures(samples.t), samples.q, atol=1e-9)


def test_between_strokes_no_force_acts(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    """The static sag jumps by that of the force, the error does not."""
    arm = elastic_arm_of(strokes_plan, OPTIONS)
    pushed, off = Sag(arm), Sag(arm.tool_off)
    for work, motion in works(strokes_plan, strokes_tracking):
        first, free, last = work.parts
        q, between = work.postures(motion.t), (motion.t > free.begin) & (motion.t < last.begin)
        for sag, some in ((pushed, ~between), (off, between)):
            np.testing.assert_allclose(motion.static[some][::20], sag.at(q[some][::20]).tool, atol=1e-6)
        for begin, sign in ((free.begin, -1), (last.begin, 1)):
            # The sample before the change: a join belongs to the stroke.
            k = int(np.searchsorted(motion.t, begin - sign * 1e-9)) - 1
            posture = work.postures(np.array([begin]))
            jump = sign * (pushed.at(posture).tool[0] - off.at(posture).tool[0])
            assert np.linalg.norm(jump) > 5e-4
            np.testing.assert_allclose(motion.static[k + 1] - motion.static[k], jump, atol=3e-5)
            assert np.linalg.norm(motion.error[k + 1] - motion.error[k]) < 0.2 * np.linalg.norm(jump)
        assert first.begin == 0.0


def test_a_held_arm_comes_to_rest_with_the_force_and_without(strokes_plan: Plan) -> None:
    """What rests hangs at its own sag."""
    arm, task = elastic_arm_of(strokes_plan, OPTIONS), strokes_plan.task
    q = strokes_plan.trajectory.q[:1]
    still = QuinticTrajectory.held(q[0], 1.5)
    work = PrescribedWork.of([(still, task.path), (still, None), (still, task.path)])
    motion = track_work(arm, work, replace(OPTIONS, damping=0.3))
    for end, sag in ((1.5, Sag(arm)), (3.0, Sag(arm.tool_off)), (4.5, Sag(arm)), (5.0, Sag(arm))):
        before = int(np.searchsorted(motion.t, end)) - 2
        np.testing.assert_allclose(motion.error[before], sag.at(q).tool[0], atol=1e-6)


def test_the_state_goes_on_from_segment_to_segment(strokes_plan: Plan) -> None:
    """Without a force, the work is one motion from rest to rest."""
    options = replace(OPTIONS, settle_s=0.0)
    arm = elastic_arm_of(strokes_plan, options).tool_off
    whole = track(arm, strokes_plan.task, strokes_plan.trajectory, options)
    parts = track_work(arm, PrescribedWork.planned(strokes_plan), options)
    np.testing.assert_allclose(parts.error, whole.error, atol=2e-6)
    assert np.abs(whole.dynamic).max() > 1e-4


def test_the_path_counts_along_strokes_alone(strokes_plan: Plan, strokes_tracking: Tracking) -> None:
    for work, motion in works(strokes_plan, strokes_tracking):
        _, free, last = work.parts
        between = (motion.t > free.begin * (1 + 1e-9)) & (motion.t < last.begin * (1 - 1e-9))
        for array in (motion.command, motion.path_error):
            assert np.isnan(array[between]).all()
            assert np.isfinite(array[~between]).all()
        # Of the second stroke from its own path, on its own clock.
        at = motion.t >= last.begin
        points, _ = Kinematics(strokes_plan.robot).tool_poses(work.postures(motion.t[at]))
        path = strokes_plan.strokes[1].task.path
        off = points - path.position(motion.t[at] - last.begin)
        np.testing.assert_allclose(motion.command[at], off, rtol=0, atol=1e-12)
        moving = motion.t <= motion.stop
        strokes = np.linalg.norm(motion.path_error[moving & ~between], axis=1)
        assert motion.metrics.path.rms[3] == pytest.approx(np.sqrt((strokes**2).mean()), rel=2e-3)
        assert motion.metrics.path.peak_to_peak[3] == pytest.approx(np.ptp(strokes), rel=1e-12)
        assert motion.metrics.total.mean == pytest.approx(
            statistics(motion.t[moving], motion.error[moving]).mean
        )
        assert np.abs(motion.command[~between]).max() < strokes_plan.options.max_tool_deviation_m


def test_the_sag_that_is_compensated_is_that_of_each_segment(strokes_plan: Plan) -> None:
    arm = elastic_arm_of(strokes_plan, OPTIONS)
    motion = track_work(arm, PrescribedWork.planned(strokes_plan), OPTIONS, sag=Sag(arm))
    assert np.abs(motion.static).max() < 1e-6
    allowed = replace(strokes_plan.options, compensate=True, max_tool_deviation_m=1e-4)
    tracking = Tracking(options=OPTIONS, baseline=motion, planned=motion, seconds=0.0)
    verdict = tracking_verdict(replace(strokes_plan, options=allowed), tracking)
    largest = max(check.value for _, check in strokes_plan.job.checks() if "tool deviation" in check.quantity)
    assert "though the foreseen sag is compensated: beside it, it sways." in verdict
    assert f"What the plan certifies, {1e3 * largest:.2f} mm, is the arm at rest" in verdict
    assert "SWAYS MORE" not in verdict
    calm = replace(motion, error=motion.static + 0.9 * motion.dynamic)
    ends = [f"{1e3 * each.largest(each.dynamic):.3f} mm" for each in (motion.at_work, calm.at_work)]
    said = tracking_verdict(strokes_plan, replace(tracking, baseline=calm))
    assert f"SWAYS MORE than the baseline: beside its sag the tool moves by up to {ends[0]}, " in said
    # Nothing is advised that was not tried.
    assert said.endswith(f"the baseline's by {ends[1]}.")


def test_what_is_largest_is_told_of_the_work_before_free_moves(
    strokes_plan: Plan, strokes_tracking: Tracking
) -> None:
    rows = {name: float(after) for name, _, after in tracking_summary(strokes_tracking, compensated=False)}
    motion = strokes_tracking.planned
    size, moving = 1e3 * np.linalg.norm(motion.dynamic, axis=1), motion.t <= motion.stop
    free = np.isnan(motion.path_error[:, 0])
    names = [f"tool sways beside its sag {when}, at most" for when in ("at work", "on free moves")]
    assert [name for name in rows if "sways" in name] == names
    for name, where in zip(names, (~free, free), strict=True):
        assert rows[name] == pytest.approx(size[where & moving].max(), abs=1e-3)
    assert "tool swings after the work, free moves included" in rows
    torque = np.linalg.norm(motion.base[:, 6:], axis=1)
    said = base_movement(strokes_plan, strokes_tracking)
    at_work, on_free_moves = said.split("; it moves on free moves by up to ")
    for part, where in ((at_work, ~free), (on_free_moves, free)):
        assert f"with vibration it bears up to {torque[where & moving].max():.2f} Nm about" in part
    segments = {segment.name for segment in strokes_plan.job.segments}
    for name in ("approach", "return"):
        assert (name in said.partition("Not simulated: ")[2]) == (name in segments)
