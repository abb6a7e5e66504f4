"""`cmbot.excite`: what scenes say of trains, records, wind and base, and what comes of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial import ConvexHull
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import CmbotError, InputError, SceneError
from cmbot.elastic import elastic_base
from cmbot.excitation.ground import axles_of, read_record
from cmbot.excitation.response import modal_response
from cmbot.excitation.sway import Passage, resonance_speeds, timetable
from cmbot.excitation.trains import train_of
from cmbot.excitation.wind import gust_spectrum, link_loads
from cmbot.planning import Plan
from cmbot.robot import Kinematics
from cmbot.scene import Scene, load_scene
from cmbot.simulation import SimulationOptions, elastic_arm_of

SPAN = {"length_m": 24, "first_hz": 5.5, "mass_t_m": 3.5, "damping": 0.005, "at_m": 12}
TRAINS = {"axles": "emu", "speeds_km_h": [80, 160], "span": SPAN, "per_hour": 6}
RECORD = "t,ax,ay,az\n0,0,0,0\n0.5,0,0,1\n1.0,0,0,-1\n1.5,0,0,0\n"


def shaken(short_plan: Plan, **keys: Any) -> Plan:
    """The plan of the same motion in a scene with other keys."""
    scene = load_scene(short_plan.scene.as_data() | keys)
    return replace(short_plan, scene=scene)


@pytest.fixture(scope="module")
def trains(short_plan: Plan) -> cmbot.Excitation:
    tolerance = {"tolerance": {"across_mm": 5.0, "along_axis_mm": 10.0}}
    keys = {"excitation": {"deck": {"trains": TRAINS}, "passing": {"distance_m": 3.0}}, "tool": tolerance}
    return cmbot.excite(shaken(short_plan, **keys))


def test_a_train_moves_the_tool_and_the_base(trains: cmbot.Excitation) -> None:
    """At 160 km/h a multiple unit over the assumed span: ten to twenty millimetres, some 300 Nm."""
    slow, fast = trains.passages
    assert trains.kind == "trains"
    assert (slow.speed_km_h, fast.speed_km_h) == (80.0, 160.0)
    assert 3e-3 < fast.tool < 60e-3
    assert fast.torque > slow.torque > 10
    assert fast.passes_s == pytest.approx((24 + train_of("emu").length) * 3.6 / 160)
    assert not fast.kept
    assert fast.pause_s > 0
    assert fast.still_s > 1
    assert trains.simulated is not None
    assert trains.simulated.peak < 1.5 * fast.tool
    assert trains.rms_mm == pytest.approx(1e3 * trains.simulated.rms)
    assert trains.adhesion >= fast.adhesion


def test_it_is_read_as_it_was_written(trains: cmbot.Excitation, short_plan: Plan, tmp_path: Path) -> None:
    cmbot.save(short_plan, tmp_path / "plan")
    cmbot.save_excitation(trains, tmp_path / "plan")
    read = cmbot.load_excitation(tmp_path / "plan")
    assert read is not None
    assert read.passages == trains.passages
    assert (read.timetable, read.accuracy, read.simulated) == (
        *(trains.timetable, trains.accuracy),
        trains.simulated,
    )
    assert np.array_equal(read.reference.covariance, trains.reference.covariance)


def test_the_budget_counts_what_shakes(short_plan: Plan, trains: cmbot.Excitation) -> None:
    """By the train as simulated; by gusts and by wind; by nothing where nothing is said of them."""
    assert trains.accuracy is not None
    part = next(part for part in trains.accuracy.parts if part.name == "shaking of the base")
    assert part.sigma_mm == 0
    without = cmbot.excite(shaken(short_plan, excitation={"deck": {"trains": TRAINS}}))
    assert without.simulated.peak < 0.9 * trains.simulated.peak  # the pressure of trains is counted
    assert part.bias_mm <= 1e3 * trains.simulated.peak * (1 + 1e-9)
    assert trains.accuracy.within_mm > short_plan.accuracy.within_mm + 0.3 * part.bias_mm
    windy = cmbot.excite(shaken(short_plan, excitation={"wind": {"mean_m_s": 16}}))
    part = next(part for part in windy.accuracy.parts if part.name == "shaking of the base")
    assert 0 < part.bias_mm <= 1e3 * windy.wind * (1 + 1e-9)
    assert cmbot.excite(short_plan).accuracy is None


def test_the_hour_is_what_trains_leave(trains: cmbot.Excitation) -> None:
    times = trains.timetable
    assert times is not None
    assert times.pause_s == max(each.pause_s for each in trains.passages)
    assert times.work_s == pytest.approx(3600 - 6 * (times.pause_s + times.waits_s))


def a_passage(pause_s: float) -> Passage:
    return Passage(
        speed_km_h=80.0,
        passes_s=5.0,
        deck=1.0,
        tool=0.01,
        torque=10.0,
        adhesion=None,
        still_s=2.0,
        pause_s=pause_s,
        kept=False,
    )


def test_a_train_comes_in_a_stroke_as_often_as_it_is_long() -> None:
    """Against 200,000 arrivals: what is left of the stroke that is not begun."""
    strokes = np.array([[0.0, 2.0], [2.5, 12.5], [13.0, 16.0]])
    passage = a_passage(pause_s=7.0)
    arrivals = np.random.default_rng(0).uniform(0.0, 16.0, 200_000)
    inside = [(arrivals >= begin) & (arrivals < end) for begin, end in strokes]
    lost = sum(np.where(now, arrivals - begin, 0.0) for now, (begin, _) in zip(inside, strokes, strict=True))
    assert timetable(4.0, [passage], strokes).waits_s == pytest.approx(lost.mean(), rel=0.02)
    never = replace(passage, pause_s=0.0)
    assert timetable(4.0, [never], strokes).work_s == 3600.0


def test_under_a_timetable_no_stroke_meets_a_train() -> None:
    """Step by step: strokes of 40 s with moves of 10 s, trains at 2, 20 and 59.5 min, pauses of 45 s."""
    strokes, passage = np.array([[5.0, 45.0], [55.0, 95.0]]), a_passage(pause_s=45.0)
    times = timetable(4.0, [passage], strokes, [1200.0, 120.0, 3570.0])
    assert times.per_hour == 3.0
    (first, begins), (from_2, to_2), (from_20, to_20), (from_59, last) = times.rests_s
    # The train of 59.5 minutes of the hour before is past its pause at 15 s.
    assert (first, begins, last) == (0.0, 15.0, 3600.0)
    assert (to_2, to_20) == (165.0, 1245.0)
    # From 15 s on there is time for two strokes at most, of 40 and 50 s, in either order.
    assert from_2 in (15.0 + 90.0, 15.0 + 100.0)
    assert all(end - begin < 45.0 + 50.0 for begin, end in times.rests_s)
    assert 1200.0 - from_20 < 50.0
    assert 3570.0 - from_59 < 50.0
    assert times.work_s == pytest.approx(3600 - sum(end - begin for begin, end in times.rests_s))
    assert 3 * (times.pause_s + times.waits_s) == pytest.approx(3600 - times.work_s)
    # Close trains: from the first to the last pause there is one rest.
    ((begin, end),) = timetable(4.0, [passage], strokes, [600.0, 630.0]).rests_s
    assert end == 675.0
    assert 550.0 < begin <= 600.0
    assert timetable(4.0, [replace(passage, pause_s=0.0)], strokes, [600.0]).work_s == 3600.0


def test_resonances_are_at_parts_of_the_length_of_a_car() -> None:
    speeds = resonance_speeds(train_of("hslm_a1"), 5.5, 20.0, 60.0)
    assert speeds == pytest.approx([5.5 * 18 / n for n in (4, 3, 2)])


def test_a_record_is_simulated_from_its_begin(short_plan: Plan, tmp_path: Path) -> None:
    (tmp_path / "deck.csv").write_text(RECORD)
    deck = {"deck": {"record": str(tmp_path / "deck.csv")}}
    found = cmbot.excite(shaken(short_plan, excitation=deck))
    assert found.kind == "record"
    assert found.simulated is not None
    assert found.simulated.by == "simulation"
    assert found.simulated.peak > 1e-3
    assert found.sway is None
    assert found.adhesion > short_plan.figures.adhesion_needed.peak
    # By its modes, with a damper too light to matter, it sways alike.
    light = cmbot.excite(shaken(short_plan, excitation=deck, damper={"mass_kg": 1e-4}))
    assert light.simulated is not None
    assert light.simulated.by == "modes"
    assert light.simulated.rms == pytest.approx(found.simulated.rms, rel=0.02)
    assert light.simulated.peak == pytest.approx(found.simulated.peak, rel=0.02)
    record = read_record(tmp_path / "deck.csv")
    assert record.at(np.array([0.25, 9.0])) == pytest.approx(np.array([[0, 0, 0.5], [0, 0, 0]]))


def test_more_damping_and_a_damper_calm_it(short_plan: Plan) -> None:
    spectrum = {"spectrum": [[0.5, 0.03, 0.03, 0.03], [30, 0.03, 0.03, 0.03]]}
    one, eight = (
        cmbot.excite(shaken(short_plan, excitation={"deck": spectrum, "damping": damping}))
        for damping in (0.01, 0.08)
    )
    # Far from other modes the variance is as one over the damping.
    assert one.rms_mm / eight.rms_mm == pytest.approx(np.sqrt(8), rel=0.1)
    damped = cmbot.excite(shaken(short_plan, excitation={"deck": spectrum}, damper="auto"))
    assert damped.damper is not None
    assert damped.rms_mm < 0.6 * one.rms_mm
    # The best place of all, and less in every posture at each stiffness.
    gain = damped.damper
    assert gain.at == "tool"
    at_base = cmbot.excite(shaken(short_plan, excitation={"deck": spectrum}, damper={"at": "arm_base"}))
    assert gain.rms_with < at_base.damper.rms_with
    assert all(left < before for left, before in zip(gain.each_with, gain.each_without, strict=True))
    assert (max(gain.each_with), max(gain.each_without)) == (gain.rms_with, gain.rms_without)
    assert one.sway is not None
    assert one.sway.leaves is None


def test_gusts_sway_and_wind_leans(short_plan: Plan) -> None:
    """The mean displacement is as the square of the speed, and changes with the side it comes from."""
    still, twice, turned = (
        cmbot.excite(shaken(short_plan, excitation={"wind": wind}))
        for wind in (
            {"mean_m_s": 8, "gusts_m_s": 2},
            {"mean_m_s": 16},
            {"mean_m_s": 8, "gusts_m_s": 2, "from_deg": 0},
        )
    )
    assert twice.wind == pytest.approx(4 * still.wind)
    assert twice.rms_mm == 0
    assert still.kind == "still"
    assert still.rms_mm > 0.1
    assert turned.wind != pytest.approx(still.wind, rel=0.05)


def test_gusts_have_their_variance() -> None:
    f = np.geomspace(1e-6, 1e3, 20_000)
    assert np.trapezoid(gust_spectrum(f, 10.0, 3.0), f) == pytest.approx(9.0, rel=0.01)


def test_drag_is_pressure_times_area_by_hand(triangle_plan: Plan) -> None:
    """Areas as the outlines of the shapes' boxes, seen along the wind."""
    arm = elastic_arm_of(triangle_plan, SimulationOptions())
    q, direction = triangle_plan.trajectory.q[0], np.array([0.6, -0.8, 0.0])
    response = modal_response(arm, q, 0.01, [link_loads(direction)])
    force = response.static(np.array([0.0, 0.0, 0.0, 1.0]))[3:6]
    robot, kinematics = triangle_plan.robot, Kinematics(triangle_plan.robot)
    across = np.linalg.svd(direction[None])[2][1:]
    area = 0.0
    for shape in robot.collision_model.geometryObjects:
        if shape.parentJoint:
            pose = kinematics.joint_pose(q, shape.parentJoint) if hasattr(kinematics, "joint_pose") else None
            pose = _pose(robot, q, shape.parentJoint) if pose is None else pose
            shape.geometry.computeLocalAABB()
            box = shape.geometry.aabb_local
            corners = np.stack(np.meshgrid(*zip(box.min_, box.max_, strict=True)), axis=-1).reshape(-1, 3)
            seen = np.array([(pose * shape.placement).act(corner) for corner in corners]) @ across.T
            area += ConvexHull(seen).volume
    # The arm hangs in its springs: the boxes are turned by some millirad.
    assert force == pytest.approx(area * direction, rel=0.01, abs=1e-3)


def _pose(robot: Any, q: np.ndarray, joint: int) -> Any:
    import pinocchio as pin

    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return data.oMi[joint]


def modes() -> dict[str, Any]:
    shapes = np.diag([0.2, 0.15, 0.1, 0.3, 0.25, 0.2]) + 0.01 * np.arange(36).reshape(6, 6) / 36
    return {
        "frequencies_hz": [6.0, 7.5, 11.0, 18.0, 25.0, 40.0],
        "damping": [0.01, 0.02, 0.01, 0.03, 0.02, 0.01],
        "shapes": shapes.tolist(),
    }


def test_a_base_given_by_its_modes_has_them() -> None:
    """Frequencies, shapes and ratios from the eigenvalues of its matrices."""
    given = modes()
    scene = load_scene(short_scene().as_data() | {"base": {"name": "bridge", "modes": given}})
    base = elastic_base(scene.elastic_guardrail)
    assert base is not None
    squares, shapes = eigh(base.stiffness, base.mass)
    assert np.sqrt(squares) / (2 * np.pi) == pytest.approx(given["frequencies_hz"])
    assert np.abs(shapes.T) == pytest.approx(np.abs(np.array(given["shapes"])), abs=1e-9)
    modal = shapes.T @ base.damping @ shapes
    expected = 2 * np.array(given["damping"]) * np.sqrt(squares)
    assert modal == pytest.approx(np.diag(expected), abs=1e-8 * expected.max())


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    """Paths are absolute, the file's content is part of the hash, and saved scenes are the same."""
    (tmp_path / "deck.csv").write_text(RECORD)
    path = tmp_path / "scene.yaml"
    path.write_text(_yaml("excitation: {deck: {record: deck.csv}}\n"))
    scene = load_scene(path)
    assert scene.excitation is not None
    assert scene.excitation.deck.record == str(tmp_path / "deck.csv")
    assert load_scene(scene.as_data()).content_hash == scene.content_hash
    (tmp_path / "deck.csv").write_text(RECORD.replace("0.5", "0.6"))
    assert load_scene(path).content_hash != scene.content_hash
    assert short_scene().content_hash == load_scene(short_scene().as_data()).content_hash


def _yaml(more: str) -> str:
    import json

    return f"{json.dumps(short_scene().as_data())[:-1]}, {json.dumps(_parsed(more))[1:-1]}}}"


def _parsed(text: str) -> Any:
    import yaml

    return yaml.safe_load(text)


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"excitation": {}}, "deck or wind"),
    ({"excitation": {"wind": {"mean_m_s": 8}, "passing": {"distance_m": 3}}}, "excitation.passing"),
    ({"excitation": {"deck": {}}}, "record"),
    ({"excitation": {"deck": {"spectrum": [[5, 1, 1, 1], [2, 1, 1, 1]]}}}, "order of their frequencies"),
    ({"excitation": {"deck": {"record": "no.csv"}}}, "excitation.deck.record"),
    ({"excitation": {"deck": {"trains": TRAINS | {"axles": "ice"}}}}, "expected a train or a file"),
    ({"excitation": {"deck": {"trains": TRAINS | {"span": SPAN | {"at_m": 30}}}}}, "at_m"),
    ({"excitation": {"deck": {"trains": TRAINS}, "passing": {"distance_m": 2.0}}}, "distance_m"),
    ({"excitation": {"deck": {"trains": TRAINS | {"minutes": [3]}}}}, "per_hour or minutes"),
    ({"damper": {"mass_kg": 0}}, "damper.mass_kg"),
    ({"base": {"name": "b", "modes": modes() | {"shapes": [[1, 0, 0, 0, 0, 0]] * 6}}}, "independent"),
]


@pytest.mark.parametrize(("keys", "told"), REFUSED)
def test_wrong_keys_are_named(keys: dict[str, Any], told: str) -> None:
    with pytest.raises(SceneError, match=told.replace(".", r"\.")):
        load_scene(short_scene().as_data() | keys)


def test_modes_and_a_stiffness_are_one_too_many() -> None:
    data = short_scene().as_data()
    data |= {"base": {"name": "b", "modes": modes()}, "guardrail": {"bays": 0, "stiffness": [1e6] * 6}}
    with pytest.raises(SceneError, match=r"base\.modes"):
        load_scene(data)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("t,x,y,z\n0,0,0,0\n1,0,0,0\n", "t,ax,ay,az"),
        ("t,ax,ay,az\n0,0,0,0\n", "two rows or more"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,nan,0\n", "line 3, ay: got 'nan', expected a finite number"),
        ("t,ax,ay,az\n0,0,0,0\n1,0,0\n", "line 3: got 3 cells"),
        ("t,ax,ay,az\n0,0,0,0.1g\n1,0,0,0\n", "line 2, az"),
        ("t,ax (g),ay,az\n0,0,0,0\n1,0,0,0\n", "without units"),
        ("t,ax,ay,az\n0,0,0,9.8\n1,0,0,9.8\n", "mean of 9.8 m/s2 along z"),
        ("t,ax,ay,az\n0,0,0,0\n2,0,0,0\n1,0,0,0\n", "line 4"),
    ],
)
def test_records_that_are_none_are_refused(tmp_path: Path, content: str, told: str) -> None:
    path = tmp_path / "deck.csv"
    path.write_text(content)
    with pytest.raises(SceneError, match=told):
        read_record(path)


def test_axles_that_push_upwards_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "axles.csv"
    path.write_text("at_m,load_kn\n0,150\n3,-150\n")
    with pytest.raises(SceneError, match="line 3: got load_kn = -150"):
        axles_of(str(path))


def test_what_is_no_plan_is_refused(short_plan: Plan) -> None:
    with pytest.raises(InputError, match="a Plan"):
        cmbot.excite(short_plan.scene)  # type: ignore[arg-type]
    rigid: Scene = load_scene(short_scene().as_data() | {"guardrail": {"bays": 0}})
    stiff = replace(short_plan, scene=rigid, robot=replace(short_plan.robot, elasticity={}))
    try:
        found = cmbot.excite(stiff)
    except CmbotError as error:
        assert "nothing that bends" in str(error)
    else:
        assert found.rms_mm > 0
