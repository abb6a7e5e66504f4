"""What a plan may make small: the weighted moment, functions of wrench or posture, anyone's own."""

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import check_derivative, check_state_derivatives
from hypothesis import given, strategies as st
from plan_folders import edit, refused
from small_scenes import request_of, short_scene
from state_samples import StateSamples as RandomStates

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError, SceneError
from cmbot.optimization.program import StateSamples
from cmbot.planning import GlobalSearch, Plan, PostureObjective, WeightedMoment, remarks
from cmbot.planning.request import build_request
from cmbot.planning.torque.problem import ScaledObjective
from cmbot.planning.workcell.objectives import Objective, WrenchObjective, objective_of
from cmbot.robot import Dynamics, Postures, Robot
from cmbot.scene import PlannerOptions, Scene

N = 5


def steep(wrench: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The norm of (n_x, 2 n_y), written down by someone who knows nothing of weights."""
    x, y = wrench[:, 3], 2 * wrench[:, 4]
    value = np.hypot(x, y)
    gradient = np.zeros_like(wrench)
    gradient[:, 3], gradient[:, 4] = x / value, 2 * y / value
    return value, gradient


def bent_elbow(q: FloatArray) -> tuple[FloatArray, FloatArray]:
    gradient = np.zeros_like(q)
    gradient[:, 2] = np.sin(q[:, 2])
    return 1 - np.cos(q[:, 2]), gradient


@pytest.fixture
def states(cmbot_robot: Robot, random_states: RandomStates) -> StateSamples:
    return StateSamples(np.arange(float(N)), *random_states(cmbot_robot, N))


OBJECTIVES = {
    "foot": (PlannerOptions(),),
    "base": (PlannerOptions(moment_about="base"),),
    "weighted": (PlannerOptions(moment_about="base", axis_weights=(0.5, 2.0, 0.0)),),
    "own": (PlannerOptions(), steep),
    "hold": (PlannerOptions(objective="hold"),),
    "posture": "posture",
}


@pytest.fixture(params=OBJECTIVES.values(), ids=OBJECTIVES.keys())
def objective(request: pytest.FixtureRequest, cmbot_robot: Robot) -> Objective:
    if request.param == "posture":
        return PostureObjective(function=bent_elbow, name="elbow", unit="")
    return objective_of(replace(cmbot_robot, feet=short_scene().feet), *request.param)


def test_default_is_the_reported_torque(cmbot_robot: Robot, states: StateSamples) -> None:
    efforts = Dynamics(cmbot_robot).efforts(states.q, states.v, states.a)
    objective = objective_of(cmbot_robot, PlannerOptions())
    expected = np.linalg.norm(efforts.guardrail_torque, axis=1)
    np.testing.assert_array_equal(objective.values(states), expected)
    assert (objective.name, objective.unit) == ("torque", "Nm")


def test_moment_about_the_base(cmbot_robot: Robot, states: StateSamples) -> None:
    """At rest: the moments of the links' weights about O1, from pinocchio's centres of mass."""
    model = cmbot_robot.model
    data = model.createData()
    weights = np.array([1.0, 0.5, 2.0])
    function = WeightedMoment(np.array([0.0, 0.5, 0.0]), weights)
    at = Postures(cmbot_robot).at(states.q)
    got = function(np.hstack([at.guardrail_force, at.guardrail_torque]))[0]
    options = PlannerOptions(moment_about="base", axis_weights=(1.0, 0.5, 2.0))
    np.testing.assert_allclose(objective_of(cmbot_robot, options).at_rest(at), got, rtol=1e-14)
    for k, q in enumerate(states.q):
        pin.forwardKinematics(model, data, q)
        moment = sum(
            np.cross(
                data.oMi[i].act(model.inertias[i].lever) - [0, 0.5, 0], [0, 0, -9.81 * model.inertias[i].mass]
            )
            for i in range(1, 8)
        )
        assert got[k] == pytest.approx(np.linalg.norm(weights * moment), rel=1e-12)


@given(
    st.lists(st.floats(-2, 2), min_size=3, max_size=3),
    st.lists(st.floats(0, 3), min_size=3, max_size=3).filter(lambda w: max(w) > 0.1),
    st.lists(st.floats(-500, 500), min_size=6, max_size=6),
)
def test_weighted_moment(point: list[float], weights: list[float], wrench: list[float]) -> None:
    p, w, F = np.array(point), np.array(weights), np.array(wrench)
    function = WeightedMoment(p, w)
    value, gradient = function(F[None])
    assert value[0] == pytest.approx(np.linalg.norm(w * (F[3:] - np.cross(p, F[:3]))), rel=1e-9, abs=1e-9)
    if value[0] > 1.0:
        check_derivative(lambda x: function(x[None])[0][0], F, gradient[0], step=1e-2, rtol=1e-6)


def test_a_moment_of_nothing_is_flat() -> None:
    for flat in WeightedMoment(np.zeros(3), np.ones(3))(np.zeros((2, 6))):
        assert not flat.any()


@pytest.mark.parametrize("weights", [(0, 0, 0), (1, -1, 1), (1, np.nan, 1), (np.inf, 1, 1)])
def test_weights_that_are_none(weights: tuple[float, ...]) -> None:
    with pytest.raises(InputError, match="finite numbers, no weight negative, one positive"):
        WeightedMoment(np.zeros(3), np.array(weights, dtype=float))


def test_values_and_derivatives(objective: Objective, states: StateSamples) -> None:
    got = objective.linearize(states)
    np.testing.assert_allclose(got.value, objective.values(states), rtol=1e-11)
    parts = objective.residuals(states)
    np.testing.assert_allclose(sum(part.value**2 for part in parts), got.value**2, rtol=1e-11)
    for name in ("d_q", "d_v", "d_a"):
        gradient = sum(part.value[:, None] * getattr(part, name) for part in parts)
        expected = got.value[:, None] * getattr(got, name)
        np.testing.assert_allclose(gradient, expected, atol=1e-9 * np.abs(expected).max(initial=1.0))
    # The adhesion needed is the largest of several: of longer steps some lead to where another one is.
    step = 1e-4 if objective.name == "hold" else 1e-3
    check_state_derivatives(objective.values, states, got, step=step, rtol=1e-7, atol=1e-8)


def test_at_rest_nothing_moves(objective: Objective, states: StateSamples, cmbot_robot: Robot) -> None:
    still = np.zeros_like(states.q)
    moving = objective.values(StateSamples(states.t, states.q, still, still))
    np.testing.assert_allclose(objective.at_rest(Postures(cmbot_robot).at(states.q)), moving, rtol=1e-10)


def test_scaled_objective(objective: Objective, states: StateSamples) -> None:
    scaled = ScaledObjective(objective, 123.0)
    value, component = scaled.sample(states)
    np.testing.assert_allclose(123.0 * value[:, 0], objective.values(states), rtol=1e-14)
    assert component.shape == (N, 1)
    got, expected = scaled.linearize(states, component[:, 0]), objective.linearize(states)
    for name in ("value", "d_q", "d_v", "d_a"):
        np.testing.assert_allclose(123.0 * getattr(got, name), getattr(expected, name), rtol=1e-12)


@pytest.mark.parametrize(
    ("function", "got"),
    [
        (lambda wrench: wrench[:, 0], "a ndarray"),
        (lambda wrench: (wrench[:, 0], wrench[:, :3]), r"shapes \(1,\) and \(1, 3\)"),
        (
            lambda wrench: (wrench[:, 2], wrench),
            "value -369.*, expected finite numbers, the value zero or more",
        ),
        (lambda wrench: (wrench[:, 2] * np.nan, wrench), "value nan, .* zero or more"),
        (lambda wrench: (wrench[:, 2] ** 2, wrench), r"gradient\[\d\] = "),
    ],
)
def test_a_function_that_is_none(cmbot_robot: Robot, function: Any, got: str) -> None:
    with pytest.raises(InputError, match=got):
        objective_of(cmbot_robot, PlannerOptions(), function)


class TurnsBad:
    """A function of the wrench that answers as `then` does from its `calls`-th call on."""

    def __init__(self, calls: int, then: Any) -> None:
        self.left, self.then = calls, then

    def __call__(self, wrench: FloatArray) -> Any:
        self.left -= 1
        return (wrench[:, 2] ** 2, 2 * wrench * np.eye(6)[2]) if self.left > 0 else self.then(wrench)


def raises(_: object) -> None:
    raise ZeroDivisionError("by\nzero")


BAD_ANSWERS = {
    "a NoneType": lambda _: None,
    "ZeroDivisionError: by zero": raises,
    r"shapes \(2,\) and \(\d+, 6\)": lambda w: (np.ones(2), w),
    "value nan": lambda w: (w[:, 2] * np.nan, w),
    "value .*, gradient .*inf": lambda w: (w[:, 2] ** 2, np.full_like(w, np.inf)),
    "value -1, ": lambda w: (-np.ones(len(w)), w),
    "something else": lambda w: (["x"] * len(w), w),
}


@pytest.mark.parametrize("calls", [1, 5, 14, 15, 20])
@pytest.mark.parametrize("got", BAD_ANSWERS)
def test_a_function_that_turns_bad_at_any_call_is_named(calls: int, got: str) -> None:
    function = TurnsBad(calls, BAD_ANSWERS[got])
    with pytest.raises(InputError, match=rf"^objective TurnsBad: got {got}") as caught:
        cmbot.plan(short_scene(), objective=function)
    assert str(caught.value).isprintable()


def test_a_function_may_keep_and_change_what_it_is_given_and_gives(cmbot_robot: Robot) -> None:
    value, gradient = np.ones(3), np.zeros((3, 6))

    def careless(wrench: FloatArray) -> Any:
        wrench[:] = 0.0
        return value[: len(wrench)], gradient[: len(wrench)]

    function = objective_of(cmbot_robot, PlannerOptions(), careless)
    q = np.zeros((3, cmbot_robot.dof))
    first = function.at_rest(Postures(cmbot_robot).at(q))
    value[:] = 7.0
    np.testing.assert_array_equal(first, 1.0)


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("objective", "speed", r"planner\.objective: got 'speed', expected a known value \(one of: torque"),
        ("moment_about", "feet", r"planner\.moment_about: .*expected a known value \(one of: foot, base\)"),
        ("axis_weights", [1, 1], r"planner\.axis_weights: .*a list of 3 items"),
        ("axis_weights", [1, -1, 1], r"planner\.axis_weights\[1\]: got -1.*, expected at least 0"),
        ("axis_weights", [0, 0, 0], r"planner\.axis_weights: .*at least one number above 0"),
    ],
)
def test_options_are_checked(key: str, value: object, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        short_scene(planner={key: value})


def upward(**planner: Any) -> Scene:
    """A short leg upwards, on the outer side of the guardrail; soon planned, as near its floor is enough."""
    return short_scene(
        posture_deg=[-45, -90, 90, -10, 10, -55, 0],
        tool_path={"legs": [{"by": [0, 0, 0.3], "seconds": 5}]},
        planner={"knots": "sliding", "peak_tolerance": 1e-3, **planner},
    )


@pytest.fixture(scope="module")
def about_base() -> Plan:
    return cmbot.plan(upward(moment_about="base", axis_weights=[2, 1, 0]))


@pytest.fixture(scope="module")
def with_own() -> Plan:
    return cmbot.plan(upward(), objective=steep)


def test_a_plan_about_the_base(about_base: Plan) -> None:
    """What is made small is smaller than without; what is reported stays the torque about the foot."""
    default = cmbot.plan(upward())
    objective = objective_of(about_base.robot, about_base.options)

    def peak(plan: Plan) -> float:
        s = plan.samples
        return float(objective.values(StateSamples(s.t, s.q, s.v, s.a)).max())

    figures = about_base.objective
    assert figures.planned_peak == pytest.approx(peak(about_base), rel=1e-3)
    assert peak(about_base) < peak(default) - 0.1
    torque = np.linalg.norm(about_base.samples.guardrail_torque, axis=1).max()
    assert about_base.figures.peak_guardrail_torque == pytest.approx(torque, rel=1e-3)
    least = default.figures.peak_guardrail_torque / (1 + default.options.least_peak_tolerance)
    assert about_base.figures.peak_guardrail_torque > least
    assert figures.floor == about_base.lower_bound.value
    assert figures.gap == pytest.approx(figures.planned_peak / about_base.lower_bound.value - 1)
    assert about_base.gap_to_floor is about_base.torque_floor is None
    assert default.objective.planned_peak == default.figures.peak_guardrail_torque
    assert default.objective.baseline_peak == default.baseline.figures.peak_guardrail_torque
    assert default.objective.gap == default.gap_to_floor is not None
    text = " ".join(remarks(about_base))
    assert (
        f"the torque about the base, axes weighted 2, 1, 0, from a peak of {figures.baseline_peak:.2f} Nm"
        in text
    )
    assert "Minimised" not in " ".join(remarks(default))


def test_weights_are_one_of_anyones_own_functions(with_own: Plan) -> None:
    scene = upward(axis_weights=[1, 2, 0])
    weighted = GlobalSearch(request_of(scene))
    own = GlobalSearch(build_request(scene, scene.planner, steep))
    assert own.lower_bound.value == pytest.approx(weighted.lower_bound.value, rel=1e-9)
    np.testing.assert_allclose(own.solve(pinned=False).q, weighted.solve(pinned=False).q)
    figures = with_own.objective
    assert (figures.name, figures.own, figures.moment_about) == ("steep", True, None)
    assert figures.floor == pytest.approx(weighted.lower_bound.value, rel=1e-9)
    assert "Minimised: steep, from a peak of" in " ".join(remarks(with_own))


def test_round_trip(about_base: Plan, with_own: Plan, tmp_path: Path) -> None:
    for name, plan in (("base", about_base), ("own", with_own)):
        folder = cmbot.save(plan, tmp_path / name)
        # What is verified of someone's own comes below.
        read = cmbot.load_plan(folder, verify=name == "base")
        assert read.objective == plan.objective
        assert read.torque_floor is read.gap_to_floor is None
    # Of someone's own function nothing but the name is known, so its figures are taken as they are.
    edit(folder, lambda data: data["objective"].update(baseline_peak=1.0))
    assert cmbot.load_plan(folder, verify=True).objective.baseline_peak == 1.0
    changed = shutil.copytree(tmp_path / "base", tmp_path / "changed")
    edit(changed, lambda data: data["objective"].update(baseline_peak=1.0))
    with pytest.raises(
        ArchiveError, match=r"objective\.baseline_peak: got 1.0, expected .* as computed again"
    ):
        cmbot.load_plan(changed, verify=True)
    edit(changed, lambda data: data["objective"].update(axis_weights=[1.0, 1.0, 0.0]))
    refused(changed, "plan.json", "objective.axis_weights[0]")


def test_an_objective_that_rests_at_zero(short_plan: Plan) -> None:
    """Gravity has no moment about the vertical: the floor is 0, and no gap to it is made up."""
    weights = {"knots": "sliding", "axis_weights": [0, 0, 1]}
    stage = GlobalSearch(request_of(short_scene(planner=weights)))
    assert stage.lower_bound.value == stage.solve(pinned=True).peak == 0.0
    figures = replace(short_plan.objective, axis_weights=(0.0, 0.0, 1.0), floor=stage.lower_bound.value)
    assert figures.gap is None
    assert not figures.is_guardrail_torque


def test_an_objective_of_the_posture_has_a_floor() -> None:
    asked = request_of(short_scene(planner={"knots": "sliding"}))
    assert isinstance(objective_of(asked.cell.robot, asked.cell.options), WrenchObjective)
    objective = PostureObjective(function=bent_elbow, name="elbow", unit="")
    stage = GlobalSearch(replace(asked, cell=replace(asked.cell, objective=objective)))
    solution = stage.solve(pinned=False)
    np.testing.assert_allclose(solution.value, 1 - np.cos(solution.q[:, 2]), rtol=1e-12)
    assert stage.lower_bound.value <= solution.peak + 1e-12


def test_travel_is_planned_without_a_bound_of_the_base(tmp_path: Path) -> None:
    made = cmbot.plan(short_scene().with_options(objective="travel"), progress=False)
    assert made.certificate.holds
    assert made.lower_bound is made.choice is made.torque_floor is None
    assert "Minimised: the travel of the joints and their jerk, nothing of the base." in remarks(made)
    read = cmbot.load_plan(cmbot.save(made, tmp_path / "travel"), verify=True)
    assert read.objective == made.objective
