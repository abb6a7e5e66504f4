"""Proofs of the lower bound: below it nothing is found, by a closed form and by random restarts."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from admissible_postures import admissible, restarts, values
from finite_differences import check_derivative
from oracles.inverse_kinematics import postures as closed_form
from small_scenes import request_of, short_scene, with_corners
from urdf_arms import arm_scene, endless_scene, panda_scene, path_of, six_joint_scene

from cmbot.planning.request import StrokeRequest
from cmbot.planning.selfmotion.lower_bound import LowerBound, with_proof
from cmbot.planning.selfmotion.proof import TorqueFloorProof, _push_slopes
from cmbot.planning.selfmotion.reachability import out_of_reach
from cmbot.planning.selfmotion.sampler import Coverage
from cmbot.planning.selfmotion.spherical_joint import wrist_chain
from cmbot.robot import Postures, Robot
from cmbot.scene import Scene

ABOVE_ALL = 1e6
RESTARTS = 600
ACCURACY = 2e-5


def kinova_scene(folder: Path) -> Scene:
    return arm_scene(folder, "kinova")


def ur3_scene(folder: Path) -> Scene:
    path = path_of("pose", 5, ([0, 0, 0.05], 2.0))
    return six_joint_scene(folder, "ur3", [0, -70, 60, -80, -90, 0], path)


def prover(asked: StrokeRequest) -> TorqueFloorProof:
    found = TorqueFloorProof.of(asked)
    assert found is not None
    return found


def test_a_proof_finds_what_the_closed_form_finds() -> None:
    asked = request_of(short_scene())
    proof = prover(asked).prove(7, ABOVE_ALL)
    pitches = np.linspace(-np.pi, np.pi, 8001)
    q = closed_form(asked.goals[7].point[0], asked.task.path.orientation, pitches)
    q = q[asked.cell.robot.limits.contain(q)]
    q = q[values(asked, q) < 1.01 * proof.value]
    least = values(asked, q[admissible(asked, q)]).min()
    assert proof.lowest <= least
    assert proof.value == pytest.approx(least, rel=1e-4)
    assert proof.value - proof.lowest <= ACCURACY * proof.value
    assert admissible(asked, proof.posture[None])[0]
    assert values(asked, proof.posture[None])[0] == pytest.approx(proof.value)


@pytest.mark.parametrize("make", [panda_scene, kinova_scene, endless_scene])
def test_nothing_is_found_below_on_other_arms(
    make: Callable[[Path], Scene], tmp_path: Path, rng: np.random.Generator
) -> None:
    asked = request_of(make(tmp_path))
    found = values(asked, restarts(asked, 3, rng, RESTARTS))
    assert len(found) > 20
    proof = prover(asked).prove(3, float(found.min()))
    assert proof.lowest <= proof.value <= found.min()
    assert proof.value - proof.lowest <= ACCURACY * proof.value


def test_a_tool_on_the_last_axis_may_turn(rng: np.random.Generator) -> None:
    asked = request_of(short_scene(tool_path={"keep": "axis"}))
    found = values(asked, restarts(asked, 2, rng, RESTARTS))
    proof = prover(asked).prove(2, float(found.min()))
    assert proof.lowest <= proof.value <= found.min()
    assert proof.value - proof.lowest <= ACCURACY * proof.value


def pushed_scene(force: list[float], keep: str = "pose") -> Scene:
    tool = {"process_force_n": force}
    return short_scene(tool=tool, tool_path={"keep": keep})


@pytest.mark.parametrize(
    ("force", "keep"), [([90.0, -60.0, -150.0], "pose"), ([0.0, 0.0, -150.0], "axis")], ids=str
)
def test_nothing_is_found_below_under_a_force(
    force: list[float], keep: str, rng: np.random.Generator
) -> None:
    asked = request_of(pushed_scene(force, keep))
    found = values(asked, restarts(asked, 3, rng, RESTARTS))
    assert len(found) > 20
    proof = prover(asked).prove(3, float(found.min()))
    assert proof.lowest <= proof.value <= found.min()
    assert proof.value - proof.lowest <= ACCURACY * proof.value
    # The force matters: the weights alone leave another bound.
    unloaded = prover(asked.tool_off).prove(3, ABOVE_ALL)
    assert abs(unloaded.value - proof.value) > 0.05 * proof.value


def test_a_force_whose_direction_the_task_leaves_open_has_no_proof() -> None:
    assert TorqueFloorProof.of(request_of(pushed_scene([1.0, 0.0, -20.0], "axis"))) is None
    assert TorqueFloorProof.of(request_of(pushed_scene([1.0, 0.0, -20.0]))) is not None


def test_what_joints_bear_of_a_force_within_a_box(any_arm: Robot, rng: np.random.Generator) -> None:
    """To first order with the slopes, and in all by no more than the proof allows for the second order."""
    if any_arm.limits.prismatic.any():
        pytest.skip("no proof for joints that slide")
    force = (90.0, -60.0, -150.0)
    robot = replace(any_arm, tool_force=force)
    q, postures = rng.uniform(-2, 2, (40, robot.dof)), Postures(robot)
    at, half = postures.tool_at(q), 0.3
    slopes = _push_slopes(at)
    for k in range(3):
        check_derivative(
            lambda x: postures.tool_at(x[None]).torque_against_push[0], q[k], slopes[k], rtol=1e-7
        )
    moves = rng.uniform(-half, half, q.shape)
    moved = postures.tool_at(q + moves).torque_against_push
    off = np.abs(moved - at.torque_against_push - np.einsum("kij,kj->ki", slopes, moves)).max(axis=1)
    lever = np.full(robot.dof, 4 * np.linalg.norm(force) * robot.reach)
    assert (off <= TorqueFloorProof._second_order(np.abs(moves), lever)).all()


def test_where_nothing_holds_the_tool_all_is_proven() -> None:
    asked = request_of(short_scene())
    limits = asked.cell.robot.limits
    no_torque = replace(limits, torque=np.full(len(limits.torque), 1e-3))
    weak = replace(asked, cell=replace(asked.cell, robot=replace(asked.cell.robot, limits=no_torque)))
    proof = prover(weak).prove(0, np.inf)
    assert proof.lowest == np.inf
    assert proof.posture is None


def test_out_of_reach_is_said_where_it_is_proven(tmp_path: Path) -> None:
    asked = request_of(short_scene(tool_path={"legs": [{"by": [0.0, -0.3, 0], "seconds": 4}]}))
    assert all(out_of_reach(asked, k) == "" for k in (0, 7))
    path = asked.task.path

    def moved(by: list[float]) -> StrokeRequest:
        return replace(asked, task=replace(asked.task, path=with_corners(path, path.corners + by)))

    # The stretched arm reaches further than one that holds the tool's pose.
    far = moved([1.3, 0.0, 0.0])
    assert out_of_reach(far, 0) == (
        "out of reach: no posture within the joint ranges holds the tool's pose there (proven)"
    )
    assert len(restarts(far, 0, np.random.default_rng(1), RESTARTS)) == 0
    assert "the arm with its tool stretched out, 3.780 m, does not reach" in out_of_reach(moved([4, 0, 0]), 0)


def test_a_long_link_keeps_the_tool_away(tmp_path: Path) -> None:
    asked = request_of(ur3_scene(tmp_path))
    robot, start = asked.cell.robot, asked.task.path.corners[0]
    assert 0 <= robot.inner_reach < robot.reach
    model = robot.model.copy()
    model.jointPlacements[2].translation = np.array([0.0, 0.0, 3.0])
    long = replace(robot, model=model)
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (200, 6))
    points = Postures(long).tool_at(q).tool_point
    near = np.linalg.norm(points - long.base_point, axis=1).min()
    assert 0 < long.inner_reach <= near
    assert near <= long.inner_reach + 0.5
    assert f"nearer than {long.inner_reach:.3f} m" in out_of_reach(
        replace(asked, cell=replace(asked.cell, robot=long)), 0
    )
    assert np.linalg.norm(start - long.base_point) < long.inner_reach


def test_arms_that_do_not_decouple_and_other_objectives_have_no_proof(tmp_path: Path) -> None:
    assert wrist_chain(request_of(ur3_scene(tmp_path))) is None
    assert wrist_chain(request_of(short_scene(tool_path={"keep": "position"}))) is None
    sag = short_scene(planner={"objective": "sag"})
    assert TorqueFloorProof.of(request_of(sag)) is None


def test_the_chain_of_a_shoulder_runs_from_tool_to_base(tmp_path: Path) -> None:
    panda, cmbot = wrist_chain(request_of(panda_scene(tmp_path))), wrist_chain(request_of(short_scene()))
    assert panda.joints.tolist() == [6, 5, 4, 3, 2, 1, 0]
    assert cmbot.joints.tolist() == list(range(7))
    assert max(panda.slack, cmbot.slack) < 1e-4


def test_a_bound_is_proven_lowered_or_called_an_estimate(tmp_path: Path) -> None:
    asked = request_of(short_scene())
    coverage, posture = Coverage(1000, 500, 0), asked.state.posture
    least = prover(asked).prove(1, ABOVE_ALL).value

    def bound(value: float) -> LowerBound:
        each = np.full(8, 0.5 * value)
        each[1] = value
        return LowerBound(value=value, error=1e-6 * value, via_point=1, each=each)

    proven, same = with_proof(asked, bound(least), posture, coverage)
    assert (proven.kind, proven.missed, proven.value) == ("proven", None, least)
    assert 0 < proven.error <= ACCURACY * least
    assert same is posture
    lowered, better = with_proof(asked, bound(1.2 * least), posture, coverage)
    assert lowered.kind == "proven"
    assert lowered.value == lowered.each[1] == pytest.approx(least, rel=ACCURACY)
    assert values(asked, better[None])[0] == pytest.approx(lowered.value)
    other = request_of(ur3_scene(tmp_path))
    estimate, _ = with_proof(other, bound(5.0), other.state.posture, coverage)
    assert (estimate.kind, estimate.value) == ("estimated", 5.0)
    assert estimate.missed == coverage.share == pytest.approx(1 - 0.05 ** (1 / 500))
