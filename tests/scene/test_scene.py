"""What Python puts into a scene, or hands to a verb, is checked as a file is: errors name the field."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import InputError
from cmbot.planning import Plan
from cmbot.scene import Box, Capsule, Cylinder, Mesh, Obstacle, Sphere

A_PLAN = "a Plan, as cmbot.plan and cmbot.load_plan return it"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("via_points", 30.5, "via_points: got 30.5, expected a whole number"),
        ("via_points", True, "via_points: got True, expected a whole number"),
        ("via_points", "30", "via_points: got '30', expected a whole number"),
        ("via_points", 4, "via_points: got 4, expected at least 5"),
        ("legs", None, "legs: got NoneType, expected a tuple, a Leg each"),
        ("legs", (), r"legs: got \[\], expected a list of 1 or more items"),
        ("legs", ((0, 0, 1),), r"legs\[0\]: got tuple, expected a Leg"),
        ("keep", "poes", "keep: got 'poes', expected a known value; did you mean pose?"),
        ("posture", [1.0, 2.0], r"posture: got list, expected an array \(n,\), rad"),
        ("posture", np.array([[1.0]]), r"posture\[0\]: got \[1.0\], expected a number"),
        ("posture", np.array([1.0, np.nan]), r"posture\[1\]: got nan, expected a finite number"),
        ("robot", "cmbot", "robot: got 'cmbot', expected a RobotSource"),
        ("speed_profile", 3, "speed_profile: got 3, expected a SpeedProfile"),
        ("obstacles", ("wall",), r"obstacles\[0\]: got 'wall', expected an Obstacle"),
        ("guardrail", None, "guardrail: got NoneType, expected a Guardrail"),
        ("planner", {"knots": "fixed"}, "planner: got dict, expected PlannerOptions"),
        ("name", 3, "name: got 3, expected text"),
    ],
)
def test_an_ill_typed_field_of_a_scene_is_named(field: str, value: object, message: str) -> None:
    with pytest.raises(InputError, match=f"^Scene: {message}"):
        replace(short_scene(), **{field: value})


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("knots", 3, "knots: got 3, expected a known value"),
        ("max_passes", 2.5, "max_passes: got 2.5, expected a whole number"),
        ("gap_target", "small", "gap_target: got 'small', expected a number"),
        ("axis_weights", None, "axis_weights: got None, expected a list"),
        ("safety_margin_m", np.nan, "safety_margin_m: got nan, expected a finite number"),
        ("avoidance_gain", object(), "avoidance_gain: got <object"),
    ],
)
def test_an_ill_typed_option_is_named(option: str, value: Any, message: str) -> None:
    scene = short_scene()
    options = replace(scene.planner, **{option: value})
    with pytest.raises(InputError, match=rf"^Scene: planner\.{message}"):
        replace(scene, planner=options)
    with pytest.raises(InputError, match=f"^PlannerOptions: {message}"):
        cmbot.plan(scene, options=options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda s: replace(s.legs[0], seconds="4"), "Leg: seconds: got '4', expected a number"),
        (lambda s: replace(s.legs[0], seconds=-4.0), "Leg: seconds: got -4.0, expected more than 0"),
        (lambda s: replace(s.legs[0], by=(0.0, 1.0)), r"Leg: by: got .*, expected a list of 3 items"),
        (lambda s: replace(s.legs[0], by=None), "Leg: by: got None, expected a list"),
        (lambda s: replace(s.robot, payload="5 kg"), "RobotSource: payload: got '5 kg', expected a number"),
        (
            lambda s: replace(s.robot, tool_length=-0.3),
            "RobotSource: tool_length: got -0.3, expected more than 0",
        ),
        (lambda s: replace(s.speed_profile, ramp="0.2"), "SpeedProfile: ramp: got '0.2', expected a number"),
        (lambda _: Box(size=3), "Box: size: got 3, expected a list"),  # type: ignore[arg-type]
        (lambda _: Sphere(radius=np.inf), "Sphere: radius: got inf, expected a finite number"),
        (lambda _: Cylinder(radius=0.1, length=0.0), "Cylinder: length: got 0.0, expected more than 0"),
        (lambda _: Capsule(radius=-0.1, length=1.0), "Capsule: radius: got -0.1, expected more than 0"),
        (lambda _: Mesh(path="a.stl"), "Mesh: path: got 'a.stl', expected a path"),  # type: ignore[arg-type]
        (lambda s: replace(s.obstacles[0], X_WO=np.eye(3)), "Obstacle: X_WO: got .*expected a pose"),
        (lambda s: replace(s.obstacles[0], X_WO=np.full((4, 4), np.nan)), "Obstacle: X_WO: got .*nan"),
        (lambda s: replace(s.obstacles[0], X_WO=None), "Obstacle: X_WO: got None, expected a pose"),
        (lambda s: replace(s.obstacles[0], shape="box"), "Obstacle: shape: got 'box', expected a Box"),
        (
            lambda s: replace(s.obstacles[0], workpiece=1),
            "Obstacle: workpiece: got 1, expected true or false",
        ),
    ],
)
def test_an_ill_typed_part_of_a_scene_is_named(make: Callable[[Any], object], message: str) -> None:
    with pytest.raises(InputError, match=f"^{message}"):
        make(short_scene())


def test_numbers_of_numpy_and_lists_are_taken() -> None:
    scene = short_scene()
    leg = replace(scene.legs[0], by=np.array([0.0, -0.3, 0.0]), seconds=np.float64(4))
    changed = replace(scene, via_points=np.int64(8), legs=[leg], obstacles=list(scene.obstacles))
    assert isinstance(changed.obstacles[0], Obstacle)
    assert cmbot.plan(changed).figures.peak_guardrail_torque > 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda p: cmbot.load_scene(3), "load_scene: source: got 3, expected the path of a scene file"),
        (lambda p: cmbot.load_robot(3), "load_robot: model: got 3, expected cmbot, or the path of a URDF"),
        (lambda p: cmbot.load_robot(base_frame=3), "got 3, expected a link of the URDF"),
        (lambda p: cmbot.load_robot(limits=3), "load_robot: limits: got 3, expected the path of a file"),
        (lambda p: cmbot.load_robot(srdf=3), "load_robot: srdf: got 3, expected the path of a file"),
        (lambda p: cmbot.load_robot(payload="5 kg"), "load_robot: payload: got 5 kg, expected a mass in kg"),
        (lambda p: cmbot.load_robot(tool_length="long"), "tool_length: got long, expected a positive length"),
        (lambda p: cmbot.load_plan(None), "cmbot.load_plan: directory: got NoneType, expected the path"),
        (lambda p: cmbot.plan(p.scene, options={"knots": "fixed"}), "PlannerOptions: got dict, expected an"),
        (lambda p: cmbot.plan(p.scene, objective=3), "cmbot.plan: objective: got int, expected something to"),
        (lambda p: cmbot.plan(p.scene, progress=3), "cmbot.plan: progress: got int, expected something to"),
        (lambda p: cmbot.save("out", p), f"cmbot.save: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.save(p, 3), "cmbot.save: directory: got 3, expected the path of a new folder"),
        (lambda p: cmbot.simulate("out"), f"cmbot.simulate: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.simulate(p, {"step_s": 1}), "SimulationOptions: got dict, expected an instance"),
        (lambda p: cmbot.replay("out", "a.html"), f"cmbot.replay: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.replay(p, 3), "cmbot.replay: html: got 3, expected the path of a file"),
        (lambda p: cmbot.replay(p, serve=True, port="all"), "replay: port: got all, expected a free port"),
        (
            lambda p: cmbot.report(p, "a.html", tracking=p),
            "tracking: got Plan, expected a Tracking, as cmbot",
        ),
        (lambda p: cmbot.report("out", "a.html"), f"cmbot.report: plan: got 'out', expected {A_PLAN}"),
        (lambda p: cmbot.report(p, None), "cmbot.report: html: got NoneType, expected the path of a file"),
        (
            lambda p: cmbot.save_tracking(p, "out"),
            "cmbot.save_tracking: tracking: got Plan, expected a Tracking",
        ),
        (
            lambda p: cmbot.load_tracking("out", "out"),
            f"cmbot.load_tracking: plan: got 'out', expected {A_PLAN}",
        ),
    ],
)
def test_what_a_verb_cannot_take_is_named(
    call: Callable[[Plan], object],
    message: str,
    short_plan: Plan,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=message):
        call(short_plan)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        (lambda: cmbot.load_scene("triangel"), "triangle"),
        (lambda: cmbot.load_scene("lines.yaml"), "line"),
        (lambda: cmbot.load_robot("cmbott"), "cmbot"),
        (lambda: short_scene(robot={"model": "cmbto"}), "cmbot"),
    ],
)
def test_a_slip_in_the_name_of_what_is_shipped_is_seen(call: Callable[[], object], meant: str) -> None:
    with pytest.raises(InputError, match=rf"; did you mean {meant}\?"):
        call()


def test_what_is_no_slip_is_not_guessed_at() -> None:
    with pytest.raises(InputError) as caught:
        cmbot.load_scene("polishing")
    assert "did you mean" not in str(caught.value)
