"""A job of an arm with a linkage: planned, enclosed at all times, and computed again by other engines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import run

import cmbot
from cmbot.planning import Plan
from cmbot.planning.certification.norm_bounds import norm_bounds
from cmbot.planning.verification.second_opinion import second_opinion
from cmbot.scene import load_scene
from cmbot.simulation import SimulationOptions
from cmbot.trajectory import Pieces

ARM = Path(__file__).parents[1] / "robot" / "foreign" / "mimic_in_chain" / "arm.urdf"
# By hand, as in `tests/robot/test_mimic_joints.py`.
G = np.insert(np.eye(6), 2, [0, -1, 0, 0, 0, 0], axis=0)
OFFSET = np.array([0, 0, 0.1, 0, 0, 0, 0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of a first job and its plan, by the commands alone."""
    folder = tmp_path_factory.mktemp("linkage")
    scene, at = folder / "job.yaml", ("--tool-at", "0.8", "0", "0.5", "--rpy-deg", "180", "0", "0")
    assert run("new", "--from", ARM, *at, "-o", scene).status == 0
    assert run("plan", scene, "-o", folder / "plan").status == 0
    return folder


@pytest.fixture(scope="module")
def planned(folder: Path) -> Plan:
    return cmbot.load_plan(folder / "plan")


def test_the_full_chain_keeps_what_is_promised(planned: Plan) -> None:
    """Dense samples of all joints are within the limits of the URDF, torques within what is certified."""
    full = pin.buildModelFromUrdf(str(ARM))
    data, trajectory = full.createData(), planned.job.trajectory
    times = np.linspace(trajectory.t[0], trajectory.t[-1], 2000)
    q, v, a = trajectory.states(times)
    every = q @ G.T + OFFSET
    assert ((every >= full.lowerPositionLimit) & (every <= full.upperPositionLimit)).all()
    assert (np.abs(v @ G.T) <= full.upperVelocityLimit).all()
    tau = np.array([G.T @ pin.rnea(full, data, *each) for each in zip(every, v @ G.T, a @ G.T, strict=True)])
    (check,) = (each for each in planned.certificate.checks if each.quantity.startswith("torque of "))
    column = planned.robot.joints.index(check.joint)
    assert (np.abs(tau) <= planned.robot.limits.torque).all()
    assert np.abs(tau[:, column]).max() == pytest.approx(check.value, rel=1e-4)
    assert np.abs(tau[:, column]).max() <= check.value


def test_bounds_on_ellipses_hold_on_the_real_axis(planned: Plan) -> None:
    """Every ellipse has it inside; where a bound overflows it is infinite."""
    pieces = Pieces.between(planned.job.trajectory, np.zeros(0))
    bounds = norm_bounds(planned.robot, pieces.ellipses)
    efforts = cmbot.robot.Dynamics(planned.robot).efforts(*pieces.states)
    each = np.abs(efforts.joint_torque).reshape(len(pieces.start), -1, 6).max(axis=1)
    # What is no number counts as infinite.
    assert not (each[:, None] > bounds.joint_torque).any()


def test_it_is_computed_again(folder: Path, planned: Plan) -> None:
    pytest.importorskip("mujoco")
    assert run("verify", folder / "plan", "--scene", folder / "job.yaml").status == 0
    scene, trajectory = load_scene(folder / "job.yaml"), planned.job.trajectory
    opinion = {"trajectory": trajectory, "stroke": None}
    checks = second_opinion(scene, planned.options, robot=planned.robot, **opinion)
    assert any(each.quantity.startswith("difference of the joint torque") for each in checks)
    assert all(each.holds for each in checks)
    # With another multiplier nothing of it agrees.
    coupling = planned.robot.coupling
    other = replace(coupling, multiplier=np.where(coupling.multiplier < 0, -0.9, 1.0))
    checks = second_opinion(scene, planned.options, robot=replace(planned.robot, coupling=other), **opinion)
    broken = {each.quantity for each in checks if not each.holds}
    for what in ("joint torque", "guardrail torque", "tool's orientation", "tool point"):
        assert any(what in quantity for quantity in broken), (what, broken)


def test_it_swings_as_simulated(folder: Path) -> None:
    """On a base that gives way: what is simulated with all joints driven is what sag compensation expects."""
    text = (folder / "job.yaml").read_text("utf-8")
    scene = folder / "soft.yaml"
    base = "base: {name: mast, tube: {start_m: [0, 0, -1], outer_diameter_m: 0.2, wall_m: 0.008, "
    base += "young_pa: 7e10, shear_pa: 2.6e10, density_kg_m3: 2700}}"
    scene.write_text(f"{text}{base}\n", encoding="utf-8")
    planned = cmbot.plan(load_scene(scene))
    assert planned.sag is not None
    tracking = cmbot.simulate(planned, SimulationOptions(settle_s=2.0))
    motion = dict(tracking.motions)["planned"]
    sag = np.linalg.norm(planned.sag.following(planned.job.trajectory.q), axis=1)
    assert sag.max() > 1e-4
    assert np.linalg.norm(motion.error, axis=1).max() < 0.01 * sag.max()
