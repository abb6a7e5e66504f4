"""The sentences beside a plan's figures: grammar, and what they say of unusual plans."""

from dataclasses import replace

import numpy as np
import pytest
from plan_folders import changed, with_baseline
from small_scenes import short_scene

from cmbot.common.errors import PathNotFound
from cmbot.common.validation import counted
from cmbot.planning import Plan, Start, remarks
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression
from cmbot.planning.initial_guess import Choice
from cmbot.planning.result.stroke_plan import combined
from cmbot.simulation import Tracking


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
    assert line(short_plan, "Certified: ").startswith("Certified: 14 checks hold, computed again ")
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
    assert said.endswith("may sway more than the baseline's; cmbot simulate tells.")
    assert "The joints jerk" not in " ".join(remarks(replace(hard, suppression=None)))


def test_sag_beyond_the_allowed_deviation_is_told(
    triangle_plan: Plan, triangle_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    said = line(triangle_plan, "Bent by its own weight the tool is up to ")
    assert said.endswith(
        " mm off its path, more than max_tool_deviation_m (1 mm), which the rigid arm keeps; "
        "compensate: true can make up for the sag."
    )
    # The simulation sways about the sag.
    found, moved = 1e-3 * float(said.split()[10]), triangle_tracking.planned
    assert abs(found - moved.largest_off_path) <= moved.largest(moved.dynamic)
    for sags, expected in ((0.99 * found, True), (1.01 * found, False)):
        options = replace(triangle_plan.options, max_tool_deviation_m=sags)
        told = " ".join(remarks(replace(triangle_plan, options=options)))
        assert ("Bent by its own weight" in told) == expected
    assert "Bent by" not in " ".join(remarks(compensated_short[0]))


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
    assert line(far, "Starts in ").startswith("Starts in a better posture")


def suppressed(of: Plan, **changes: object) -> str:
    """Remarks on a plan whose vibration was suppressed."""
    done = {
        "modes": 2,
        "shares": (0.5, 0.7),
        "stiffness": (0.7, 1.0),
        "load_kg": (0.0, 1.0),
        "swing_without": (2e-3, 1e-3),
        "swing_with": (5e-4, 1e-4),
    }
    return " ".join(
        remarks(replace(of, suppression=VibrationSuppression(before=1e-3, after=3e-4, **done | changes)))
    )


def test_what_is_done_about_vibration_is_told(triangle_plan: Plan) -> None:
    said = suppressed(triangle_plan)
    assert (
        "the 2 slowest vibrations of guardrail and links are made 60 % smaller on average at the ends of the "
        "legs, as predicted. " in said
    )
    assert (
        "swings through 0.500 mm (without that 2.000) at most, simulated at 0.7 to 1 times the stiffness and "
        "with up to 1 kg more."
    ) in said
    assert "could not be brought to rest" in suppressed(triangle_plan, shares=(0.0, 0.0))
    assert "slowest vibration of guardrail and links is made" in suppressed(triangle_plan, modes=1)
    in_vain = suppressed(triangle_plan, shares=(0.0, 0.0), swing_with=(1.9e-3, 1e-3))
    assert "are left as they are: the change that was tried makes the largest swing hardly smaller" in in_vain
    assert "swings through 2.000 mm (with that 1.900) at most" in in_vain
    # What comes out the same is not told twice; what becomes worse as modelled is told.
    assert "swings through 2.000 mm at most" in suppressed(triangle_plan, swing_with=(1.9999e-3, 1e-4))
    worse = {"load_kg": (0.0, 0.0), "swing_without": (2e-3, 5e-5), "swing_with": (1e-3, 1e-4)}
    assert "; as modelled 0.100 mm (without that 0.050)." in suppressed(triangle_plan, **worse)
    old = dict.fromkeys(("stiffness", "load_kg", "swing_without", "swing_with"), ())
    assert "by 1.0000 mm to either side without that, and by 0.3000 mm" in suppressed(triangle_plan, **old)


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ((1.0, 1.0, 1.0), "are made 100 % smaller on average at the ends of the legs, as predicted. "),
        ((1.0, 0.5, 0.0), "at the ends of 2 of the 3 legs, and not at those of 1, where no change"),
    ],
)
def test_one_leg_without_suppression_does_not_hide_the_others(
    triangle_plan: Plan, shares: tuple[float, ...], words: str
) -> None:
    tables = {"swing_with": (1e-4,), "swing_without": (1e-3,), "stiffness": (1.0,), "load_kg": (0.0,)}
    suppression = replace(triangle_plan.suppression, shares=shares, **tables)
    assert words in line(replace(triangle_plan, suppression=suppression), "Vibration suppression: ")
    assert suppression.share == pytest.approx(sum(shares) / len(shares))


def test_words_of_the_trade_are_explained_where_they_are_used(triangle_plan: Plan) -> None:
    at, said = triangle_plan.lower_bound.via_point + 1, line(triangle_plan, "Lower bound: ")
    assert f"at via-point {at} of the 50 that the motion passes through, no posture has a smaller" in said
    approach = line(triangle_plan, "Approach: ")
    assert approach.startswith("Approach: before the work the arm goes there from the scene's posture, in ")
    assert approach.endswith(" mm, certified.")
    assert line(triangle_plan, "Against the baseline, the paper's motion without optimisation: ")
    pinned = "Had it started in the scene's posture (start: pinned)"
    assert "the peak at rest would be " in line(triangle_plan, pinned)
    # Where it starts there, nothing is said of what would have been.
    stays = replace(triangle_plan, start=replace(triangle_plan.start, moved=0.0))
    assert pinned not in " ".join(remarks(stays))
    none = replace(triangle_plan, choice=Choice(free=400.0, pinned=None))
    assert "no sequence of postures through the charts was found" in line(none, pinned)


def test_what_sequences_of_postures_ask_is_told_where_it_is_more_than_the_bound(triangle_plan: Plan) -> None:
    assert not any(remark.startswith("Sequences: ") for remark in remarks(triangle_plan))
    far = replace(triangle_plan, choice=Choice(free=400.0, pinned=500.0))
    gap = 100 * (triangle_plan.objective.planned_peak / 400 - 1)
    assert line(far, "Sequences: ") == (
        "Sequences: no way through the charts of all via-points has a static peak below 400.00 Nm "
        f"(estimate); the peak is {gap:+.3f} % from that."
    )
    pinned = replace(far, options=replace(far.options, start="pinned"))
    said = line(pinned, "Sequences: no way from the scene's posture through the charts")
    assert "has a static peak below 500.00 Nm" in said


def test_a_plan_that_asks_more_than_the_baseline_says_so(triangle_plan: Plan) -> None:
    objective = replace(triangle_plan.objective, planned_peak=1.1 * triangle_plan.objective.baseline_peak)
    said = line(replace(triangle_plan, objective=objective), "The peak is 10.00 % higher than the baseline's")
    assert "Hardly" not in said


def test_a_floor_that_is_not_settled_promises_nothing(triangle_plan: Plan) -> None:
    value = triangle_plan.lower_bound.value
    floor = replace(triangle_plan.lower_bound, error=0.3 * value, kind="estimated", missed=0.01)
    said = line(replace(triangle_plan, lower_bound=floor), "Lower bound, not closed: ")
    assert f"the search ended with {floor.error:.3f} Nm open" in said
    assert "no plan within the limits" not in said


def test_a_floor_is_called_what_it_is(triangle_plan: Plan) -> None:
    proven, error = triangle_plan.lower_bound, f"{triangle_plan.lower_bound.error:.3f} Nm"
    said = line(triangle_plan, "Lower bound: no plan within the limits has a static peak below ")
    assert f" Nm (proven; error {error}): at via-point" in said
    estimate = replace(proven, kind="estimated", missed=0.0123)
    said = line(replace(triangle_plan, lower_bound=estimate), "Lower bound: ")
    assert (
        "no plan within the limits was found with a static peak below 383.79 Nm (estimate; at most 1.23 % of"
        in said
    )
    assert f"postures are missed, with 95 % confidence; error {error}): at via-point" in said
    assert "no posture was found with a smaller value" in said
    unknown = line(replace(triangle_plan, lower_bound=replace(estimate, missed=None)), "Lower bound: ")
    assert f"383.79 Nm (estimate; error {error}): at" in unknown


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
    """A stroke that hardly swings without suppression may be the one that swings most with it."""
    cases = {"modes": 2, "stiffness": (1.0, 0.7), "load_kg": (0.0, 1.0)}
    most, less = (1e-3, 2e-3), (8e-4, 1.9e-3)
    done = {"shares": (0.9,), "before": 2e-3, "after": 1e-4, "swing_with": (5e-5, 1e-4)}
    none = {"shares": (0.0,), "before": 1e-3, "after": 1e-3, "swing_with": less}
    loud = VibrationSuppression(**cases, **done, swing_without=most)
    left = VibrationSuppression(**cases, **none, swing_without=less)
    strokes = [
        replace(stroke, suppression=one)
        for stroke, one in zip(strokes_plan.strokes, (loud, left), strict=True)
    ]
    for order in (strokes, strokes[::-1]):
        whole = combined(order)["suppression"]
        said = line(replace(strokes_plan, suppression=whole), "Vibration suppression: ")
        assert "swings through 1.900 mm (without that 2.000) at most" in said
        assert "as modelled 0.800 mm (without that 1.000)" in said
        assert "at the ends of 1 of the 2 legs" in said
