"""The sentences beside a plan's figures: grammar, and what they say of unusual plans."""

import json
from dataclasses import replace

import numpy as np
import pytest
from plan_folders import changed, with_baseline
from scipy.spatial.distance import pdist
from small_scenes import short_scene

from cmbot.accuracy import stroke_sway
from cmbot.common.errors import PathNotFound
from cmbot.common.limit import Limit
from cmbot.common.reading.validation import counted
from cmbot.planning import Plan, Start, bending_arm, first_remarks, notes, remarks, sentence
from cmbot.planning.initial_guess import Choice
from cmbot.scene import start_entry
from cmbot.simulation import Tracking
from cmbot.trajectory import QuinticTrajectory


@pytest.mark.parametrize(
    ("number", "words"), [(0, "0 passes"), (1, "1 pass"), (2, "2 passes"), (21, "21 passes")]
)
def test_counted(number: int, words: str) -> None:
    assert counted(number, "pass", "passes") == words
    assert counted(number, "row") == words.replace("pass", "row").replace("rowes", "rows")


def line(plan: Plan, beginning: str) -> str:
    (found,) = (remark for remark in remarks(plan) if remark.startswith(beginning))
    return found


@pytest.mark.parametrize(("number", "passes"), [(1, "(1 pass)"), (2, "(2 passes)")])
def test_passes_are_counted(short_plan: Plan, number: int, passes: str) -> None:
    plan = replace(short_plan, passes=number * short_plan.passes[:1])
    assert passes in line(plan, "Time: ")


def test_checks_are_counted(short_plan: Plan) -> None:
    assert line(short_plan, "Certified: ").startswith("Certified: 16 checks hold, computed again ")
    certificate = replace(short_plan.certificate, checks=short_plan.certificate.checks[:1])
    one = changed(short_plan, "work", certificate=certificate)
    assert line(one, "Certified: ").startswith("Certified: 1 check holds, computed again ")


@pytest.mark.parametrize(
    ("failures", "words"), [(1, "Another one with"), (3, "The last of 3 others tried with")]
)
def test_other_starts_are_counted(short_plan: Plan, failures: int, words: str) -> None:
    failure = PathNotFound("in the way", time=1.0, progress=0.5, smallest_singular_value=0.3)
    start = Start(posture=short_plan.start.posture, moved=0.1, failures=failures * (failure,))
    said = line(replace(short_plan, start=start), "Starts elsewhere: ")
    assert said.startswith(f"Starts elsewhere: from the scene's posture, in the way. {words} the same tool")


def test_a_plan_that_gains_nothing_says_so(short_plan: Plan, triangle_plan: Plan) -> None:
    said = [" ".join(remarks(each)) for each in (short_plan, triangle_plan)]
    assert "Hardly anything is gained at the peak" in said[0]
    assert "Hardly anything" not in said[1]


def test_more_jerk_than_the_baselines_is_told_where_something_bends(triangle_plan: Plan) -> None:
    assert "The joints jerk" not in " ".join(remarks(triangle_plan))
    use = triangle_plan.figures.limit_use
    calm = replace(triangle_plan.baseline.figures, limit_use=replace(use, jerk=use.jerk / 3))
    hard = with_baseline(triangle_plan, figures=calm)
    said = line(hard, "The joints jerk 3.0 times as hard as the baseline's, ")
    assert said.endswith("tool and base may sway more.")
    rigid = replace(hard.robot, elasticity={}, joint_elasticity={})
    stiff = replace(hard, scene=short_scene(guardrail={"bays": 0}), robot=rigid)
    assert "The joints jerk" not in " ".join(remarks(stiff))


def test_sag_beyond_the_allowed_deviation_is_told(
    short_plan: Plan, short_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    said = line(short_plan, "Bent by its own weight the tool is up to ")
    assert said.endswith(
        " mm off its path, more than max_tool_deviation_m (0.2 mm), which the rigid arm keeps."
    )
    # The simulation sways about the sag.
    found, moved = 1e-3 * float(said.split()[10]), short_tracking.planned
    assert abs(found - moved.largest_off_path) <= moved.largest(moved.dynamic)
    (row,) = (row for row in short_plan.rows() if row[0] == "bent tool off its path, at rest, mm")
    assert row[-1] == f"{1e3 * found:.2f}"
    for sags, expected in ((0.99 * found, True), (1.01 * found, False)):
        options = replace(short_plan.options, max_tool_deviation_m=sags)
        told = " ".join(remarks(replace(short_plan, options=options)))
        assert ("Bent by its own weight" in told) == expected
    assert "Bent by" not in " ".join(remarks(compensated_short[0]))


def test_a_tool_further_off_than_the_baselines_is_explained(compensated_short: tuple[Plan, Tracking]) -> None:
    plan = compensated_short[0]
    _, off = plan.bent_offsets
    for without, told in ((0.9 * off, True), (1.1 * off, False)):
        other = replace(plan)
        other.__dict__["bent_deviation"] = ([(np.zeros(1), np.array([without]))], plan.bent_deviation[1])
        said = " ".join(remarks(other))
        assert (f"{1e3 * off:.2f} mm off its path, the baseline's {1e3 * without:.2f} mm: " in said) == told


def test_a_base_too_soft_for_an_equilibrium_is_told(triangle_plan: Plan) -> None:
    # It turns with the tool, and is far beyond the force at which the arm buckles.
    pushed = replace(triangle_plan.robot, tool_force=np.array([0.0, 0.0, -1e5]))
    assert line(replace(triangle_plan, robot=pushed), "NOT STIFF ENOUGH: ").endswith(
        "bent by its own weight and the process force the arm on its guardrail has no stable equilibrium."
    )


def test_a_start_that_only_the_sag_moved_is_called_so(compensated_short: tuple[Plan, Tracking]) -> None:
    plan = compensated_short[0]
    shifted = plan.scene.posture + 0.01
    beside = replace(plan, start=replace(plan.start, posture=shifted, moved=0.01))
    assert line(beside, "Starts in ").startswith(
        "Starts in the scene's posture, with the sag compensated: up to 0.6 deg a joint from it"
    )
    far = replace(plan, start=replace(plan.start, posture=plan.scene.posture + 0.1, moved=0.1))
    for peak, which in ((1.5, "a better"), (1.01, "another")):
        found = replace(far, choice=Choice(free=1.0, pinned=peak))
        assert line(found, "Starts in ").startswith(f"Starts in {which} posture with the same tool pose")


def row(plan: Plan, beginning: str) -> tuple[str, ...]:
    (found,) = (row for row in plan.rows() if row[0].startswith(beginning))
    return found


def test_what_another_start_and_sequences_of_postures_ask_are_rows(triangle_plan: Plan) -> None:
    pinned = "peak at rest, had it started where the arm is"
    assert row(triangle_plan, pinned)[-1] == f"{triangle_plan.choice.pinned:.2f}"
    # Where it starts there, nothing is said of what would have been; nor where no sequence was found.
    stays = replace(triangle_plan, start=replace(triangle_plan.start, moved=0.0))
    none = replace(triangle_plan, choice=Choice(free=400.0, pinned=None))
    for plan in (stays, none):
        assert not any(name.startswith("peak at rest, had") for name, *_ in plan.rows())
    far = replace(triangle_plan, choice=Choice(free=400.0, pinned=500.0))
    assert row(far, "least peak of sequences of postures")[-1] == "400.00"
    held = replace(far, options=replace(far.options, start="pinned"))
    assert row(held, "least peak of sequences of postures")[-1] == "500.00"
    assert row(held, "peak at rest, had it started in another posture")[-1] == "400.00"


def test_what_is_far_above_a_loose_bound_is_compared_with_sequences_of_postures(triangle_plan: Plan) -> None:
    """A static bound far below says little where sequences of postures ask nearly what is planned."""
    objective = replace(triangle_plan.objective, planned_peak=172.0, floor=100.0)
    far = replace(triangle_plan, objective=objective, choice=Choice(free=171.0, pinned=160.0))
    both = "+72.000 % from it, +0.585 % from the least of sequences of postures (estimate)"
    assert both in line(far, "Lower bound")
    pinned = replace(far, options=replace(far.options, start="pinned"))
    assert "+72.000 % from it, +7.500 % from the least" in line(pinned, "Lower bound")
    none = replace(far, choice=Choice(free=None, pinned=None))
    assert line(none, "Lower bound").endswith("+72.000 % from it.")


def test_a_plan_that_asks_more_than_the_baseline_says_so(triangle_plan: Plan) -> None:
    objective = replace(triangle_plan.objective, planned_peak=1.1 * triangle_plan.objective.baseline_peak)
    said = line(replace(triangle_plan, objective=objective), "The peak is 10.00 % higher than the baseline's")
    assert "Hardly" not in said


def test_a_floor_that_is_not_settled_promises_nothing(triangle_plan: Plan) -> None:
    value = triangle_plan.lower_bound.value
    floor = replace(triangle_plan.lower_bound, error=0.3 * value, kind="estimated", missed=0.01)
    said = line(replace(triangle_plan, lower_bound=floor, compensation=None), "Lower bound, not closed: ")
    assert f"the search ended with {floor.error:.3f} Nm open" in said
    assert "no plan within the limits" not in said


def test_a_floor_is_called_what_it_is(triangle_plan: Plan) -> None:
    rigid = replace(triangle_plan, compensation=None)
    proven, error = triangle_plan.lower_bound, f"{triangle_plan.lower_bound.error:.3f} Nm"
    said = line(rigid, "Lower bound: no plan within the limits has a static peak below ")
    assert f" Nm (proven; error {error}); the peak is " in said
    estimate = replace(proven, kind="estimated", missed=0.0123)
    said = line(replace(rigid, lower_bound=estimate), "Lower bound: ")
    assert (
        "no plan within the limits was found with a static peak below 383.79 Nm (estimate; at most 1.23 % of"
        in said
    )
    assert f"postures are missed, with 95 % confidence; error {error}); the peak" in said
    unknown = line(replace(rigid, lower_bound=replace(estimate, missed=None)), "Lower bound: ")
    assert f"383.79 Nm (estimate; error {error});" in unknown


def test_a_plan_that_gravity_has_no_part_in_says_so(triangle_plan: Plan) -> None:
    assert "Gravity has no part" not in " ".join(remarks(triangle_plan))
    objective = replace(triangle_plan.objective, axis_weights=(0.0, 0.0, 1.0), floor=0.0)
    said = line(replace(triangle_plan, objective=objective), "Gravity has no part in what was minimised")
    assert "axis_weights with x or y above 0" in said


def test_an_arm_without_an_elasticity_file_is_said_to_be_rigid_where_the_base_bends(
    short_plan: Plan,
) -> None:
    rigid = replace(short_plan.robot, elasticity={}, joint_elasticity={})
    said = "Links and joints are taken to be rigid, without an elasticity file; only the guardrail bends."
    assert said in remarks(replace(short_plan, robot=rigid))
    assert said not in remarks(short_plan)
    scene = short_scene(guardrail={"bays": 0})
    assert "taken to be rigid" not in " ".join(remarks(replace(short_plan, scene=scene, robot=rigid)))


def test_the_largest_swing_of_all_strokes_is_told(strokes_plan: Plan) -> None:
    arm = bending_arm(strokes_plan.scene, strokes_plan.robot)
    share = strokes_plan.options.quiet_stiffness_share
    swings = [stroke_sway(arm, each.trajectory, share).largest[1] for each in strokes_plan.job.strokes]
    assert (
        row(strokes_plan, f"tool swings after a stroke, free moves left out, stiffness ±{100 * share:g} %")[
            -1
        ]
        == f"{1e3 * max(swings):.3f}"
    )


def test_the_baseline_sways_as_it_does_simulated(triangle_plan: Plan, triangle_tracking: Tracking) -> None:
    alike = replace(triangle_plan, options=replace(triangle_plan.options, quiet_stiffness_share=0.0))
    simulated = triangle_tracking.baseline
    moving = np.linalg.norm(simulated.dynamic[simulated.t < simulated.stop], axis=1).max()
    swinging = pdist(simulated.dynamic[simulated.t >= simulated.stop - 1e-9]).max()
    np.testing.assert_allclose(alike.baseline_sway, (moving, swinging), rtol=0.1)
    names = ("largest sway at work", "tool swings after the work")
    told = [row(triangle_plan, f"{name}, stiffness ±30 %")[-2] for name in names]
    assert told == [f"{1e3 * each:.3f}" for each in triangle_plan.baseline_sway]
    assert replace(triangle_plan, baseline=None).baseline_sway is None


@pytest.mark.parametrize("name", ["triangle_plan", "strokes_plan", "returning_plan", "short_plan"])
def test_what_is_shown_first_is_short_and_begins_with_the_tool(
    request: pytest.FixtureRequest, name: str
) -> None:
    plan: Plan = request.getfixturevalue(name)
    rows, sentences = list(plan.rows(first=True)), first_remarks(plan)
    assert len(rows) <= 10 and len(sentences) <= 5
    assert rows[0][0].startswith("tool off its path" if plan.accuracy else "largest tool deviation")
    assert set(rows) <= set(plan.rows())
    assert plan.summary().count("\n") == len(rows)
    assert str(plan).splitlines() == [*plan.summary().splitlines(), *sentences]
    base = f"The {plan.scene.base_name} must bear"
    order = "The tool is", "Hold:", base, "Free moves take ", "With "
    begun = [
        next(k for k, said in enumerate(order) if sentence.startswith(said)) for sentence in sentences[:4]
    ]
    assert begun == sorted(begun)


def test_every_note_has_a_level_values_and_one_sentence(triangle_plan: Plan) -> None:
    found = notes(triangle_plan)
    assert len(found) <= 15
    assert len({note.key for note in found}) == len(found)
    for note in found:
        assert note.level in ("first", "fault", "warning", "note")
        assert sentence(note).endswith(".")
        json.dumps(note.values, allow_nan=False)


def test_an_arm_that_bends_nowhere_has_its_tool_first_too(short_plan: Plan) -> None:
    rigid = replace(
        short_plan,
        scene=short_scene(guardrail={"bays": 0}),
        robot=replace(short_plan.robot, elasticity={}, joint_elasticity={}),
    )
    off = 1e3 * short_plan.figures.max_tool_deviation
    assert rigid.accuracy is None
    assert first_remarks(rigid)[0] == f"The tool is within {off:.3g} mm of its path, as the rigid arm has it."
    assert next(rigid.rows(first=True))[0] == "largest tool deviation, mm"


def test_free_moves_that_take_far_longer_than_the_work_are_told_with_what_bounds_them(
    triangle_plan: Plan,
) -> None:
    def said(plan: Plan) -> list[str]:
        return [sentence(note) for note in notes(plan) if note.key == "free_moves"]

    assert said(triangle_plan) == []
    approach = triangle_plan.approach
    t, q, v, a = (getattr(approach.trajectory, name) for name in "tqva")
    slow = QuinticTrajectory(t=8 * t, q=q, v=v / 8, a=a / 64)
    work = triangle_plan.job.segment("work")
    begun = changed(triangle_plan, "work", begin=work.begin + 7 * approach.duration)
    free, total = 8 * approach.duration, 8 * approach.duration + work.duration
    first = f"Free moves take {free:.0f} of {total:.0f} s: the longest, the approach, is bounded by the "
    angles = ", ".join(f"{round(angle, 4)}" for angle in np.degrees(triangle_plan.start.posture))
    entry = f"start: {{posture_deg: [{angles}]}}"
    pinned = "; --set start=pinned begins in the scene's posture, and may load the base more"
    start = f"; {entry} needs hardly any approach{pinned}"
    assert said(changed(begun, "approach", trajectory=slow)) == [f"{first}velocity of joint_4{start}."]
    checks = tuple(
        replace(check, value=0.5 * check.bound) if check.limit is Limit.VELOCITY else check
        for check in approach.certificate.checks
    )
    idle = replace(approach.certificate, checks=checks)
    (told,) = said(changed(begun, "approach", trajectory=slow, certificate=idle))
    assert told == f"{first}slowest mode or by what base, feet and joints bear{start}."
    # A start within 5 deg of the end of a range leaves a motion little room: it is not advised.
    end, q = changed(begun, "approach", trajectory=slow), begun.start.posture
    for beyond, advised in ((6.0, start), (4.0, pinned)):
        ends = replace(
            end.robot.limits, upper=np.append(end.robot.limits.upper[:-1], q[-1] + np.radians(beyond))
        )
        (told,) = said(replace(end, robot=replace(end.robot, limits=ends)))
        assert told == f"{first}velocity of joint_4{advised}."
    # At the end of a range, 169.98496 deg, which would be rounded beyond it.
    end = np.radians(169.98496)
    ends = replace(begun.robot.limits, upper=np.append(begun.robot.limits.upper[:-1], end))
    assert start_entry(np.append(q[:-1], end), ends).endswith(", 169.9849]")
    # From where the work begins there is none to be spared.
    there = replace(triangle_plan.start, moved=0.0)
    slow_there = replace(changed(begun, "approach", trajectory=slow), start=there)
    assert said(slow_there) == [f"{first}velocity of joint_4."]


def test_no_gain_is_stated_against_hasty_free_moves_of_the_baseline(strokes_plan: Plan) -> None:
    """They are as quick as the joints can move: what planning gains is told for the work."""
    (note,) = (each for each in notes(strokes_plan) if each.key == "base")
    values = {"faults": None, "work_faults": None, "peak_nm": 28.8, "work_nm": 28.8, "rest": "begins"}
    hasty = sentence(
        replace(note, values=note.values | values | {"baseline_nm": 37.7, "baseline_work_nm": 29.3})
    )
    assert "; the baseline has 37.7 Nm in its free moves, as quick as joints can; " in hasty
    assert "the work alone 28.8 Nm, 1.7 % less than the baseline's 29.3 Nm" in hasty
    assert "23" not in hasty
    alike = replace(note, values=note.values | values | {"baseline_nm": 29.3, "baseline_work_nm": 29.3})
    assert (
        "28.8 Nm over the whole job (at rest in the posture in which the arm begins), 1.7 % less"
        in sentence(alike)
    )
