"""Random jobs: the share of those with a way, why others failed, and a page that follows from them."""

import json
from typing import Any

import run_jobs
from report.document import PAGE, page


def row(name: str, *, way: bool = True, **plan: Any) -> dict[str, Any]:
    planned = {"status": "planned", "cpu_seconds": 2.0, "violations": []}
    return {"name": name, "seed": 7, "arm": "ur5", "oracle": {"way": way}, "plan": planned | plan}


def test_the_share_is_of_jobs_with_a_way() -> None:
    rows = [row("a"), row("b", way=False), row("c", status="no plan", reason="jerk of joint_1 | 3 %")]
    rows += [row("d", way=False, status="no plan", reason="out of reach")]
    assert run_jobs.success(rows).rows[-1] == ("7 all", "4", "2", "1 (50 %)", "2", "0", "2.0")
    assert run_jobs.failures(rows).rows == (("c", "jerk of joint_1 / 3 %"),)
    assert run_jobs.failures(rows[:2]).rows == (("none", "-"),)


def test_a_plan_that_breaks_a_limit_is_wrong() -> None:
    rows = [row("a", violations=["leg_1: torque 3 % over"])]
    assert run_jobs.success(rows).rows[-1][5] == "1"
    assert run_jobs.failures(rows).rows == (("a", "wrong: leg_1: torque 3 % over"),)


def test_the_page_is_that_of_the_results() -> None:
    text = PAGE.read_text(encoding="utf-8")
    results = json.loads(run_jobs.REFERENCE.read_text(encoding="utf-8"))
    assert page(PAGE, run_jobs.blocks(results)) == text
