"""Plans of a robot whose foot is a magnet: figures, checks, the objective hold, directories."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles.contacts import contacts
from plan_folders import edit
from rosbags.highlevel import AnyReader
from small_scenes import panda_scene, request_of, short_scene

import cmbot
from cmbot.archive import export_mcap, load_plan, save
from cmbot.collision import Clearances
from cmbot.common.errors import ArchiveError, LimitViolation, OptimisationFailed, PlanningError, SceneError
from cmbot.common.limit import Limit
from cmbot.hold import MAGNET_PRESSURE, Holding
from cmbot.planning import Plan, certify, plan, planner, precheck_scene, remarks, robot_of, verdict
from cmbot.planning.attempts.failure import failure_of
from cmbot.planning.verification.hold import hold_checks
from cmbot.robot import Dynamics, Postures
from cmbot.views.report import headlines

# As much as a magnet can have on the default contact; with less friction no magnet holds this arm.
ADHESION, FRICTION = 14.9e3, 10.0


def magnet_scene(adhesion: float | None = ADHESION, **planner: Any) -> cmbot.Scene:
    hold = {"friction": FRICTION} | (
        {"kind": "magnet", "adhesion_n": adhesion} if adhesion else {"kind": "welded"}
    )
    changes = {"guardrail": {"hold": hold}, "planner": planner}
    return short_scene(**changes, tool={"process_force_n": [0, 0, -100]})


@pytest.fixture(scope="module")
def held() -> Plan:
    return plan(magnet_scene())


def test_the_peak_is_that_of_dense_samples(held: Plan) -> None:
    needed, certificate = held.figures.adhesion_needed, held.certificate
    t = np.linspace(held.trajectory.t[0], held.trajectory.t[-1], 20_001)
    wrench = Dynamics(held.robot).efforts(*held.trajectory.states(t)).guardrail_wrench
    each = held.robot.holding.each(wrench)[:, 0]
    assert needed.peak == pytest.approx(each.max(), rel=1e-5)
    assert each.max() <= certificate.adhesion_bound <= 1.001 * each.max()
    assert np.interp(needed.time, t, each) == pytest.approx(each.max(), rel=1e-5)


def test_the_check_is_of_all_times_and_has_the_safety(held: Plan) -> None:
    (check,) = (c for c in held.certificate.checks if c.quantity.startswith("adhesion needed"))
    assert check.bound == ADHESION / 2
    assert check.value == held.certificate.adhesion_bound


@pytest.mark.parametrize(("height", "number"), [(-0.02, 1), (0.5, 0)])
def test_an_obstacle_in_a_foot_is_named_before_planning(height: float, number: int) -> None:
    """A post on the rail, where foot 1 holds it, and one that stands half a metre above."""
    stance = {"foot_1": {"member": "top_rail", "along_m": 3.5, "turn_deg": 180}}
    free = short_scene(guardrail={"stance": stance})
    x, y, z = free.stance.foot
    post = {"name": "stub", "box": [0.02, 0.3, 0.02], "xyz": [x, y, z + height]}
    found = precheck_scene(short_scene(guardrail={"stance": stance}, obstacles=[post])).warnings
    about = [each for each in found if each.key == "guardrail.stance.foot_1"]
    assert [each.got.startswith("a foot that touches stub") for each in about] == [True] * number


def test_by_hand_at_rest(held: Plan) -> None:
    """About the face's centre: the whole robot's weight, and the tool's force at its point."""
    q = held.trajectory.q[:1]
    model, contact = held.robot.model, held.robot.feet[0].centre
    at = Postures(held.robot).at(q)
    push = at.tool_rotation[0] @ [0, 0, -100.0]
    masses = [*zip(at.centre[0], at.arm.mass, strict=True)]
    masses.append((model.inertias[0].lever, model.inertias[0].mass))
    force = push + sum(mass for _, mass in masses) * np.array([0, 0, -9.81])
    moment = np.cross(at.tool_point[0] - contact, push)
    moment += sum(np.cross(point - contact, [0, 0, -9.81 * mass]) for point, mass in masses)
    wrench = np.hstack([at.guardrail_force, at.guardrail_torque])
    load = held.robot.holding.load(0, wrench)[0]
    z, x, y = np.eye(3)[[2, 0, 1]]
    np.testing.assert_allclose(load, [force @ z, force @ x, force @ y, moment @ z, moment @ x, moment @ y])


def test_an_emergency_stop_asks_more(held: Plan) -> None:
    stop = held.emergency_stop
    assert stop.peak > held.job.figures.adhesion_needed.peak


def test_what_is_said(held: Plan) -> None:
    (text,) = re.findall(r"Hold: [^.]*(?:\.\d[^.]*)*\.", verdict(held))
    assert re.search(r"safety 2 included, uses \d+ % .* and have 14.90 kN, with 20 % less it holds; ", text)
    each = [segment.figures.adhesion_needed for segment in held.job.segments]
    closed = max(max(needed.gap, needed.peak) for needed in each)
    assert f"({closed / 1e3:.2f} kN with gap: none): magnets of " in text
    asked = 2 * held.job.figures.adhesion_needed.peak / 1e3
    assert f" of {asked:.1f} kN with safety 2, beyond the 1.9 kN of two poles on 8 mm, and have" in text
    (card,) = (card for card in headlines(held, None) if card.title == "Holds")
    assert f"(a gap may open; {closed / 1e3:.2f} kN without safety where none may)" in card.detail
    stop = held.emergency_stop
    assert text.endswith(f"an emergency stop needs {stop.peak / 1e3:.2f} kN.")
    # That of the baseline is the same, and left out.
    assert "feet use of what their safety allows" in held.summary()
    assert "adhesion needed, whole job" not in held.summary()
    assert "and the adhesion needed below" in " ".join(remarks(held))


def test_welded_says_that_it_says_nothing(short_plan: Plan) -> None:
    (text,) = re.findall(r"Hold: [^.]*(?:\.\d[^.]*)*\.", verdict(short_plan))
    assert text.startswith("Hold: welded is assumed, so nothing here says whether the feet hold; ")
    (needed, pressure) = (
        float(x) for x in re.findall(r"adhesion of ([0-9.]+) kN \(\w+\), ([0-9.]+) MPa", text)[0]
    )
    assert pressure == pytest.approx(1e-3 * needed / short_plan.robot.feet[0].contact.area, abs=0.006)
    assert ("beyond any magnet" in text) == (1e6 * pressure > MAGNET_PRESSURE)


def test_the_directory(held: Plan, tmp_path: Path) -> None:
    folder = save(held, tmp_path / "held")
    lines = (folder / "job.csv").read_text().splitlines()
    assert lines[0].endswith("clearance,adhesion_needed,segment")
    column = [float(line.split(",")[-2]) for line in lines[1:]]
    data = json.loads((folder / "plan.json").read_text())
    needed = held.figures.adhesion_needed
    assert data["planned"]["adhesion_needed"]["mode"] == needed.mode in ("slip", "tip")
    assert data["contact"][0]["area_cm2"] == pytest.approx(93.75)
    assert np.shape(data["contact"][0]["outline_m"]) == (1, 4, 2)
    assert data["planned"]["job"]["adhesion_needed"]["peak"] == pytest.approx(max(column), rel=1e-4)
    again = load_plan(folder, verify=True)
    names = [check.quantity for check in again.certificate.checks]
    assert "adhesion needed by a second computation" in names
    edit(folder, lambda data: data["planned"]["job"]["adhesion_needed"].update(peak=1.0))
    with pytest.raises(ArchiveError, match=r"planned\.job\.adhesion_needed\.peak"):
        load_plan(folder)


@pytest.mark.parametrize(
    "guardrail",
    [
        {},
        {"foot": {"offset_m": 0.4}},
        {"stance": {"foot_1": {"member": "post_4", "along_m": 1.10}}},
        {"stance": {"foot_1": {"member": "top_rail", "along_m": 3.5, "turn_deg": 180}}},
    ],
)
def test_contacts_are_those_of_the_file(guardrail: dict[str, Any]) -> None:
    hold = {"hold": {"kind": "magnet", "plate_m": [0.12, 0.1]}}
    scene = short_scene(guardrail=guardrail | hold)
    file, stance = scene.guardrail, scene.stance
    origin = np.zeros(3) if stance is None else np.array(stance.foot)
    found = [*contacts(file, file.hold)]
    assert len(found) == len(scene.feet) > 0
    for contact, foot in zip(found, scene.feet, strict=True):
        np.testing.assert_allclose(foot.centre, contact.centre - origin, rtol=0, atol=1e-12)
        np.testing.assert_allclose(foot.axes.T, contact.axes, rtol=0, atol=1e-12)
        assert foot.contact.size == pytest.approx(tuple(2 * half for half in contact.half))


def test_a_wrong_adhesion_is_noticed(held: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken() -> list[str]:
        t, wrench = np.zeros(1), np.array([[0.0, 0, -600, 300, 100, 0]])
        return [check.quantity for check in hold_checks(held.robot, t, wrench) if not check.holds]

    assert not broken()
    right = Holding.needed
    monkeypatch.setattr(Holding, "needed", lambda self, *given: 0.99 * right(self, *given))
    assert broken() == ["difference of the adhesion needed from a second computation"]


def test_too_little_is_refused_with_the_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    # Whether less of the tool's pose would do takes a while to find out.
    monkeypatch.setattr(planner, "advice", lambda trial: "")
    for knots in ("fixed", "sliding"):
        with pytest.raises(
            PlanningError, match=r"a foot uses [0-9]{3}% of its hold \(adhesion_n\); .*_n \d+ would do"
        ):
            plan(magnet_scene(5000.0, knots=knots))


def test_the_certificate_refuses_what_does_not_hold(held: Plan) -> None:
    weak = replace(held.robot, feet=(replace(held.robot.feet[0], adhesion=5000.0),))
    work = held.job.work.segments[0]
    clearances = Clearances(held.robot, held.scene.all_obstacles)
    certificate = certify(weak, work.task, work.trajectory, clearances, held.options, via_points=None)
    with pytest.raises(LimitViolation, match="adhesion needed, safety 2"):
        certificate.require()


def test_the_objective_hold_needs_less(held: Plan) -> None:
    made = plan(magnet_scene(None, knots="sliding", objective="hold"))
    assert (made.objective.name, made.objective.unit) == ("hold", "N")
    assert made.objective.planned_peak == pytest.approx(made.figures.adhesion_needed.peak, rel=1e-4)
    assert made.figures.adhesion_needed.peak <= held.figures.adhesion_needed.peak
    assert made.objective.planned_peak >= made.lower_bound.value * (1 - 1e-3)
    assert made.torque_floor is None


def test_the_objective_hold_needs_a_flat_contact() -> None:
    with pytest.raises(SceneError, match="a foot on flat steel"):
        plan(short_scene(guardrail={"bays": 0}, planner={"objective": "hold"}))


@pytest.fixture(scope="module")
def away() -> Plan:
    """At another post than that at the origin of the world."""
    return plan(away_scene({"foot_1": {"member": "post_4", "along_m": 1.10}}))


def away_scene(stance: Any, **hold: Any) -> cmbot.Scene:
    hold = {"kind": "magnet", "adhesion_n": ADHESION, "friction": FRICTION} | hold
    changes = {"guardrail": {"hold": hold, "stance": stance}}
    return short_scene(**changes, tool={"process_force_n": [0, 0, -100]})


def test_elsewhere_on_the_bridge_all_is_the_same(held: Plan, away: Plan, tmp_path: Path) -> None:
    one, other = held.figures, away.figures
    for name in ("peak_guardrail_torque", "mean_guardrail_torque", "peak_static_guardrail_torque"):
        assert getattr(other, name) == pytest.approx(getattr(one, name), rel=1e-6)
    assert other.adhesion_needed.peak == pytest.approx(one.adhesion_needed.peak, rel=1e-6)
    assert away.samples.tool_point[0, 0] == pytest.approx(held.samples.tool_point[0, 0] + 1.75)
    again = load_plan(save(away, tmp_path / "away"), verify=True)
    assert again.robot.foot_point == pytest.approx((1.75, 0, 0), abs=1e-12)


def test_what_others_read_has_the_wrench_where_the_foot_holds(away: Plan, tmp_path: Path) -> None:
    export_mcap(away, tmp_path / "away.mcap")
    with AnyReader([tmp_path / "away.mcap"]) as reader:
        found = {
            connection.topic: reader.deserialize(raw, connection.msgtype)
            for connection, _, raw in reader.messages()
        }
    (held,) = (each for each in found["/tf"].transforms if each.child_frame_id == "O0")
    assert held.header.frame_id == "world"
    place = held.transform.translation
    assert [place.x, place.y, place.z] == pytest.approx([1.75, 0, 0], abs=1e-12)
    assert found["/base_wrench"].header.frame_id == "O0"
    torque = found["/base_wrench"].wrench.torque
    np.testing.assert_allclose([torque.x, torque.y, torque.z], away.job_samples[0].guardrail_torque[-1])


def test_a_plan_on_two_feet(tmp_path: Path) -> None:
    # So near to each other that the base hangs nearly as on one.
    feet = {"foot_1": 3.5, "foot_2": 3.665}
    rail = {"member": "top_rail", "turn_deg": 180}
    stance = {foot: {**rail, "along_m": along} for foot, along in feet.items()}
    legs = [{"by": [0, -0.05, 0], "seconds": 2}]
    made = plan(replace_path(away_scene(stance, safety=1), legs))
    folder = save(made, tmp_path / "two")
    header = (folder / "job.csv").read_text().splitlines()[0]
    assert header.endswith("clearance,adhesion_needed_1,adhesion_needed_2,segment")
    quantities = [check.quantity for check in load_plan(folder, verify=True).certificate.checks]
    for foot in (1, 2):
        assert f"adhesion needed of foot {foot}, safety 1" in quantities
        assert f"adhesion needed of foot {foot} by a second computation" in quantities
    assert made.figures.adhesion_needed.foot in (1, 2)


def replace_path(scene: cmbot.Scene, legs: list[dict[str, Any]]) -> cmbot.Scene:
    data = scene.as_data()
    return cmbot.load_scene(data | {"tool_path": {"legs": legs, "via_points": 6}})


def test_a_scene_whose_feet_do_not_hold_at_the_start_is_told_so() -> None:
    weak = precheck_scene(magnet_scene(1000.0))
    assert re.fullmatch(
        r"[0-9]+ N of adhesion, times safety [0-9.]+, where a foot has 1000 N", weak.warnings[0].got
    )
    # What is advised was tried: with so much no place is left without a posture.
    blocked = next(each for each in weak.warnings if each.key == "tool_path.legs[0]")
    advised = re.search(r"guardrail.hold.adhesion_n (\d+) would do", blocked.expected)
    assert blocked.severity == "error" and advised is not None
    (strong,) = precheck_scene(magnet_scene(float(advised[1]))).warnings
    assert strong.key == "guardrail.hold.adhesion_n"
    assert strong.got == f"{advised[1]} N, where a magnet of two poles pulls 1910 N at most"
    # What magnets there are is told where none is chosen.
    assert "holds left for the start alone" not in dict(weak.found)
    left = dict(precheck_scene(magnet_scene(None)).found)["holds left for the start alone"]
    asked = 2 * float(weak.warnings[0].got.partition(" N of")[0]) / 1e3
    assert left.startswith("two-pole magnets pull 1.9 kN at most on 8 mm of steel, with safety ")
    assert f"the start posture alone asks {asked:.1f} kN (gap: allowed; gap: none asks " in left
    assert f"a magnet of more poles that pulls {asked:.1f} kN; cmbot plan says what the job " in left
    with pytest.raises(PlanningError, match=r"^guardrail\.hold\.adhesion_n: the start asks [0-9]+ N of"):
        plan(magnet_scene(1000.0))


def test_of_a_clamp_that_is_too_weak_foot_and_load_are_named() -> None:
    rail = {"member": "top_rail", "turn_deg": 180}
    two = away_scene({"foot_1": {**rail, "along_m": 3.5}, "foot_2": {**rail, "along_m": 3.665}})
    clamp = {"kind": "clamp", "force_n": [9e4] * 3, "moment_nm": [4e3, 4e3, 20.0], "safety": 1.5}
    guardrail = {"hold": clamp, "stance": two.guardrail.stance.model_dump()}
    weak = two.changed(guardrail=guardrail)
    robot = robot_of(weak)
    wrench = Dynamics(robot.tool_off).static_efforts(weak.posture[None]).guardrail_wrench
    twists = [abs(float(robot.holding.load(k, wrench)[0, 5])) for k in (0, 1)]
    value, foot = max(twists), 1 + int(np.argmax(twists))
    assert value > 20 / 1.5
    said = f"{value:.0f} Nm about the normal, times safety 1.5, where foot {foot} has 20 Nm"
    checked = precheck_scene(weak)
    assert checked.warnings[0].got == said
    assert checked.warnings[0].key == "guardrail.hold.moment_nm"
    assert checked.warnings[0].expected.endswith(" at rest, or another place, which cmbot stand seeks")
    share = f"{100 * 1.5 * value / 20:.0f} %: {said}"
    assert dict(checked.found)["of what the feet bear there, safety included"] == share
    with pytest.raises(PlanningError, match=f"the start asks {re.escape(said)}: "):
        plan(weak)


def test_a_clamp_that_bears_more_than_a_thin_bar_is_told() -> None:
    """A round bar of 20 mm: pi d^3 / 32 times 235 MPa in bending, on either side."""
    bar = {"name": "top_rail", "section": {"bar": 0.02}, "height_m": 0, "box_m": [0.04, 0.04]}
    clamp = {"kind": "clamp", "force_n": [4e3] * 3, "moment_nm": [500.0, 1200.0, 300.0]}
    rails = {
        "rails": [bar],
        "hold": clamp,
        "stance": {"foot_1": {"member": "top_rail", "along_m": 3.5, "turn_deg": 180}},
    }
    warnings = precheck_scene(short_scene(guardrail=rails)).warnings
    twisted, bent = (each for each in warnings if "so much is taken" in each.expected)
    blocked = next(each for each in warnings if each.key == "tool_path.legs[0]")
    assert "at best a foot uses " in blocked.got
    # The member yields before, so no larger bound is advised.
    assert (blocked.severity, blocked.expected) == (
        "error",
        "feet that bear it",
    )
    most = 2 * np.pi * 0.02**3 / 32 * 235e6
    yields = "at which the member yields, of S235; so much is taken"
    assert bent.got == "1200 Nm about the width"
    assert bent.expected == f"at most {most:.0f}, {yields}"
    # Torsion: twice that over the root of 3.
    most *= 2 / np.sqrt(3)
    assert twisted.got == "500 Nm about the length"
    assert twisted.expected == f"at most {most:.0f}, {yields}"


@pytest.mark.parametrize(("name", "use"), [("triangle", 0.69), ("line", 0.86)])
def test_a_clamp_holds_the_shipped_jobs(name: str, use: float, tmp_path: Path) -> None:
    """As docs/assumptions.md says: no magnet does, and a clamp of 4 kN and 1,200 Nm with a safety of 2."""
    clamp = {"kind": "clamp", "force_n": [4000.0] * 3, "moment_nm": [1200.0] * 3}
    scene = cmbot.load_scene(name)
    made = plan(scene.changed(guardrail={"hold": clamp}))
    checks = [check for _, check in made.job.checks() if check.quantity.startswith("load of the clamp")]
    worst = max(check.value for check in checks)
    assert worst == pytest.approx(use, abs=0.005)
    # Table, verdict, page and plan.json say that one figure, over all segments and with the safety.
    said = f"{100 * worst:.0f}"
    assert dict(row[::2] for row in made.rows())["feet use of what their safety allows, %"].strip() == said
    assert f"uses {said} % of what that allows" in verdict(made)
    (card,) = (card for card in headlines(made, None) if card.title == "Holds")
    assert card.value == f"{said} %"
    told = json.loads((save(made, tmp_path / name) / "plan.json").read_text())
    kept = [
        check["value"]
        for part in told["segments"]
        for check in part["certificate"]["checks"]
        if check["quantity"] == checks[0].quantity
    ]
    assert max(kept) == worst
    samples = made.job_samples[0]
    wrench = np.hstack([samples.guardrail_force, samples.guardrail_torque])
    # What its plate would need as a magnet is beyond what any on that contact pulls.
    needed = made.robot.holding.needed(0, wrench).max()
    assert needed > MAGNET_PRESSURE * made.robot.feet[0].contact.area > made.robot.feet[0].ceiling


def test_feet_that_need_no_adhesion_are_planned() -> None:
    """Then the objective is zero all along, and another start has nothing to gain."""
    hold = {"kind": "magnet", "adhesion_n": 3000, "plate_m": [0.8, 0.8]}
    made = plan(
        panda_scene(
            {"legs": [{"by": [0.1, 0, 0], "seconds": 2}], "via_points": 6},
            base={"name": "pedestal", "hold": hold},
            planner={"objective": "hold", "baseline": "none"},
        )
    )
    assert made.objective.planned_peak == 0.0
    assert made.certificate.holds


def test_bounds_that_are_advised_leave_room_for_the_motion() -> None:
    """With them the job is planned, and at rest in the start no foot uses all but its last eighth."""
    clamp = {"kind": "clamp", "force_n": [500.0] * 3, "moment_nm": [200.0] * 3}
    weak = short_scene(guardrail={"hold": clamp}, planner={"knots": "sliding"})
    with pytest.raises(PlanningError) as refused:
        plan(weak)
    advised = re.findall(r"(guardrail\.hold\.\w+) (\[[^]]*\])", str(refused.value))
    assert {key.rpartition(".")[2] for key, _ in advised} == {"force_n", "moment_nm"}
    firm = weak.with_values({key: json.loads(bounds) for key, bounds in advised})
    assert not precheck_scene(firm).warnings
    robot = robot_of(firm)
    wrench = Dynamics(robot.tool_off).static_efforts(firm.posture[None]).guardrail_wrench
    assert robot.holding.most_used(wrench).share <= 1 / 1.15
    assert plan(firm).certificate.holds


def test_a_hold_that_no_trajectory_keeps_is_named_with_its_foot_and_bound(held: Plan) -> None:
    error = OptimisationFailed(
        "none", constraint="adhesion needed", violation=0.1, trajectory=held.trajectory, limit=Limit.HOLD
    )
    said = failure_of(request_of(held.scene), error).error.constraint
    t = np.linspace(0.0, held.trajectory.duration, 2000)
    wrench = Dynamics(held.robot).efforts(*held.trajectory.states(t)).guardrail_wrench
    most = max(held.robot.holding.needed(0, wrench))
    told = re.fullmatch(
        rf"adhesion needed, adhesion_n: (\d+) N of adhesion, times .*, where a foot has {ADHESION:.0f} N",
        said,
    )
    assert told is not None and float(told[1]) == pytest.approx(most, rel=0.01)
