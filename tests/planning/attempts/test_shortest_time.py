"""``seconds: auto``: the shortest law along a path, against closed forms and copp, and a plan in its time."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plan_folders import edit
from scipy.interpolate import make_interp_spline
from shared_plans import planned
from small_scenes import request_of, short_scene

from cmbot import load_scene
from cmbot.archive import load_plan, save
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import LimitViolation, OptimisationFailed, PathNotFound, PlanningError, SceneError
from cmbot.common.limit import Limit
from cmbot.planning import Plan, plan, planner
from cmbot.planning.attempts import shortest_time
from cmbot.planning.attempts.agenda import Agenda, Solved, Trial
from cmbot.planning.attempts.attempt import Attempt
from cmbot.planning.attempts.failure import Failure, JointRate, NoTrajectory, Uncertified, failure_of
from cmbot.planning.attempts.shortest_time import FEWER_STRETCHED_LEGS, STRETCHED_LAWS
from cmbot.planning.attempts.stroke import PlannedStroke
from cmbot.planning.budget import SHORTEST_TIME_RUNS, Budget, Deadline
from cmbot.planning.initial_guess import initial_guess
from cmbot.planning.timing.law_search import (
    Bounded,
    LawSearch,
    shortest_laws,
)
from cmbot.planning.timing.leg_paths import bounds_along, leg_paths
from cmbot.planning.timing.timing import Timing, in_time
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.robot import Dynamics, Robot
from cmbot.toolpath import LegLaw

LEG = {"by": [0, -0.3, 0]}
QUIET_PROFILE = {"kind": "quiet", "ramp": 0.3}
# Of a Panda on a soft mast, the tool along a short leg in the shortest time.
SOFT_MAST = {
    "format": "cmbot-scene/2",
    "name": "mast",
    "robot": {"model": "panda", "base_frame": "panda_link0", "tool_frame": "panda_hand_tcp"},
    "start": {"posture_deg": [0, -45, 0, -135, 0, 90, 45]},
    "planner": {"knots": "fixed"},
    "guardrail": {"bays": 0, "stiffness": np.diag([8e4, 8e4, 4e5, 1.6e4, 1.6e4, 1.6e4]).tolist()},
}


def straight(size: float, *bounds: float) -> list[Bounded]:
    """A straight way of one joint, with bounds of its rates."""
    s = np.linspace(0, 1, 20)
    way = make_interp_spline(s, size * s[:, None], k=5)
    first, second, third = (way.derivative(k) for k in (1, 2, 3))
    terms = ((first,), (first, second), (first, second, third))
    return [Bounded(order=k + 1, terms=terms[k], bound=np.array([bound])) for k, bound in enumerate(bounds)]


def shortest_law(
    bounded: list[Bounded], phases: int, known: Sequence[np.ndarray] = ()
) -> tuple[np.ndarray, float]:
    """The shortest law of one way alone."""
    return shortest_laws([LawSearch(bounded=bounded, phases=phases, known=known)])[0]


def test_a_straight_way_takes_what_its_closed_form_says() -> None:
    # Bounded in its jerk alone, bang-bang in four parts; jerk that has to grow takes a little longer.
    jerk, seconds = shortest_law(straight(2.0, 1e3, 1e3, 4.0), 60)
    least = (32 * 2.0 / 4.0) ** (1 / 3)
    assert least < seconds < 1.02 * least
    assert jerk[0] == jerk[-1] == 0
    # Bounded in its velocity, it cruises.
    _, seconds = shortest_law(straight(10.0, 1.0, 1e3, 20.0), 80)
    least = 10.0 + 2 * np.sqrt(1.0 / 20.0)
    assert least < seconds < 1.03 * least


def test_a_law_keeps_what_bounds_it(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    n = cmbot_robot.dof
    q = make_interp_spline(np.linspace(0, 1, 6), np.cumsum(0.2 * rng.normal(size=(6, n)), axis=0), k=5)
    still = Dynamics(cmbot_robot).static_efforts(q(np.linspace(0, 1, 50)))
    most = 1.02 * float(np.linalg.norm(still.guardrail_torque, axis=1).max())
    limits = replace(cmbot_robot.limits, torque=1.3 * np.abs(still.joint_torque).max(axis=0) + 5)
    robot = replace(cmbot_robot, limits=limits)
    free = shortest_law(bounds_along(robot, q), 30)[1]
    jerk, seconds = shortest_law(bounds_along(robot, q, 0.3, most), 30)
    assert seconds > free
    u = np.linspace(0, 1, 2001)
    law = LegLaw(leg=0, seconds=(seconds / 30,) * 30, jerk=tuple(jerk / seconds**3)).law
    s = law.share(u)
    assert (np.diff(s) >= 0).all()
    # Derivatives by time, of the share and of the posture.
    rate = law.rate(u) / seconds
    speeding = np.gradient(rate, u * seconds, edge_order=2)
    v = q(s, 1) * rate[:, None]
    a = q(s, 2) * (rate**2)[:, None] + q(s, 1) * speeding[:, None]
    assert (np.abs(v) <= limits.velocity).all()
    assert (np.abs(a) <= limits.acceleration).all()
    efforts = Dynamics(robot).efforts(q(s), v, a)
    assert (np.abs(efforts.joint_torque) <= limits.torque).all()
    assert np.linalg.norm(efforts.guardrail_torque, axis=1).max() <= most
    # Without a way to rest within them there is no law.
    assert shortest_law(bounds_along(robot, q, 0.3, 0.9 * most), 30)[1] == np.inf


def test_a_law_that_is_known_is_never_made_longer(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    """From a law of the next path, too, of which the smooth one leads elsewhere."""
    points = np.cumsum(0.2 * rng.normal(size=(9, 7)), axis=0)
    ways = [make_interp_spline(np.linspace(0, 1, 9), points + shift, k=5) for shift in (0.0, 0.01)]
    known, before = shortest_law(bounds_along(cmbot_robot, ways[0]), 40)
    _, again = shortest_law(bounds_along(cmbot_robot, ways[0]), 40, [known])
    assert again <= before * (1 + 1e-9)
    smooth, warm = (shortest_law(bounds_along(cmbot_robot, ways[1]), 40, laws)[1] for laws in ([], [known]))
    assert warm <= 1.01 * min(smooth, before)


def test_laws_sought_together_are_those_sought_alone() -> None:
    bounds = ((2.0, 1e3, 1e3, 4.0), (10.0, 1.0, 1e3, 20.0), (1.0, 0.5, 2.0, 20.0))
    ways = [
        (straight(size, *most), phases) for (size, *most), phases in zip(bounds, (60, 12, 30), strict=True)
    ]
    # One that no law leads along is no matter of the others.
    no_way = Bounded(
        order=2,
        terms=ways[0][0][1].terms,
        bound=np.array([1.0]),
        offset=lambda s, order=0: np.full((len(s), 1), 2.0 * (order == 0)),
    )
    searches = [LawSearch(bounded=bounded, phases=phases) for bounded, phases in ways]
    *together, refused = shortest_laws([*searches, LawSearch(bounded=[no_way], phases=20)])
    assert refused[1] == np.inf
    assert [len(jerk) for jerk, _ in together] == [61, 13, 31]
    alone = [shortest_law(bounded, phases)[1] for bounded, phases in ways]
    np.testing.assert_allclose([seconds for _, seconds in together], alone, rtol=5e-3)


def test_it_is_near_copp_and_above_toppra(cmbot_robot: Robot, rng: np.random.Generator) -> None:
    pytest.importorskip("copp_py")
    pytest.importorskip("toppra")
    import time_laws

    q = make_interp_spline(np.linspace(0, 1, 6), np.cumsum(0.2 * rng.normal(size=(6, 7)), axis=0), k=5)
    seconds = shortest_law(bounds_along(cmbot_robot, q)[:3], 60)[1]
    copp = time_laws.copp_seconds(q, cmbot_robot.limits)
    assert 0.99 * copp < seconds < 1.05 * copp
    assert time_laws.toppra_seconds(q, cmbot_robot.limits) < copp


@pytest.mark.parametrize(("limit", "shares"), [(Limit.TOOL_DEVIATION, [10.0, 1.0]), (Limit.JERK, [10.0])])
def test_slow_motions_hold_the_tool_loosely_unless_it_strays_even_so(
    monkeypatch: pytest.MonkeyPatch, limit: Limit, shares: list[float]
) -> None:
    asked = list[float]()

    def fails(problem: Any, *rest: Any) -> Any:
        asked.append(problem.request.tool_share)
        raise OptimisationFailed("no", constraint="it", violation=1.0 / asked[-1], limit=limit)

    monkeypatch.setattr(shortest_time, "optimise", fails)
    path = {"legs": [LEG], "seconds": "auto"}
    failure = shortest_time._slow_motion(Attempt.of(request_of(short_scene(tool_path=path))))
    assert isinstance(failure, NoTrajectory) and asked == shares
    assert failure.error.violation == 1.0 / shares[-1]


def test_an_attempt_in_another_time_has_splines_in_that_time() -> None:
    path = {"legs": [LEG], "seconds": "auto", "via_points": 26}
    first = Attempt.of(request_of(short_scene(tool_path=path)))
    request, problem = first.request, first.guess.problem  # type: ignore[union-attr]
    law = LegLaw(leg=0, seconds=(2.0,) * 3, jerk=(0.0, 1.0, -1.0, 0.0))
    for number in (26, 31):
        denser = replace(request, times=request.task.path.via_times(number))
        timed = first.in_timing(Timing.along(denser, problem.parametrization.trajectory, (), (law,)))
        assert isinstance(timed, Attempt)
        assert timed.request.times[-1] == pytest.approx(6.0)
        np.testing.assert_array_equal(timed.guess.problem.space.t, timed.request.times)  # type: ignore[union-attr]


@pytest.fixture(scope="module")
def quick_plan() -> Plan:
    legs, shortest = [LEG, {"pause": 0.5}], {"kind": "shortest"}
    path = {"legs": legs, "seconds": "auto", "speed_profile": shortest, "max_base_torque_nm": 500}
    path["via_points"] = 26
    tool = {"max_speed_m_s": 1.0}
    return planned(short_scene(tool=tool, tool_path=path))


def test_a_plan_in_the_shortest_time(quick_plan: Plan) -> None:
    (law,) = quick_plan.scene.strokes[0].time_laws or ()
    assert law.leg == 0
    assert quick_plan.trajectory.duration == pytest.approx(law.duration + 0.5)
    assert quick_plan.certificate.holds
    assert quick_plan.runs <= SHORTEST_TIME_RUNS
    quantities = {check.quantity for check in quick_plan.certificate.checks}
    assert {"torque on the base", "tool speed"} <= quantities
    assert quick_plan.figures.limit_use.jerk > 0.9
    assert ("shortest time, the leg, s", f"{law.duration:.4g}") in [
        (row[0], row[-1]) for row in quick_plan.rows()
    ]


def in_auto(kind: str = "quiet", tool: dict[str, Any] | None = None, **changes: Any) -> Plan:
    changes |= {"speed_profile": {"kind": kind}}
    path = {"legs": [{"by": [0, 0.1, 0]}], "seconds": "auto", "via_points": 21, **changes}
    return planned(load_scene({**SOFT_MAST, "tool": tool or {}, "tool_path": path}))


def test_the_shortest_time_and_the_shortest_that_is_quiet_are_told() -> None:
    fast, quiet = in_auto("shortest"), in_auto()
    for made in (fast, quiet):
        (told,) = (each for each in made.fallbacks if each.startswith("As predicted, the shortest time"))
        shorter, longer = (float(number) for number in re.findall(r"([\d.]+) s (?:within|with)", told))
        assert shorter < longer
    assert fast.work.duration < quiet.work.duration
    assert fast.sway is not None and quiet.sway is not None
    assert quiet.sway.sway_mm + quiet.sway.swing_mm < 0.7 * (fast.sway.sway_mm + fast.sway.swing_mm)


def test_a_bound_of_the_sway_is_kept_in_a_longer_time(tmp_path: Path) -> None:
    quiet, quieter = in_auto(), in_auto(max_sway_mm=0.2)
    assert quieter.sway is not None
    assert max(quieter.sway.sway_mm, quieter.sway.swing_mm) <= 0.2
    assert quieter.work.duration > quiet.work.duration
    # The certificate judges it, by a little more than at the steps of the integration.
    checks = {check.quantity: check for check in quieter.certificate.checks if check.limit is Limit.SWAY}
    sway = checks["simulated sway of the tool"].value
    assert quieter.sway.sway_mm <= 1e3 * sway <= min(0.2, 1.05 * quieter.sway.sway_mm)
    assert checks["simulated swing of the tool after the stop"].bound == pytest.approx(2e-4)
    assert not any(check.limit is Limit.SWAY for check in quiet.certificate.checks)
    # So it is on reading, whatever the bound in the file.
    save(quieter, tmp_path)
    again = load_plan(tmp_path, verify=True).work.certificate.checks
    assert set(checks) <= {check.quantity for check in again}

    def stricter(data: dict[str, Any]) -> None:
        data["scene"]["tool_path"]["max_sway_mm"] = 0.9e3 * sway
        data["hashes"]["scene"] = load_scene(data["scene"]).content_hash

    edit(tmp_path, stricter)
    with pytest.raises(LimitViolation, match="of the tool"):
        load_plan(tmp_path, verify=True)
    with pytest.raises(LimitViolation, match="simulated sway of the tool") as refused:
        in_auto(max_sway_mm=1e-4)
    assert refused.value.limit is Limit.SWAY
    assert refused.value.value > refused.value.bound == pytest.approx(1e-7)


def test_a_force_that_sets_in_at_once_is_advised_to_set_in_slowly() -> None:
    """No time makes the tool sway less by it: what would do is planned before it is told."""
    tool, most = {"process_force_n": [0, 0, -80]}, 0.3
    with pytest.raises(LimitViolation, match="simulated sway of the tool") as refused:
        in_auto(max_sway_mm=most, tool=tool)
    (advised,) = re.findall(r"tool.process_ramp_s ([\d.]+) instead of 0 would do", str(refused.value))
    slow = in_auto(max_sway_mm=most, tool={**tool, "process_ramp_s": float(advised)})
    assert slow.certificate.holds
    assert slow.sway is not None and slow.sway.sway_mm <= most


def test_a_ur_is_near_copp_too() -> None:
    pytest.importorskip("copp_py")
    pytest.importorskip("toppra")
    import time_laws

    scene = dict(time_laws.scenes())["ur10, along"]
    times = time_laws.compared(plan(scene, progress=False))
    assert times.copp < times.planned < 1.05 * times.copp


def test_planned_times_are_near_copp(quick_plan: Plan) -> None:
    pytest.importorskip("copp_py")
    pytest.importorskip("toppra")
    import time_laws

    times = time_laws.compared(quick_plan)
    assert times.toppra < times.copp < times.planned < 1.05 * times.copp


def test_it_is_read_back_and_planned_again_in_that_time(quick_plan: Plan, tmp_path: Path) -> None:
    again = load_plan(save(quick_plan, tmp_path / "plan"), verify=True)
    assert again.scene.strokes[0].time_laws == quick_plan.scene.strokes[0].time_laws
    (stroke,) = again.scene.timed_strokes(np.eye(4))
    assert not stroke.path.open_legs
    less = quick_plan.scene.with_path(max_base_torque_nm=100.0)
    checks = second_opinion(less, quick_plan.options, quick_plan.trajectory, robot=quick_plan.robot, stroke=0)
    assert [check.quantity for check in checks if not check.holds] == [
        "torque on the base by a second computation"
    ]


@pytest.mark.parametrize(("takes", "starts"), [(0.5, 1), (2.0, 2)])
def test_a_shortest_time_is_told_whatever_time_planning_has_left(
    takes: float, starts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another start is tried where it takes longer than asked for."""
    tried = list[Any]()

    def found(refused: PlannedStroke, stroke: Any, shortest: PlannedStroke) -> PlannedStroke:
        shortest.trial.attempt.request.deadline.limit = 0.0
        tried.append(stroke)
        return replace(refused, shortest=takes)

    monkeypatch.setattr(planner, "in_given_time", found)
    path = {"legs": [LEG | {"seconds": 0.9}]}
    told = rf"(velocity|acceleration|jerk) of joint_\d at t = 0\.\d+ s, .*would do, and takes {takes:g} s$"
    with pytest.raises(PlanningError, match=told):
        plan(short_scene(tool_path=path, planner={"knots": "sliding", "start": "pinned"}))
    assert len(tried) == starts


def test_seconds_in_which_only_a_longer_ramp_leads_are_kept(quick_plan: Plan, tmp_path: Path) -> None:
    """A little more than the shortest time: ramps of 0.3 are too steep for the joints then."""
    (fastest,) = quick_plan.scene.strokes[0].time_laws or ()
    seconds = 1.05 * fastest.duration
    path = {"legs": [LEG | {"seconds": seconds}], "via_points": 26, "speed_profile": QUIET_PROFILE}
    made = plan(short_scene(tool_path=path))
    (file,) = made.scene.strokes
    assert made.certificate.holds
    assert made.work.duration == pytest.approx(seconds, rel=1e-9)
    assert file.legs[0].seconds == seconds and not file.is_open
    assert any("the law of the shortest time, slowed to the seconds" in told for told in made.fallbacks)
    read = load_plan(save(made, tmp_path / "plan"), verify=True, scene=short_scene(tool_path=path))
    assert read.scene.strokes[0].time_laws == file.time_laws


@pytest.mark.parametrize(
    ("needed", "factors", "legs"),
    [
        (1.03, [[1, 1], [1.01, 1.01], [1.03, 1.03], [1, 1.03]], " on 1 of 2 legs"),
        (1.01, [[1, 1], [1.01, 1.01]], ""),
    ],
)
def test_only_the_legs_on_which_motions_fail_are_stretched_if_that_is_worth_it(
    needed: float, factors: list[list[float]], legs: str
) -> None:
    """The second of two legs, which no motion follows in less than some times its law's seconds."""
    path = {"legs": [LEG, {"by": [0, 0, 0.1]}], "seconds": "auto", "via_points": 26}
    asked = request_of(short_scene(tool_path=path))
    trajectory = initial_guess(asked).problem.parametrization.trajectory
    laws = tuple(LegLaw(leg=k, seconds=(2.0, 2.0), jerk=(0.0, 1.0, 0.0)) for k in (0, 1))
    timing = Timing(
        request=asked,
        trajectory=trajectory,
        paths=leg_paths(asked, [0, 1], trajectory),
        laws=laws,
        factors=np.ones(2),
        at_fault=np.zeros(2, dtype=np.bool_),
    )
    timed = in_time(asked, laws)
    first = Attempt(request=timed, guess=initial_guess(timed), timing=timing)
    tried = list[FloatArray]()

    def work(attempt: Attempt) -> Solved[float] | Failure:
        seconds = attempt.request.task.path.seconds
        tried.append(seconds / 4.0)
        if seconds[1] < 4.0 * needed:
            middle = seconds[0] + 0.5 * seconds[1]
            error = LimitViolation("velocity of joint_1", time=middle, value=1.01, bound=1.0, unit="rad/s")
            return Uncertified(error=error, broken=JointRate(order=1, ratio=1.01))
        return Solved(result=float(seconds.sum()))

    best = Agenda(
        work=work,
        key=lambda attempt: attempt.key,
        remedies=(STRETCHED_LAWS, FEWER_STRETCHED_LEGS),
        budget=Budget(runs=SHORTEST_TIME_RUNS),
        deadline=Deadline(),
        better=lambda seconds, least: seconds < least,
    ).search(first)
    np.testing.assert_allclose(tried, factors)
    np.testing.assert_allclose(best.attempt.request.task.path.seconds, 4.0 * np.array(factors[-1]))
    (told,) = best.told
    assert "In 8 s, the shortest time along the joint path, no motion is certified (velocity of" in told
    assert told.endswith(f"planned {100 * (needed - 1):.0f} % slower{legs}.")
    # No free move is found by another time.
    blocked = PathNotFound("no approach", time=0.0, progress=0.0, smallest_singular_value=1.0)
    failure = failure_of(first.request, blocked)
    assert not list(STRETCHED_LAWS.propose(Trial(attempt=first, outcome=failure)))


def test_a_base_that_bears_too_little_at_rest() -> None:
    path = {"legs": [LEG], "seconds": "auto", "max_base_torque_nm": 100, "via_points": 12}
    with pytest.raises(LimitViolation, match=r"torque on the base at rest is .* the bound is 100 Nm"):
        plan(short_scene(tool_path=path))


def scene_of(**tool_path: Any) -> Any:
    return short_scene(tool_path=tool_path)


def test_auto_is_spread_over_legs_and_strokes() -> None:
    scene = scene_of(legs=[LEG, {"pause": 1.0}, {**LEG, "speed_m_s": 0.1}], seconds="auto")
    assert [leg.seconds for leg in scene.strokes[0].legs] == ["auto", None, None]
    assert load_scene(scene.as_data()).content_hash == scene.content_hash
    begin = {"xyz": [1.8, 0.7, -2.0]}
    strokes = [{"legs": [LEG]}, {"from": begin, "legs": [{**LEG, "seconds": 3}]}]
    data = scene.as_data() | {"tool_path": {"strokes": strokes, "seconds": "auto", "max_base_torque_nm": 400}}
    first, second = load_scene(data).strokes
    assert (first.legs[0].seconds, first.max_base_torque_nm) == ("auto", 400)
    assert (second.legs[0].seconds, second.max_base_torque_nm) == (3.0, None)


LAW = {"leg": 0, "seconds": [1.0, 1.0], "jerk": [0.0, 1.0, 0.0]}


@pytest.mark.parametrize(
    ("tool_path", "words"),
    [
        ({"legs": [{**LEG, "seconds": "soon"}]}, "legs\\[0\\].seconds: got 'soon', expected a number"),
        ({"legs": [LEG]}, "legs\\[0\\]: got none, expected exactly one of these keys"),
        ({"legs": [{**LEG, "seconds": 2}], "max_base_torque_nm": 400}, "no such key without seconds: auto"),
        ({"legs": [{**LEG, "seconds": 2}], "max_sway_mm": 1}, "no such key without seconds: auto"),
        (
            {"legs": [{**LEG, "seconds": 2}], "speed_profile": {"kind": "shortest"}},
            "another kind without seconds: auto",
        ),
        ({"legs": [LEG], "seconds": "auto", "lead_in_m": 0.1}, "no such key beside seconds: auto"),
        ({"legs": [LEG], "seconds": "auto", "time_laws": [{**LAW, "leg": 1}]}, "laws of legs \\[1\\]"),
        ({"legs": [LEG], "seconds": "auto", "time_laws": [{**LAW, "jerk": [0.0, 1.0]}]}, "jerk"),
        ({"legs": [LEG], "seconds": "auto", "time_laws": [{**LAW, "jerk": [0.0, -1.0, 0.0]}]}, "leads back"),
    ],
)
def test_refusals(tool_path: dict[str, Any], words: str) -> None:
    with pytest.raises(SceneError, match=words):
        scene_of(**tool_path).timed_strokes(np.eye(4))
