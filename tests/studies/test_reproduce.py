"""The comparison with the paper: its data, what is computed of ours, what is written."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import run
from plan_folders import names

import cmbot
from chang2021 import (
    Reproduction,
    as_json,
    cells,
    comparison,
    experiment,
    findings,
    goals,
    reasons,
    reproduce,
    save_reproduction,
    verdict_rows,
)
from chang2021.experiment import Experiment, Run, Variant, reduction
from chang2021.paper import PAPER, PaperExperiment, assumption_tables
from chang2021.report import markdown
from cmbot.archive import write_file
from cmbot.common.errors import ArchiveError, OptimisationFailed
from cmbot.common.installation import assumptions_file
from cmbot.planning import Plan
from cmbot.scene import load_scene
from cmbot.simulation import SimulationOptions, Tracking, simulate

TRIANGLE, LINE = PAPER


@pytest.fixture(scope="module")
def released(short_plan: Plan) -> Tracking:
    return simulate(short_plan, SimulationOptions(initial="undeformed"))


@pytest.fixture
def planner(
    short_plan: Plan,
    short_tracking: Tracking,
    released: Tracking,
    compensated_short: tuple[Plan, Tracking],
    monkeypatch: pytest.MonkeyPatch,
) -> list[str]:
    """A planner and a simulation of one short motion, compensated or not; returns the changed options."""
    asked: list[str] = []
    compensated, foreseen = compensated_short

    def known(scene: Any, *, options: Any, progress: Any = None) -> Plan:
        changed = [key for key, value in vars(options).items() if getattr(scene.planner, key) != value]
        asked.append(", ".join(f"{key}: {getattr(options, key)}" for key in changed))
        return compensated if options.compensate else short_plan

    def simulated(planned: Plan, options: SimulationOptions, *, progress: Any) -> Tracking:
        progress(0.5)
        if planned is compensated:
            # The tracking of the nominal stiffness for any: these tests do not depend on its effect.
            return replace(foreseen, options=options)
        assert planned is short_plan
        known = {found.options: found for found in (short_tracking, released)}
        return known.get(options, replace(short_tracking, options=options))

    monkeypatch.setattr(experiment, "plan", known)
    monkeypatch.setattr(experiment, "simulate", simulated)
    return asked


@pytest.mark.parametrize("paper", PAPER, ids=lambda paper: paper.scene)
def test_the_papers_comparison_leaves_the_sag(paper: PaperExperiment) -> None:
    """The paper's arm sags, and its errors are those of the sag; plans compensate it by default."""
    planner = load_scene(paper.scene_file).planner
    assert (planner.compensate, planner.baseline) == (False, "paper")


@pytest.mark.parametrize("paper", PAPER, ids=lambda paper: paper.scene)
def test_the_papers_rows_give_the_papers_percentages(paper: PaperExperiment) -> None:
    computed = reduction(paper.without.mean, paper.planned.mean)
    np.testing.assert_allclose(computed, paper.reductions, atol=0.15)


def test_reduction_is_of_magnitudes_and_not_the_other_way_round() -> None:
    computed = reduction(np.array([-4.0, 4.0, 2.0]), np.array([1.0, -1.0, 3.0]))
    np.testing.assert_allclose(computed, [75, 75, -50])
    computed = reduction(TRIANGLE.planned.mean, TRIANGLE.without.mean)
    assert np.abs(computed - TRIANGLE.reductions).min() > 100


def with_figures(tracking: Tracking, baseline: Any, planned: Any, vibration: float = 0.0) -> Tracking:
    """A tracking whose means and standard deviations are given; the dynamic share, too."""
    motions = {}
    for name, given in (("baseline", baseline), ("planned", planned)):
        motion = getattr(tracking, name)
        mean, deviation = (np.append(values, 1.0) for values in given)
        total = replace(
            motion.metrics.total, mean=mean, standard_deviation=deviation, rms=np.array([1.0, 1.0, 1.0, 2.0])
        )
        dynamic = replace(motion.metrics.dynamic, rms=np.full(4, 2.0 * np.sqrt(vibration)))
        motions[name] = replace(motion, metrics=replace(motion.metrics, total=total, dynamic=dynamic))
    return replace(tracking, **motions)


def as_the_paper(tracking: Tracking, paper: PaperExperiment, **changes: Any) -> Experiment:
    """An experiment in which everything is the paper's, but for what is changed."""
    figures = {
        "baseline": (paper.without.mean, paper.without.standard_deviation),
        "planned": (paper.planned.mean, paper.planned.standard_deviation),
    }
    vibration, difference = changes.pop("vibration", 0.0), changes.pop("difference", paper.torque_difference)
    ours = with_figures(tracking, **(figures | changes), vibration=vibration)
    start: Any = SimpleNamespace(moved=0.0)
    known: Any = SimpleNamespace(largest_torque_difference=(difference, 0.0), start=start)
    none = Variant(plan=None, trackings=(), why_not="no way")
    return Experiment(
        paper=paper,
        planned=Run(plan=known, equilibrium=ours, undeformed=ours),
        fixed=None,
        why_not="no way",
        compensated=none,
        quiet=none,
        least_sag=None,
    )


@pytest.mark.parametrize("paper", PAPER, ids=lambda paper: paper.scene)
def test_the_papers_own_figures_agree_with_it(short_tracking: Tracking, paper: PaperExperiment) -> None:
    found = list(findings(as_the_paper(short_tracking, paper)))
    assert len(found) == 9
    assert all(finding.agrees for finding in found), [finding.text for finding in found]


@pytest.mark.parametrize(
    ("motion", "changes", "expected"),
    [
        ("planned", {"mean": (-1.22, 12, -9.23)}, "The absolute mean falls along x, z here, along x, y, z"),
        (
            "planned",
            {"standard_deviation": (2.0, 3.99, 8.22)},
            "The standard deviation falls by 52.5, 75.4, 69.3 % here, by 69.6, 75.4, 69.3 % in the paper",
        ),
        (
            "baseline",
            {"mean": (2.44, 11.52, -24.48)},
            "The mean without optimisation has the paper's sign along y, z;",
        ),
        (
            "baseline",
            {"standard_deviation": (4.21, 10, 20)},
            "Without optimisation the standard deviation exceeds the absolute mean along x here, along x, y",
        ),
        (
            "baseline",
            {"mean": (-8, 11.52, -24.48), "standard_deviation": (9, 16.2, 26.78)},
            "Without optimisation the absolute mean is 3.28, 1.00, 1.00 times the paper's",
        ),
    ],
)
def test_what_differs_is_found(short_tracking: Tracking, motion: str, changes: Any, expected: str) -> None:
    own = TRIANGLE.planned if motion == "planned" else TRIANGLE.without
    given = replace(own, **{name: 1e-3 * np.array(values) for name, values in changes.items()})
    figures = {motion: (given.mean, given.standard_deviation)}
    found = findings(as_the_paper(short_tracking, TRIANGLE, **figures, difference=104.3))
    differing = [finding.text for finding in found if not finding.agrees]
    assert any(text.startswith(expected) for text in differing), differing
    words = "difference of the torque on the guardrail is 104.3 Nm here, 157.2 Nm in the paper"
    assert words in differing[-1]


def test_reasons_follow_the_figures(short_tracking: Tracking) -> None:
    def said(paper: Experiment) -> str:
        return " ".join(reasons(paper))

    sagging, shaking = (said(as_the_paper(short_tracking, LINE, vibration=share)) for share in (0.01, 0.8))
    assert "1.00 % (baseline) and 1.00 % (planned) is dynamic" in sagging
    assert "the means are those of the sag" in sagging
    assert "vibration is a large part of the error" in shaking
    assert "With fixed via-points (Eq. (30)) there is no plan here: no way." in sagging
    paper = as_the_paper(short_tracking, TRIANGLE)
    known: Any = SimpleNamespace(largest_torque_difference=(2.0, 0.0), start=SimpleNamespace(moved=0.0))
    stuck = replace(paper, fixed=replace(paper.planned, plan=known))
    assert "the gain comes from other postures, not from the splines" in said(stuck)
    known.start.moved = 0.5
    assert "from another start (28.6 deg away)" in said(stuck)
    assert "not from the splines" not in said(stuck)


def test_reasons_say_what_releasing_the_arm_does(short_tracking: Tracking) -> None:
    paper = as_the_paper(short_tracking, LINE)
    figures = ((row.mean, 0.1 * row.standard_deviation) for row in (LINE.without, LINE.planned))
    shaken, at_rest = paper.planned.equilibrium, with_figures(short_tracking, *figures)
    for equilibrium, undeformed, words in ((at_rest, shaken, "nearer to"), (shaken, at_rest, "further from")):
        run_ = replace(paper.planned, equilibrium=equilibrium, undeformed=undeformed)
        text = " ".join(reasons(replace(paper, planned=run_)))
        assert f"{words} the paper's as a whole" in text


def test_the_assumptions_are_those_of_the_page() -> None:
    tables, page = assumption_tables(), assumptions_file().read_text(encoding="utf-8")
    assert {"Frames and mounting", "The arm", "The bridge", "The method"} <= {t.heading for t in tables}
    rows = [row for table in tables for row in table.rows]
    assert len(rows) > 40
    for table in tables:
        assert table.columns[:3] == ("what", "value", "provenance")
        for row in table.rows:
            assert len(row) == len(table.columns), row
            assert not re.search(r"\]\(", " ".join(row))
    plain_page = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", page)
    for row in rows:
        assert f"| {' | '.join(row)}".rstrip() in plain_page


def test_both_experiments_are_planned_and_simulated(planner: list[str]) -> None:
    steps: list[tuple[str, str, float]] = []
    found = reproduce(on_step=lambda *words: steps.append(words), factors=(1.0, 0.7))
    assert planner == ["", "knots: fixed", "compensate: True", "", "objective: sag"] * 2
    triangle, line = (f"chang2021_{paper.scene}" for paper in PAPER)
    assert [scene for scene, *_ in steps] == [triangle] * 25 + [line] * 25
    nominal, released = "simulating, stiffness times 1", "simulating, stiffness times 1, released undeformed"
    # Plans and simulations of an experiment: 4 + 3 + 3 + 3 + 2.
    for number, scene, what, share in (
        (0, triangle, "sliding via-points", 0),
        (1, triangle, f"sliding via-points: {nominal}", 1),
        (2, triangle, f"sliding via-points: {nominal}", 1.5),
        (3, triangle, f"sliding via-points: {released}", 2),
        (4, triangle, f"sliding via-points: {released}", 2.5),
        (5, triangle, "sliding via-points: simulating, stiffness times 0.7", 3),
        (7, triangle, "fixed via-points", 4),
        (15, triangle, "sag compensation: simulating, stiffness times 0.7", 9),
        (-1, line, f"least sag: {nominal}", 29.5),
    ):
        assert steps[number] == (scene, what, pytest.approx(share / 30))
    shares = [share for *_, share in steps]
    assert shares == sorted(shares)
    for entry in found.experiments:
        for run_ in (entry.planned, entry.fixed):
            assert run_.equilibrium.options.initial == "equilibrium"
            assert run_.undeformed.options.initial == "undeformed"
        for softer, factor in zip(entry.compensated.trackings, (1.0, 0.7), strict=True):
            assert softer.options == SimulationOptions(guardrail_factor=factor, link_factor=factor)
        assert len(entry.quiet.trackings) == 2
        assert [each.options.link_factor for each in entry.planned.others] == [0.7]
    assert [entry.paper for entry in found.experiments] == list(PAPER)
    # Least sag can be left out.
    found = reproduce(on_step=lambda *words: steps.append(words), factors=(1.0,), least_sag=False)
    assert len(planner) == 10 + 8
    assert all(entry.least_sag is None for entry in found.experiments)
    assert steps[-1][-1] == pytest.approx((20 - 0.5) / 20)


@pytest.fixture
def found(planner: list[str]) -> Reproduction:
    return reproduce(factors=(1.0, 0.7))


@pytest.mark.usefixtures("planner")
def test_without_a_plan_for_fixed_knots_the_reason_is_told(
    short_plan: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = OptimisationFailed("too steep", constraint="jerk", violation=0.5)

    def known(scene: Any, *, options: Any, progress: Any = None) -> Plan:
        if options != scene.planner:
            raise error
        return short_plan

    monkeypatch.setattr(experiment, "plan", known)
    found = reproduce()
    assert all(entry.fixed is None for entry in found.experiments)
    text, why = markdown(found), f"{error}."
    assert text.count(f"there is no plan here: {why}") == 2
    # Compensated, and of least sag.
    assert text.count(f"- There is no plan: {why}") == 4
    data = as_json(found)["experiments"][0]
    assert data["fixed"] is None
    assert [goal["rows"] == () for goal in data["goals"]] == [False, True, False, True]


def test_the_page_shows_the_figures_in_tables(found: Reproduction) -> None:
    page = markdown(found)
    width = None
    for line in page.splitlines():
        columns = line.count("|") if line.startswith("|") else None
        assert None in (width, columns) or width == columns, line
        width = columns
    shown = [table.heading for table in assumption_tables()]
    assert all(f"### {heading}\n" in page for heading in shown)
    assert page.index("## Goals") < page.index("### ")
    assert page.count("### What agrees") == page.count("### What does not") == 2
    rows = [*verdict_rows(found)]
    for entry in found.experiments:
        _, *compared = comparison(entry)
        assert len(compared) == 30
        rows += compared
        mean = 1e3 * entry.planned.equilibrium.baseline.metrics.total.mean[:3]
        assert [float(x) for x in compared[6][2:]] == pytest.approx(mean, abs=6e-3)
        for sentence in (*(finding.text for finding in findings(entry)), *reasons(entry)):
            assert sentence in page
        for goal in goals(entry):
            assert f"#### {goal.title}\n" in page
            rows += cells(goal)
            assert all(f"- {remark}\n" in page for remark in goal.remarks)
    assert all(f"| {' | '.join(row)} |" in page for row in rows)


def test_it_is_written_with_both_plans_and_json_holds_the_same(found: Reproduction, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    page, figures = save_reproduction(found, folder)
    assert (page, figures) == (folder / "reproduce.md", folder / "reproduce.json")
    assert names(folder) == {"triangle", "line", "reproduce.md", "reproduce.json"}
    assert names(folder / "line") >= {"plan.json", "tracking.csv", "tracking_baseline.csv", "tracking.json"}
    cmbot.load_plan(folder / "line")
    assert page.read_text(encoding="utf-8") == markdown(found)
    with pytest.raises(ArchiveError):
        save_reproduction(found, folder)
    save_reproduction(found, folder, force=True)
    data = json.loads(json.dumps(as_json(found), allow_nan=False))
    assert data["format"] == "cmbot-reproduction/1"
    first = data["experiments"][0]
    assert first["paper"]["without"]["mean"] == pytest.approx([-2.44e-3, 11.52e-3, -24.48e-3])
    ours = found.experiments[0].planned
    for key, tracking in (("equilibrium", ours.equilibrium), ("undeformed", ours.undeformed)):
        assert first["sliding"][key]["with"]["mean"] == tracking.planned.metrics.total.mean[:3].tolist()
    assert first["sliding"]["torque_difference"] == ours.plan.largest_torque_difference[0]
    assert {"agrees", "text"} == set(first["findings"][0])
    tables = list(goals(found.experiments[0]))
    assert [goal["title"] for goal in first["goals"]] == [table.title for table in tables]
    assert first["goals"][1]["rows"][0]["values"] == list(tables[1].rows[0].values)
    assert len(data["assumptions"]) == len(assumption_tables())


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    write_file(tmp_path / "page.md", b"old")
    write_file(tmp_path / "page.md", b"new")
    assert (tmp_path / "page.md").read_bytes() == b"new"
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "file").touch()
    for path in (tmp_path / "page.md" / "page.md", tmp_path / "taken"):
        with pytest.raises(ArchiveError, match=r"a place below|refusal of the system"):
            write_file(path, b"text")
    assert names(tmp_path) == {"page.md", "taken"}


@pytest.mark.usefixtures("planner")
def test_the_command_answers_in_short_or_in_detail_and_replaces_a_reproduction(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    outcome = run("reproduce", "-o", folder, "--quick", "--details")
    assert outcome.status == 0, outcome.err
    lines = outcome.out.splitlines()
    assert lines[0] == "Goals"
    assert TRIANGLE.title in lines
    assert LINE.title in lines
    written_json = json.loads((folder / "reproduce.json").read_text(encoding="utf-8"))
    for entry in written_json["experiments"]:
        for finding in entry["findings"]:
            verdict = "agrees" if finding["agrees"] else "does not agree"
            assert f"{verdict}: {finding['text']}" in lines
        for reason in entry["reasons"]:
            assert f"why: {reason}" in lines
        assert len(entry["goals"]) == 3
        settings = [row["setting"] for row in entry["goals"][1]["rows"]]
        assert set(settings) == {f"stiffness times {factor}" for factor in (1, 0.7, 1.3)}
        for goal in entry["goals"]:
            assert f"{entry['scene']}: {goal['title'][0].lower()}{goal['title'][1:]}" in lines
            for remark in goal["remarks"]:
                assert f"goal: {remark}" in lines
    assert lines[-1].startswith(f"Written to {folder / 'reproduce.md'} and {folder / 'reproduce.json'}")
    (folder / "reproduce.md").write_text("old", encoding="utf-8")
    outcome = run("reproduce", "-o", folder, "--quick", "--force")
    assert outcome.status == 0, outcome.err
    assert (folder / "reproduce.md").read_text(encoding="utf-8").startswith("# The paper's experiments")
    lines = outcome.out.splitlines()
    written_json = json.loads((folder / "reproduce.json").read_text(encoding="utf-8"))
    verdicts = [
        (entry["scene"], verdict)
        for entry in written_json["experiments"]
        for goal in entry["goals"]
        for verdict in goal["verdicts"]
    ]
    assert len(verdicts) >= 6
    assert lines[0] == "Goals"
    assert re.split(r"  +", lines[1].strip()) == ["goal, against the baseline", "found", "met"]
    for line, (scene, verdict) in zip(lines[2:], verdicts, strict=False):
        met = "yes" if verdict["holds"] else "no"
        assert re.split(r"  +", line) == [scene, verdict["asked"], verdict["found"], met]
    paper, written, more = lines[2 + len(verdicts) :]
    assert paper.startswith("Of the paper's own results ")
    for entry in written_json["experiments"]:
        agreeing = sum(finding["agrees"] for finding in entry["findings"])
        assert f"{agreeing} of {len(entry['findings'])} are found again for the {entry['scene']}" in paper
    assert written.startswith("Written to ")
    assert more == f"All figures, and why: {folder / 'reproduce.md'}; --details prints them."


def test_the_command_refuses_what_is_in_the_way_before_it_plans(tmp_path: Path, planner: list[str]) -> None:
    (tmp_path / "reproduce.md").write_text("mine", encoding="utf-8")
    outcome = run("reproduce", "-o", tmp_path)
    assert (outcome.status, outcome.out, planner) == (2, "", [])
    assert outcome.err.startswith(f"error: {tmp_path / 'reproduce.md'}: got a file that is already there")
    (tmp_path / "triangle").mkdir()
    (tmp_path / "triangle" / "thesis.txt").touch()
    outcome = run("reproduce", "-o", tmp_path, "--force")
    assert (outcome.status, planner) == (2, [])
    assert "nothing else is replaced" in outcome.err
