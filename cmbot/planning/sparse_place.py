"""The torque problem on a working set, as the sparse solver sees it: a place with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.arrays import FloatArray
from cmbot.planning.curvature import convexified, state_curvature
from cmbot.planning.problem import TorqueProblem
from cmbot.planning.sparse_family import LocalKnots
from cmbot.planning.sparse_qp import LocalModel
from cmbot.planning.state_functions import States
from cmbot.planning.working_set import WorkingSet

__all__ = ["TorquePlace"]


@dataclass(frozen=True)
class TorquePlace:
    """A spline, and the torque problem around it.

    Attributes
    ----------
    problem : TorqueProblem
    working : WorkingSet
    family : LocalKnots
        Built around the spline.
    bound : float or None
        What the scaled torque is held below while its mean square is lowered; None where the peak is lowered.
    """

    problem: TorqueProblem
    working: WorkingSet
    family: LocalKnots
    bound: float | None

    def moved(self, p: FloatArray) -> TorquePlace:
        """Step by the unknowns `p`."""
        return TorquePlace(self.problem, self.working, self.family.rebuilt(p, self.family.weight), self.bound)

    @cached_property
    def first(self) -> LocalModel:
        """Values and first derivatives; Hessian and faces are left empty."""
        family = self.family
        value, jacobian, torques = self._constraints
        objective, gradient = family.smoothing()
        if self.bound is not None:
            value = value.copy()
            value[:torques] -= self.bound
            torque, by_u = self._torque
            objective, gradient = objective + 0.5 * float(torque @ torque), gradient + by_u.T @ torque
        return LocalModel(
            objective=objective,
            gradient=family.map.T @ gradient,
            hessian=sparse.csr_array((family.dimension, family.dimension)),
            value=value,
            jacobian=sparse.csr_array(jacobian @ family.map),
            peaks=torques if self.bound is None else 0,
            face_value=np.empty(0),
            face_jacobian=sparse.csr_array((0, family.dimension)),
        )

    def second(self, multipliers: FloatArray) -> LocalModel:
        """The same with a positive definite Hessian of the Lagrangian."""
        family, first = self.family, self.first
        H = family.smoothing_curvature
        gradient = family.smoothing()[1]
        if self.bound is not None:
            torque, by_u = self._torque
            J = by_u @ family.map
            H = H + J.T @ J
            gradient = gradient + by_u.T @ torque
        if multipliers.any():
            gradient = gradient + self._constraints[1].T @ multipliers
            total, done = float(multipliers.sum()), 0
            trajectory = self.problem.trajectory(family, family.start)
            by_u = sparse.csr_array((family.map.shape[0],) * 2)
            for function, times, component in self.working.state_sites():
                share = multipliers[done : done + len(times)]
                done += len(times)
                states = States(times, *trajectory.states(times))
                by_u = by_u + state_curvature(family, function, states, component, share, total)
            H = H + family.map.T @ by_u @ family.map
        H = convexified(sparse.csr_array(H + family.bend_curvature(gradient)), family.blocks)
        value, faces = self.working.faces(family, family.start)
        return replace(first, hessian=H, face_value=value, face_jacobian=sparse.csr_array(faces @ family.map))

    @cached_property
    def _constraints(self) -> tuple[FloatArray, sparse.csr_array, int]:
        return self.working.values(self.family, self.family.start)

    @cached_property
    def _torque(self) -> tuple[FloatArray, sparse.csr_array]:
        return self.problem.weighted_parts(self.family, self.family.start)
