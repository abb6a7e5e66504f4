"""The torque problem as the sparse solver sees it: a place with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from scipy import sparse

from cmbot.arrays import FloatArray
from cmbot.planning.curvature import convexified, state_curvature
from cmbot.planning.known_constraints import KnownConstraints
from cmbot.planning.sparse_family import LocalKnots
from cmbot.planning.sparse_qp import LocalModel
from cmbot.planning.state_functions import States

__all__ = ["TorquePlace"]


@dataclass(frozen=True)
class TorquePlace:
    """A spline, and the torque problem around it.

    Attributes
    ----------
    known : KnownConstraints
    family : LocalKnots
        Built around the spline.
    bound : float or None
        What the scaled torque is held below while its mean square is lowered; None where the peak is lowered.
    count : int
        Number of constraints that were known when the place was made.
    """

    known: KnownConstraints
    family: LocalKnots
    bound: float | None
    count: int

    def moved(self, p: FloatArray) -> TorquePlace:
        """Step by the unknowns `p`; what is violated there is known from then on."""
        trial = self._with(self.family.rebuilt(p, self.family.weight))
        self.known.look(trial.family, trial.first.peak if self.bound is None else self.bound)
        return trial.renewed()

    def renewed(self) -> TorquePlace:
        """Return the same spline with the constraints that are known by now."""
        return self if self.known.count() == self.count else self._with(self.family)

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers of the constraints known by now, from those of constraints known some time before."""
        return self.known.lifted(multipliers)

    def thinned(self, multipliers: FloatArray) -> tuple[TorquePlace, FloatArray]:
        """Return the same spline with fewer constraints, where they were many, and their multipliers."""
        left = self.known.thinned(self.first.value, multipliers)
        return self.renewed(), left

    def _with(self, family: LocalKnots) -> TorquePlace:
        return TorquePlace(self.known, family, self.bound, self.known.count())

    @cached_property
    def first(self) -> LocalModel:
        """Values and first derivatives; the Hessian is left empty."""
        family = self.family
        value, jacobian, torques = self._constraints
        objective, gradient = family.smoothing()
        if self.bound is not None:
            value = value.copy()
            value[:torques] -= self.bound
            torque, by_u = self._torque
            objective, gradient = objective + 0.5 * float(torque @ torque), gradient + by_u.T @ torque
        face_value, faces = self.known.working.faces(family, family.start)
        kind, face_kind = self.known.kinds(len(face_value))
        return LocalModel(
            objective=objective,
            gradient=family.map.T @ gradient,
            hessian=sparse.csr_array((family.dimension, family.dimension)),
            value=value,
            jacobian=sparse.csr_array(jacobian @ family.map),
            peaks=torques if self.bound is None else 0,
            kind=kind,
            face_value=face_value,
            face_jacobian=sparse.csr_array(faces @ family.map),
            face_kind=face_kind,
            along=family.along,
            least=self.known.problem.content,
        )

    def curvature(self, multipliers: FloatArray) -> sparse.csr_array:
        """Positive definite Hessian of the Lagrangian."""
        family, problem = self.family, self.known.problem
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
            trajectory = problem.trajectory(family, family.start)
            by_u = sparse.csr_array((family.map.shape[0],) * 2)
            for function, times, component in self.known.working.state_sites():
                share = multipliers[done : done + len(times)]
                done += len(times)
                states = States(times, *trajectory.states(times))
                by_u = by_u + state_curvature(family, function, states, component, share, total)
            H = H + family.map.T @ by_u @ family.map
        return convexified(sparse.csr_array(H + family.bend_curvature(gradient)), family.blocks)

    @cached_property
    def _constraints(self) -> tuple[FloatArray, sparse.csr_array, int]:
        return self.known.working.values(self.family, self.family.start)

    @cached_property
    def _torque(self) -> tuple[FloatArray, sparse.csr_array]:
        return self.known.problem.weighted_parts(self.family, self.family.start)
