"""Mechanisms of a few driven and elastic joints, for the integrator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import root

from cmbot.elastic.generalized_alpha import ElasticMotion, ElasticSystem, GeneralizedAlpha
from cmbot.trajectory import QuinticTrajectory

FloatArray = NDArray[np.float64]


def system_of(
    model: Any, driven: Sequence[int], stiffness: Sequence[float] | FloatArray, damping: float = 0.0
) -> ElasticSystem:
    """A system whose coordinates are springs, except the driven ones."""
    elastic = np.setdiff1d(np.arange(model.nv), driven)
    return ElasticSystem(
        model=model,
        driven=np.array(driven, dtype=np.intp),
        elastic=elastic,
        stiffness=np.diag(np.asarray(stiffness, dtype=float)),
        damping=damping * np.eye(len(elastic)),
        added_mass=np.zeros((len(elastic), len(elastic))),
    )


def joined(system: ElasticSystem, driven: FloatArray, elastic: FloatArray) -> FloatArray:
    """All coordinates, (N, d + f)."""
    full = np.empty((len(driven), system.model.nv))
    full[:, system.driven], full[:, system.elastic] = driven, elastic
    return full


def empty_model() -> Any:
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    return model


def mass_on_spring(mass: float, stiffness: float, damping: float = 0.0) -> ElasticSystem:
    """A point mass on a vertical spring; nothing is driven."""
    model = empty_model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "spring")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    return system_of(model, [], [stiffness], damping)


def pendulum_on_a_cart(damping: float = 0.0) -> ElasticSystem:
    """A cart of 2 kg on a spring of 900 N/m along x; from it hangs a driven pendulum, 1.5 kg at 0.8 m.

    Coordinates: the cart's x, then the pendulum's angle about y.
    """
    model = empty_model()
    cart = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "cart")
    model.appendBodyToJoint(cart, pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    pendulum = model.addJoint(cart, pin.JointModelRY(), pin.SE3.Identity(), "pendulum")
    bob = pin.Inertia(1.5, np.array([0.0, 0.0, -0.8]), np.zeros((3, 3)))
    model.appendBodyToJoint(pendulum, bob, pin.SE3.Identity())
    return system_of(model, [1], [900.0], damping)


def soft_arm(softer: float = 1.0) -> ElasticSystem:
    """Two driven joints with springs before and behind them, bending and twisting: 12, 42 and 74 Hz."""
    model = empty_model()
    joint, link = 0, pin.SE3(np.eye(3), np.array([0.7, 0.0, 0.0]))
    body = pin.Inertia(3.0, np.array([0.35, 0.02, -0.03]), np.diag([0.02, 0.15, 0.14]))
    kinds = (pin.JointModelPZ, pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ, pin.JointModelRY)
    for number, kind in enumerate(kinds):
        joint = model.addJoint(joint, kind(), link if number else pin.SE3.Identity(), f"j{number}")
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return system_of(model, [2, 3], np.array([9e4, 2e4, 3e4]) / softer)


def resting(joints: int, seconds: float) -> QuinticTrajectory:
    return QuinticTrajectory.held(np.zeros(joints), seconds)


def swinging(joints: int, seconds: float = 2.0) -> QuinticTrajectory:
    """From rest to rest, each joint by another way."""
    t = np.linspace(0.0, seconds, 41)
    ways = [0.8 * np.sin(np.pi * t / seconds) ** 2 * np.cos(k + t) for k in range(joints)]
    return QuinticTrajectory.through(t, np.column_stack(ways))


def integrate(
    system: ElasticSystem,
    drive: QuinticTrajectory,
    *,
    step: float,
    u: Sequence[float] | FloatArray | None = None,
    rho_inf: float = 0.8,
    corrections: int = 2,
) -> ElasticMotion:
    """Let a system move from rest."""
    integrator = GeneralizedAlpha(system, step=step, rho_inf=rho_inf, corrections=corrections)
    still = np.zeros(len(system.elastic))
    return integrator.run([drive], still if u is None else np.asarray(u, dtype=float), still)


def equilibrium(system: ElasticSystem, joints: FloatArray) -> FloatArray:
    """Elastic coordinates at rest, by SciPy's root finder."""
    data = system.model.createData()

    def force(u: FloatArray) -> FloatArray:
        q = joined(system, joints[None], u[None])[0]
        return pin.computeGeneralizedGravity(system.model, data, q)[system.elastic] + system.stiffness @ u

    found = root(force, np.zeros(len(system.elastic)), tol=1e-13)
    assert np.abs(force(found.x)).max() < 1e-8
    return found.x
