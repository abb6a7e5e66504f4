"""Jobs of several strokes: one motion, one certificate, figures of all that follow from those of each."""

import copy
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise, permutations, product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from plan_folders import edit
from small_scenes import SHORT, strokes_scene

from cmbot import load_plan, load_scene, plan, save
from cmbot.common.errors import ArchiveError, PathNotFound, PlanningError, SceneError
from cmbot.planning import Plan, planner
from cmbot.planning.attempts.agenda import Solved, Trial
from cmbot.planning.attempts.stroke import PlannedStroke
from cmbot.planning.stroke_order import in_least_travel, least_travel
from cmbot.robot import Kinematics
from cmbot.scene import Scene

NAMES = ("approach", "there", "free_1", "back", "return")


@pytest.fixture(scope="module")
def folder(strokes_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save(strokes_plan, tmp_path_factory.mktemp("strokes") / "plan")


def test_a_job_of_strokes_is_one_certified_motion(strokes_plan: Plan) -> None:
    job = strokes_plan.job
    assert tuple(segment.name for segment in job.segments) == NAMES
    assert all(segment.certificate.holds for segment in job.segments)
    for before, after in pairwise(job.segments):
        assert after.begin == pytest.approx(before.end, abs=1e-12)
        np.testing.assert_allclose(after.trajectory.q[0], before.trajectory.q[-1], rtol=0, atol=1e-9)
    for segment in job.segments:
        rates = [segment.trajectory.evaluate(segment.trajectory.t[[0, -1]], order) for order in (1, 2)]
        np.testing.assert_allclose(rates, 0, atol=1e-9)
    ends = [job.trajectory.evaluate(np.array([t])) for t in (0.0, job.duration)]
    np.testing.assert_allclose(ends, strokes_plan.scene.posture[None, None].repeat(2, 0), atol=1e-9)


def test_the_tool_follows_strokes(strokes_plan: Plan) -> None:
    kinematics = Kinematics(strokes_plan.robot)
    for stroke, segment in zip(strokes_plan.strokes, strokes_plan.job.strokes, strict=True):
        assert segment.name == stroke.name
        t = np.linspace(0, segment.duration, 200)
        p, _ = kinematics.tool_poses(segment.trajectory.evaluate(t))
        away = np.linalg.norm(p - stroke.task.path.position(t), axis=1)
        assert away.max() < 2 * strokes_plan.options.max_tool_deviation_m


def test_figures_of_all_follow_from_those_of_each(strokes_plan: Plan) -> None:
    made, each = strokes_plan, strokes_plan.strokes
    peaks = [segment.figures.peak_guardrail_torque for segment in made.job.strokes]
    assert made.figures.peak_guardrail_torque == max(peaks)
    bounds = [stroke.lower_bound for stroke in each if stroke.lower_bound is not None]
    assert made.lower_bound is not None and len(bounds) == 2
    assert made.lower_bound.value == max(bound.value for bound in bounds)
    assert made.lower_bound.each[made.lower_bound.via_point] == made.lower_bound.value
    assert made.objective.planned_peak == max(stroke.objective.planned_peak for stroke in each)
    assert made.baseline.drift == max(stroke.baseline.drift for stroke in each)
    free, work, job = made.job.free_figures, made.figures, made.job.figures
    assert free is not None
    assert job.peak_guardrail_torque == max(free.peak_guardrail_torque, work.peak_guardrail_torque)
    seconds = [
        sum(each.duration for each in made.job.segments if each.kind == kind) for kind in ("stroke", "free")
    ]
    mean = np.average([work.mean_guardrail_torque, free.mean_guardrail_torque], weights=seconds)
    assert job.mean_guardrail_torque == pytest.approx(mean)
    assert job.duration == pytest.approx(made.job.duration)
    assert job.guardrail_torque_integral == pytest.approx(mean * made.job.duration)
    assert job.rms_guardrail_torque is not None
    assert job.mean_guardrail_torque < job.rms_guardrail_torque < job.peak_guardrail_torque


def test_the_work_reaches_from_the_first_stroke_to_the_last(strokes_plan: Plan) -> None:
    made, begin = strokes_plan, strokes_plan.job.strokes[0].begin
    assert [segment.name for segment in made.work.segments] == ["there", "free_1", "back"]
    assert made.samples.t[-1] == pytest.approx(made.work.duration)
    t = np.linspace(0, made.work.duration, 50)
    np.testing.assert_allclose(
        made.trajectory.evaluate(t), made.job.trajectory.evaluate(begin + t), rtol=0, atol=1e-9
    )


def test_the_baseline_takes_the_strokes_in_the_same_order(strokes_plan: Plan) -> None:
    segments = strokes_plan.baseline.segments
    assert [segment.name for segment in segments if segment.kind == "stroke"] == ["there", "back"]
    for before, after in pairwise(segments):
        np.testing.assert_allclose(after.samples.q[0], before.samples.q[-1], rtol=0, atol=1e-9)
        assert after.begin == pytest.approx(before.end)
    np.testing.assert_allclose(segments[0].samples.q[0], strokes_plan.scene.posture, atol=1e-9)
    # The rows of the strokes are all there.
    for stroke in strokes_plan.strokes:
        rows = {row.tobytes() for row in strokes_plan.baseline.samples.q}
        assert all(row.tobytes() in rows for row in stroke.baseline.samples.q)


def test_a_saved_job_of_strokes_is_read_and_certified_anew(folder: Path, strokes_plan: Plan) -> None:
    read = load_plan(folder, verify=True)
    assert read.figures == strokes_plan.figures
    assert [stroke.name for stroke in read.strokes] == ["there", "back"]
    np.testing.assert_array_equal(read.baseline.samples.q, strokes_plan.baseline.samples.q)
    np.testing.assert_allclose(read.trajectory.q, strokes_plan.trajectory.q, rtol=0, atol=0)
    assert read.job.certificate.holds
    assert len(read.job.certificate.checks) > len(strokes_plan.job.certificate.checks)


def test_a_stroke_alone_keeps_its_name(tmp_path: Path) -> None:
    scene = strokes_scene()
    made = plan(scene.with_strokes(scene.strokes[:1]))
    read = load_plan(save(made, tmp_path / "plan"), verify=True)
    assert [stroke.name for stroke in made.strokes] == [stroke.name for stroke in read.strokes] == ["there"]
    assert read.summary() == made.summary()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data["strokes"].pop(), "strokes"),
        (lambda data: data["strokes"].reverse(), "strokes[0]"),
        (lambda data: data.update(strokes=[]), "strokes"),
        (lambda data: data["strokes"][0]["floor"].update(value=1.0), "strokes[0].floor.value"),
        (lambda data: data["strokes"][1]["start"].update(moved_deg=0.0), "strokes[1].start.moved_deg"),
        (
            lambda data: data["strokes"][1]["objective"].update(planned_peak=1.0),
            "strokes[1].objective.planned_peak",
        ),
        (lambda data: data["strokes"][1]["baseline"].update(drift=1.0), "baseline.drift"),
        (lambda data: data["strokes"][1]["baseline"].update(begin=1.0), "strokes[1].baseline.begin"),
        (lambda data: data["baseline"].update(drift=0.0), "baseline.drift"),
        (lambda data: data["choice"].update(free=1.0), "choice.free"),
        (lambda data: data["baseline"].update(mean_guardrail_torque=1.0), "baseline.mean_guardrail_torque"),
        (lambda data: data["planned"].update(mean_guardrail_torque=1.0), "planned.mean_guardrail_torque"),
        (lambda data: data["planned"]["free"].update(min_clearance=1.0), "planned.free.min_clearance"),
        (lambda data: data["planned"].update(free=None), "planned.free"),
        (lambda data: data["segments"][2].update(name="free_2"), "segments[2].name"),
        (lambda data: data["segments"][1].update(duration=1.0), "segments[1].duration"),
        (
            lambda data: data["segments"][1].update(guardrail_torque_integral=1.0),
            "segments[1].guardrail_torque_integral",
        ),
    ],
)
def test_what_contradicts_the_strokes_is_refused(
    folder: Path, tmp_path: Path, strokes_plan: Plan, change: Callable[[dict[str, Any]], object], key: str
) -> None:
    forged = save(strokes_plan, tmp_path / "plan")
    edit(forged, change)
    with pytest.raises(ArchiveError) as caught:
        load_plan(forged)
    assert caught.value.key == key


def test_the_table_has_the_free_moves_between_strokes(strokes_plan: Plan) -> None:
    rows, move = {row[0]: row[-1] for row in strokes_plan.rows()}, strokes_plan.job.segment("free_1")
    assert rows["time of free_1, s"] == f"{move.duration:.1f}"
    assert rows["peak torque on free_1, Nm"] == f"{move.figures.peak_guardrail_torque:.2f}"


def test_a_stroke_that_cannot_be_planned_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    # Slower legs would do, which takes a while to find out.
    monkeypatch.setattr(planner, "advice", lambda trial: "")
    monkeypatch.setattr(planner, "slower_legs", lambda *_: None)
    scene = strokes_scene(knots="fixed")
    there, back = scene.strokes
    # Faster than any joint.
    leg = replace(back.legs[0], seconds=0.5)
    hard = back.changed(legs=(leg,))
    told: list[str] = []
    with pytest.raises(PlanningError, match="stroke back"):
        plan(
            scene.with_strokes((there, hard)),
            progress=lambda progress: told.append(progress.sentence()),
        )
    assert any(sentence.startswith("there: ") for sentence in told)


def test_a_stroke_out_of_reach_is_refused_before_any_is_planned() -> None:
    scene = strokes_scene()
    there, back = scene.strokes
    far = back.changed(start_pose=replace(back.start_pose, xyz=(9.0, 0.0, 0.0)))
    told: list[str] = []
    with pytest.raises(
        PathNotFound, match=r"tool_path.strokes\[1\].from lies at \(9\.000, .*\) m, 9\.014 m from"
    ):
        plan(
            scene.with_strokes((there, far)),
            progress=lambda progress: told.append(progress.sentence()),
        )
    assert not any(sentence.startswith("there: ") for sentence in told)


def test_a_speed_that_is_too_fast_is_named_as_it_was_given() -> None:
    raster = {
        "origin": [1.8, 0.6, -1.9],
        "u": [0, 0.2, 0],
        "v": [0, 0, -0.2],
        "spacing_m": 0.1,
        "stand_off_m": 0.1,
    }
    fast = {"raster": raster, "speed_m_s": 0.5}
    scene = several(LEG, fast)
    scene = scene.changed(tool=replace(scene.tool, max_speed_m_s=0.15))
    with pytest.raises(SceneError) as caught:
        plan(scene)
    assert (caught.value.key, caught.value.got) == ("tool_path.strokes[1].speed_m_s", "0.5 m/s")


def several(*strokes: dict[str, Any], **more: Any) -> Scene:
    data = {
        **copy.deepcopy(SHORT),
        "format": "cmbot-scene/2",
        "tool_path": {"strokes": list(strokes), **more},
    }
    return load_scene(data)


LEG = {"legs": [{"by": [0, -0.1, 0], "seconds": 3}]}


@pytest.mark.parametrize(
    ("strokes", "more", "key", "got"),
    [
        ([LEG], {"keep": "axis"}, "keep", "a value"),
        ([LEG], {"legs": LEG["legs"]}, "legs", "a value"),
        ([{**LEG, "name": "return"}], {}, "strokes[0].name", "return"),
        ([{**LEG, "name": "free_1"}], {}, "strokes[0].name", "free_1"),
        ([{**LEG, "name": "a"}, {**LEG, "name": "a"}], {}, "strokes[1].name", "a"),
        ([LEG, LEG], {"order": "best"}, "strokes[0].from", "nothing"),
        ([LEG] * 13, {"order": "best"}, "order", "best for 13 strokes"),
        ([{"legs": [{"by": [0, 0.1, 0], "seconds": 20_000}]}] * 2, {}, "strokes", "40000 s"),
        ([{**LEG, "passes": 0}], {}, "strokes[0].passes", "0"),
        ([{**LEG, "passes": 50}], {}, "strokes[0].via_points", "50"),
    ],
)
def test_other_strokes_are_refused(strokes: list[Any], more: dict[str, Any], key: str, got: str) -> None:
    with pytest.raises(SceneError) as caught:
        several(*strokes, **more)
    assert (caught.value.key, str(caught.value.got)) == (f"tool_path.{key}", got)


@settings(max_examples=60)
@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_the_way_of_least_travel_is_the_shortest_of_all(strokes: int, seed: int) -> None:
    rng, n = np.random.default_rng(seed), 2 * strokes
    before, between, after = rng.random(n), rng.random((n, n)), rng.random(n)

    def length(way: list[int]) -> float:
        return float(before[way[0]] + sum(between[a, b] for a, b in pairwise(way)) + after[way[-1]])

    ways = (
        [2 * stroke + back for stroke, back in zip(order, backs, strict=True)]
        for order in permutations(range(strokes))
        for backs in product((0, 1), repeat=strokes)
    )
    found = least_travel(before, between, after)
    assert sorted(node // 2 for node in found) == list(range(strokes))
    assert length(found) == pytest.approx(min(map(length, ways)), rel=1e-12)


def test_strokes_in_least_travel_go_to_and_fro() -> None:
    rows = [
        {
            "name": f"row_{k}",
            "from": {"xyz": [1.8, 0.7, -1.9 - 0.1 * k]},
            "legs": [{"by": [0, -0.4, 0], "seconds": 4}],
        }
        for k in (2, 0, 1)
    ]
    ordered = in_least_travel(several(*rows, order="best"))
    names = [stroke.name for stroke in ordered.strokes]
    assert names in (["row_0", "row_1", "row_2"], ["row_2", "row_1", "row_0"])
    backwards = [stroke.backwards for stroke in ordered.strokes]
    assert backwards in ([False, True, False], [True, False, True])
    assert ordered.order is None


def test_the_order_with_the_lower_peak_is_taken(strokes_plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = strokes_scene()
    there, back = scene.strokes
    there = there.changed(start_pose=replace(back.start_pose, xyz=(1.8154, 0.7796, -2.0628)))
    scene = scene.with_strokes((back, there), order="best")
    figures, motion = strokes_plan.job.figures, SimpleNamespace(job=strokes_plan.job, peak=1.0)
    stroke = PlannedStroke(trial=Trial(attempt=None, outcome=Solved(result=motion)), runs=1)
    peaks = {True: 1.0, False: 0.9}
    planned = []

    def fake(of: Scene, made: list[PlannedStroke], **_: Any) -> Plan:
        assert made == 2 * [stroke]
        given = (
            tuple(stroke.name for stroke in of.strokes) == ("back", "there") and not of.strokes[0].backwards
        )
        planned.append(given)
        scaled = replace(figures, peak_guardrail_torque=peaks[given] * figures.peak_guardrail_torque)
        job = replace(strokes_plan.job)
        job.__dict__["figures"] = scaled
        return replace(strokes_plan, scene=of, job=job)

    monkeypatch.setattr(planner, "plan_stroke", lambda *_, **__: stroke)
    monkeypatch.setattr(planner, "composed", fake)
    chosen = plan(scene)
    assert sorted(planned) == [False, True]
    assert chosen.fallbacks[0].startswith("Order of the strokes: ")
    assert chosen.job.figures.peak_guardrail_torque == pytest.approx(0.9 * figures.peak_guardrail_torque)
    peaks[False] = 1.1
    assert [stroke.name for stroke in plan(scene).scene.strokes] == ["back", "there"]
