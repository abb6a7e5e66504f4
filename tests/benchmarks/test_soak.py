"""The soak: knot sets of every kind, what counts as a failure, and a page that follows from its results."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import enclosures
import numpy as np
import pytest
import soak
from report import reliability
from report.document import page


def test_knot_sets_are_of_every_kind_and_the_same_again() -> None:
    kinds = []
    for seed in range(4):
        kind, made = soak.knot_set(seed)
        kinds.append(kind)
        np.testing.assert_array_equal(made.trajectory.a, soak.knot_set(seed)[1].trajectory.a)
        assert made.trajectory.t[-1] == pytest.approx(made.task.path.seconds.sum())
    assert kinds == list(soak.KINDS)
    assert np.ptp(soak.knot_set(2)[1].trajectory.q, axis=0).max() < 1e-6


def test_samples_outside_and_exceptions_are_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    found = soak.certified_knots(0, 4)
    assert found["failures"] == []
    assert found["sets"] == dict.fromkeys(soak.KINDS, 1)
    assert found["samples"] > 4 * 200
    certify = enclosures.certify

    def too_tight(*given: Any, **named: Any) -> Any:
        made = certify(*given, **named)
        return replace(made, guardrail_torque_bound=0.99 * made.guardrail_torque_bound)

    monkeypatch.setattr(enclosures, "certify", too_tight)
    (wrong,) = soak.certified_knots(0, 1)["failures"]
    assert (wrong["seed"], wrong["kind"]) == (0, soak.KINDS[0])
    assert "outside" in wrong["what"]

    def raises(*_: Any, **__: Any) -> Any:
        raise ValueError("no 3")

    monkeypatch.setattr(enclosures, "certify", raises)
    both = soak.certified_knots(0, 2)["failures"]
    results = {"knots": {"sets": {"a": 2}, "samples": 0, "failures": both, "cpu_seconds": 1.0}, "jobs": []}
    rows = next(sheet for sheet in reliability.sheets(results) if sheet.key == "soak-knots-failures").rows
    assert [row[1:] for row in rows] == [("ValueError: no …", "1", "0"), ("ValueError: no …", "1", "1")]


def test_jobs_are_told_by_how_they_ended() -> None:
    ways = [f"no way at t = {t} s: {near} come too near" for t, near in ((0.5, "link_1"), (12, "top_rail"))]
    long = "no " + "posture " * 100
    jobs: list[dict[str, Any]] = [
        {"name": "a", "arm": "ur5", "status": "planned", "violations": []},
        {"name": "b", "arm": "ur5", "status": "planned", "violations": ["leg_1: torque 3 % over"]},
        {"name": "c", "status": "crashed", "reason": "signal 11"},
        *({"name": "d", "arm": "ur5", "status": "no plan", "reason": f"{way}; wait"} for way in ways),
        {"name": "e", "arm": "ur5", "status": "no plan", "reason": long},
        {"name": "f", "arm": "ur5", "status": "new", "reason": "new"},
    ]
    jobs = [{"cpu_seconds": 60.0, **job} for job in jobs]
    results = {"knots": {"sets": {}, "samples": 0, "failures": [], "cpu_seconds": 0.0}, "jobs": jobs}
    table = {sheet.key: sheet for sheet in reliability.sheets(results)}
    headings = ("arm", "jobs", "planned", "no plan", "refused", "raised", "crashed", "timed out", "new")
    assert table["soak-jobs"].headings == (*headings, "false certificate")
    assert table["soak-jobs"].rows[-1] == ("all", "7", "2", "3", "0", "0", "1", "0", "1", "1")
    assert table["soak-jobs"].title == "7 jobs: 7 min of processor time, 60 s a job"
    why = {row[:2]: row[2] for row in table["soak-jobs-failures"].rows}
    assert why["crashed", "signal …"] == "1"
    assert why["no plan", "no way at t = … s: … come too near"] == "2"
    # What is too long ends with a word.
    (cut,) = (reason for _, reason in why if reason.startswith("no posture"))
    assert cut.endswith(" posture …")
    assert len(cut) < 250


def test_a_job_alone_is_the_one_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def make_job(seed: int, number: int, folder: str) -> dict[str, Any]:
        made.append((seed, number))
        Path(folder, "job.yaml").write_text('{"tool_path": {"strokes": [{}]}}', encoding="utf-8")
        return {"arm": "ur5"}

    monkeypatch.setattr(soak, "make_job", make_job)
    monkeypatch.setattr(soak, "plan_job", lambda folder: {"status": "planned", "folder": folder})
    name = soak.job_name(4, 94)
    found = soak._alone(name, tmp_path)
    assert found == {
        "file": str(tmp_path / "alone" / name / "job.yaml"),
        "arm": "ur5",
        "status": "planned",
        "folder": str(tmp_path / "alone" / name),
    }
    assert made == [(4, 94)]
    # Small, as those of the campaign are.
    assert json.loads(Path(found["file"]).read_text("utf-8"))["tool_path"]["strokes"] == [{"via_points": 8}]
    for wrong in ("j4-94-ur5", "j4-094-panda", "ur5", "k00000250"):
        with pytest.raises(SystemExit, match="expected the name of a job, such as j4-007"):
            soak._alone(wrong, tmp_path)


def test_the_page_follows_from_the_results() -> None:
    results = json.loads(reliability.REFERENCE.read_text(encoding="utf-8"))
    text = reliability.PAGE.read_text(encoding="utf-8")
    assert page(reliability.PAGE, reliability.blocks(results)) == text
    assert sum(results["knots"]["sets"].values()) > 0
