"""The soak: knot sets of every kind, what counts as a failure, and a page that follows from its results."""

import json
from dataclasses import replace
from typing import Any

import enclosures
import numpy as np
import pytest
import soak
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
    rows = next(sheet for sheet in soak.sheets(results) if sheet.key == "soak-knots-failures").rows
    assert [row[1:] for row in rows] == [("ValueError: no …", "1", "0"), ("ValueError: no …", "1", "1")]


def test_jobs_are_told_by_how_they_ended() -> None:
    jobs = [
        {"name": "a", "arm": "ur5", "status": "planned", "violations": []},
        {"name": "b", "arm": "ur5", "status": "planned", "violations": ["leg_1: torque 3 % over"]},
        {"name": "c", "status": "crashed", "reason": "signal 11"},
    ]
    results = {"knots": {"sets": {}, "samples": 0, "failures": [], "cpu_seconds": 0.0}, "jobs": jobs}
    table = {sheet.key: sheet for sheet in soak.sheets(results)}
    assert table["soak-jobs"].headings == ("arm", "jobs", "crashed", "planned", "false certificate")
    assert table["soak-jobs"].rows[-1] == ("all", "3", "1", "2", "1")
    assert ("crashed", "signal …", "1") in table["soak-jobs-failures"].rows


def test_the_page_follows_from_the_results() -> None:
    results = json.loads(soak.REFERENCE.read_text(encoding="utf-8"))
    text = soak.PAGE.read_text(encoding="utf-8")
    assert page(soak.PAGE, soak.blocks(results)) == text
    assert sum(results["knots"]["sets"].values()) > 0
