"""The sentences beside a plan's figures: grammar, and what they say of unusual plans."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cmbot.errors import PathNotFound
from cmbot.planning import Plan, Start, remarks
from cmbot.validation import counted


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
    assert line(short_plan, "Certified: ").startswith("Certified: 9 checks hold; ")
    certificate = replace(short_plan.certificate, checks=short_plan.certificate.checks[:1])
    one = replace(short_plan, certificate=certificate)
    assert line(one, "Certified: ").startswith("Certified: 1 check holds; ")


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


def test_what_is_done_about_vibration_is_told(triangle_plan: Plan) -> None:
    said = " ".join(remarks(triangle_plan))
    assert triangle_plan.quieting is not None
    assert "the first 2 elastic modes are brought to rest" in said
    assert f"{1e3 * triangle_plan.quieting.before:.4f} mm" in said
    given_up = replace(triangle_plan, quieting=replace(triangle_plan.quieting, share=0.0))
    assert "could not be brought to rest" in " ".join(remarks(given_up))
