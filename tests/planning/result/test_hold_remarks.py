"""What is said of how the feet hold: the worst of all segments, and no adhesion of a clamp."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from clamped import CLAMP, MAGNET, clamped_plan, clamped_scene
from plan_folders import changed

from cmbot.archive import load_plan, save
from cmbot.common.limit import Limit
from cmbot.planning import Plan, bound_use, notes, plan, remarks, sentence, verdict
from cmbot.robot import Dynamics
from cmbot.views.report import headlines, pages

LOAD = "load of the clamp, safety 2"


@pytest.fixture(scope="module")
def clamped() -> Plan:
    return clamped_plan("clamp")


@pytest.fixture(scope="module")
def magnet_and_clamp() -> Plan:
    """Foot 1 is a magnet, foot 2 a clamp; they are so near to each other that the base hangs as on one."""
    rail = {"member": "top_rail", "turn_deg": 180}
    feet = {"foot_1": {**rail, "along_m": 3.5}, "foot_2": {**rail, "along_m": 3.665}}
    path = {"legs": [{"by": [0, -0.05, 0], "seconds": 2}], "via_points": 6}
    hold = [MAGNET | {"safety": 1}, {**CLAMP, "force_n": [80e3] * 3, "moment_nm": [30e3] * 3}]
    return plan(clamped_scene(guardrail={"hold": hold, "stance": feet}, tool_path=path))


def hold_remarks(of: Plan) -> list[str]:
    return [sentence(note) for note in notes(of) if note.key in ("holds", "unknown_hold")]


def used(of: Plan, foot: int = 0) -> dict[str, float]:
    """Share of a clamp's bounds that each segment uses, safety included, by dense samples of the wrench."""
    found = {}
    held = of.robot.feet[foot]
    bounds = np.array([*held.force, *held.moment])
    for segment in of.job.segments:
        robot = of.robot if segment.kind == "stroke" else of.robot.tool_off
        t = np.linspace(0, segment.duration, 4001)
        wrench = Dynamics(robot).efforts(*segment.trajectory.states(t)).guardrail_wrench
        load = np.abs(of.robot.holding.load(foot, wrench))
        found[segment.name] = held.safety * float((load / bounds).max())
    return found


def test_the_load_of_a_clamp_is_the_worst_of_all_strokes(clamped: Plan) -> None:
    each = used(clamped)
    assert max(each, key=each.__getitem__) == "far"  # and not the first one
    (said,) = hold_remarks(clamped)
    checks = [check for _, check in clamped.job.checks() if check.quantity == LOAD]
    assert len(checks) == len(clamped.job.segments)
    worst = max(checks, key=bound_use)
    assert worst.value == pytest.approx(each["far"], rel=1e-3)
    # What is said of it, what is certified, and the share of the bound in the table are one number.
    assert (worst.bound, worst.unit) == (1.0, "of its bounds")
    assert said.startswith(
        f"Hold: {LOAD} included, uses {100 * worst.value:.0f} % of what that allows, along far, "
        f"at {worst.time:.1f} s"
    )
    row, stop = (row for row in clamped.rows() if "clamp" in row[0])
    assert "in an emergency stop" in stop[0] and float(stop[-1]) > 0
    assert row[0] == f"{LOAD} included, whole job, share of its bounds"
    assert row[-1] == f"{worst.value:.3f}"


def test_a_locked_joint_that_is_nearer_to_its_bound_is_told(clamped: Plan) -> None:
    each, last = used(clamped), clamped.job.segments[-1]
    for share in (0.5, 1.5):
        use = share * max(each.values())
        plan = clamped
        for part in clamped.job.segments:
            checks = tuple(
                replace(check, value=use * check.bound * (1.0 if part is last else 0.9))
                if check.limit is Limit.HOLDING_TORQUE
                else check
                for check in part.certificate.checks
            )
            plan = changed(plan, part.name, certificate=replace(part.certificate, checks=checks))
        (said,) = hold_remarks(plan)
        told = re.search(r"; tighter is the torque that climb_\d holds, (\d+) % of \d+ Nm, ", said)
        assert (told is not None) == (share > 1)
        assert told is None or int(told[1]) == pytest.approx(100 * use, abs=1)


@pytest.mark.parametrize("name", ["clamped", "magnet_and_clamp"])
def test_all_places_tell_the_certificates_share(
    name: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Certificate, sentence, table (what ``--json`` prints), page and file have one number."""
    of: Plan = request.getfixturevalue(name)
    checks = [check for _, check in of.job.checks() if check.limit is Limit.HOLD]
    use = max(check.value / check.bound for check in checks)
    (note,) = (note for note in notes(of) if note.key == "holds")
    (row,) = (row for row in of.table if row.label.startswith("feet use"))
    (card,) = (card for card in headlines(of, None) if card.title == "Holds")
    assert note.values["use"] == pytest.approx(use, rel=1e-12)
    assert row.planned == pytest.approx(100 * use, rel=1e-12)
    assert card.value == f"{100 * use:.0f} %"
    assert f">{100 * use:.0f} %<" in pages(of)["report.html"].decode()
    written = json.loads((save(of, tmp_path / "plan") / "plan.json").read_text())
    shares = [
        check["value"] / check["bound"]
        for segment in written["segments"]
        for check in segment["certificate"]["checks"]
        if check["limit"] == "hold"
    ]
    assert max(shares) == pytest.approx(use, rel=1e-9)


def test_what_a_file_has_of_a_clamp_is_verified(clamped: Plan, tmp_path: Path) -> None:
    folder = save(clamped, tmp_path / "plan")
    again = load_plan(folder, verify=True)
    (second,) = {
        (check.bound, check.unit)
        for _, check in again.job.checks()
        if check.quantity == "load of the clamp by a second computation"
    }
    assert second == (pytest.approx(1.0), "of its bounds")
    assert hold_remarks(again) == hold_remarks(clamped)
    assert json.loads((folder / "plan.json").read_text())["planned"]["job"]["adhesion_needed"] is None
    # A name that others rely on.
    assert "clearance,adhesion_needed,segment" in (folder / "job.csv").read_text().splitlines()[0]


def test_a_clamp_needs_no_adhesion(clamped: Plan) -> None:
    cards = [f"{card.title} {card.value} {card.detail}" for card in headlines(clamped, None)]
    rows = [name for name, *_ in clamped.rows()]
    said = "\n".join([*remarks(clamped), verdict(clamped), clamped.summary(), *cards, *rows])
    assert "adhesion" not in said.lower()
    assert "adhesion" not in clamped.job.certificate.at_all_times()
    assert clamped.figures.adhesion_needed is None and clamped.baseline.figures.adhesion_needed is None


def test_a_clamp_without_figures_says_nothing_about_holding() -> None:
    (said,) = hold_remarks(clamped_plan("unknown"))
    assert said == "Hold: what the feet bear is not given, so nothing here says whether they hold."


def test_of_a_magnet_and_a_clamp_each_has_its_own(magnet_and_clamp: Plan) -> None:
    needed = magnet_and_clamp.job.figures.adhesion_needed
    assert needed.foot == 1
    (worst,) = hold_remarks(magnet_and_clamp)
    assert f"need an adhesion of {needed.peak / 1e3:.2f} kN" in worst
    rows = {row[0]: row[-1] for row in magnet_and_clamp.rows()}
    assert rows["adhesion needed, whole job, kN"] == f"{needed.peak / 1e3:.2f} {needed.mode}"
    share = float(rows["load of the clamp of foot 2, safety 2 included, whole job, share of its bounds"])
    assert share == pytest.approx(max(used(magnet_and_clamp, 1).values()), abs=1e-3)
    use = 0.01 * float(rows["feet use of what their safety allows, %"])
    assert use == pytest.approx(max(share, needed.peak / MAGNET["adhesion_n"]), abs=0.006)


@pytest.mark.parametrize("number", range(4))
def test_whichever_segment_is_worst_is_named(clamped: Plan, number: int) -> None:
    of, values = clamped, np.roll([0.937, 0.421, 0.013, 0.936], number).tolist()
    for segment, value in zip(clamped.job.segments, values, strict=True):
        checks = tuple(
            replace(check, value=value) if check.quantity == LOAD else check
            for check in segment.certificate.checks
        )
        of = changed(of, segment.name, certificate=replace(segment.certificate, checks=checks))
    (said,) = hold_remarks(of)
    worst = clamped.job.segments[int(np.argmax(values))]
    where = "on the return" if worst.name == "return" else f"along {worst.name}"
    assert f"uses {100 * max(values):.0f} % of what that allows, {where}, at " in said
    assert f"{max(values):.3f}" in [row[-1] for row in of.rows()]
