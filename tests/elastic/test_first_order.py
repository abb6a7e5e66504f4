"""The elastic arm to first order, in batches, against equilibria and modes one posture at a time."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import finite_difference

import cmbot
from cmbot.common.arrays import FloatArray
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.first_order import Bases, DeckSway, FirstOrder
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.excitation import sway_mm_per_m_s2
from cmbot.excitation.response import BAND_HZ, flat_band, modal_response
from cmbot.planning import bending_arm, held_guardrail, robot_of
from cmbot.robot import Postures, load_robot

PUSH = (3.0, -20.0, 8.0)


def without_added_mass(arm: ElasticArm) -> ElasticArm:
    return replace(arm, added_mass=np.zeros_like(arm.added_mass))


class Case:
    """An elastic arm on its guardrail, and the same to first order."""

    def __init__(self, joints: Any, *, push: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> None:
        scene = cmbot.load_scene("triangle").with_joints(joints)
        robot = replace(robot_of(scene), tool_force=push)
        model = robot.model.copy()
        model.inertias[0].inertia = np.zeros((3, 3))  # what does not move is a point mass here
        robot = replace(robot, model=model)
        arm, base = bending_arm(scene, robot), elastic_base(held_guardrail(scene, robot))
        assert arm is not None
        assert base is not None
        self.arm = without_added_mass(arm)
        X = robot.model.frames[robot.model.getFrameId("arm_base")].placement.homogeneous
        own = load_robot(mount=np.eye(4), tool_length=scene.robot.tool_length_m)
        own = replace(own, elasticity=robot.elasticity, joint_elasticity=robot.joint_elasticity)
        self.first = FirstOrder(elastic_arm(own, None))
        self.q = np.array(scene.posture) + np.random.default_rng(3).normal(0.0, 0.4, (20, 7))
        N, carrier = len(self.q), robot.model.inertias[0]
        self.R = R = X[:3, :3]
        T = np.kron(np.eye(2), R)
        self.stiffness = T.T @ base.stiffness @ T
        foot, centre = (R.T @ (np.array(point) - X[:3, 3]) for point in (robot.foot_point, carrier.lever))
        self.bases = Bases(
            foot=np.tile(foot, (N, 1)),
            stiffness=np.tile(self.stiffness, (N, 1, 1)),
            carrier_mass=np.full(N, carrier.mass),
            carrier_centre=np.tile(centre, (N, 1)),
        )
        self.gravity = np.tile(R.T @ np.array(robot.model.gravity.linear), (N, 1))

    def sag(self, push: FloatArray | None = None) -> FloatArray:
        return self.first.sag(self.q, self.bases, self.gravity, push) @ self.R.T


@pytest.mark.parametrize("fixed_tool", [None, pin.SE3(np.eye(3), np.array([1.2, 0.9, -1.5]))])
def test_sway_on_a_deck_is_that_of_the_modes_with_its_gradient(fixed_tool: Any) -> None:
    """Against the bent arm's own modes, and against central differences; also of a part at a fixed tool."""
    scene = cmbot.load_scene("line")
    robot = replace(robot_of(scene), fixed_tool=fixed_tool)
    arm = bending_arm(scene, robot)
    assert arm is not None
    sway = DeckSway(arm)
    q = np.array(scene.posture) + np.random.default_rng(5).normal(0.0, 0.3, (4, 7))
    value, gradient = sway(q)
    for k, posture in enumerate(q):
        exact = sway_mm_per_m_s2(posture, robot, scene.elastic_guardrail)
        assert 1e3 * value[k] == pytest.approx(exact, rel=0.03)
        found = finite_difference(lambda x: sway.values(x[None]), posture)[0]
        assert gradient[k] == pytest.approx(found, abs=2e-5 * np.abs(found).max())


@pytest.mark.parametrize("joints", ["rigid", "elastic"])
def test_sag_is_that_of_the_equilibrium_but_for_its_square(joints: Any) -> None:
    case = Case(joints)
    exact = Sag(case.arm).at(case.q).tool
    off = np.linalg.norm(case.sag() - exact, axis=1) / np.linalg.norm(exact, axis=1)
    assert off.max() < 0.05
    # What is left out is of second order: ten times as stiff, a tenth of the share.
    stiff = case.arm.softened(10.0)
    off_10 = np.linalg.norm(case.sag() / 10 - Sag(stiff).at(case.q).tool, axis=1)
    assert (off_10 / (np.linalg.norm(exact, axis=1) / 10)).max() < 0.15 * off.max()


def test_a_force_on_the_tool_counts() -> None:
    case = Case("elastic", push=PUSH)
    stiff = case.arm.softened(100.0)
    at = Sag(stiff).at(case.q)
    push = Postures(case.arm.robot).at(case.q).tool_rotation @ np.array(PUSH) @ case.R
    sag = case.sag(push) / 100
    np.testing.assert_allclose(sag, at.tool, atol=2e-3 * np.abs(at.tool).max())
    assert np.abs(case.sag() / 100 - at.tool).max() > 0.02 * np.abs(at.tool).max()


@pytest.mark.parametrize("joints", ["rigid", "elastic"])
def test_modes_are_those_of_the_linearised_arm(joints: Any) -> None:
    case = Case(joints)
    # A stiff arm does not bend, so that its modes are those about the rigid posture.
    stiff = without_added_mass(case.arm.softened(1e4))
    frequencies = 100 * case.first.at(case.q, case.bases).first_hz
    exact = [arm_modes(stiff, q).frequencies[0] for q in case.q]
    np.testing.assert_allclose(frequencies, exact, rtol=1e-4)


def test_sway_is_that_of_the_modal_response() -> None:
    case = Case("rigid")
    swayed = case.first.at(case.q, case.bases).shaken(0.01, BAND_HZ)
    for q, value in zip(case.q[:4], swayed, strict=False):
        moments = modal_response(case.arm, q, 0.01).moments(flat_band(), BAND_HZ)
        assert value == pytest.approx(np.sqrt(np.trace(moments.value[:3, :3])), rel=0.05)


def test_no_postures_are_none() -> None:
    case = Case("rigid")
    none = replace(case.bases, **{name: value[:0] for name, value in vars(case.bases).items()})
    batch = case.first.at(case.q[:0], none)
    assert case.first.sag(case.q[:0], none, case.gravity[:0]).shape == (0, 3)
    assert batch.first_hz.shape == (0,)


def test_a_rigid_arm_on_a_rigid_base_does_not_sag() -> None:
    case = Case("rigid")
    own = replace(case.arm.robot, elasticity={}, joint_elasticity={})
    bases = replace(case.bases, stiffness=None)
    first = FirstOrder(elastic_arm(own, None))
    assert first.at(case.q, bases).screw.shape == (20, 0, 6)
    assert not first.sag(case.q, bases, case.gravity).any()
