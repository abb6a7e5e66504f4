"""The torque problem as the sparse solver sees it: a place with its derivatives."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.constraint_set import ConstraintSet
from cmbot.optimization.curvature import convexified, state_curvature
from cmbot.optimization.linearization import SiteValues, site_values
from cmbot.optimization.qp import LocalModel, LocalValues
from cmbot.planning.torque.constraints import Linearisation, StateSamples
from cmbot.planning.torque.problem import KinematicBound
from cmbot.trajectory.local_basis import LocalRows
from cmbot.trajectory.parametrization import Parametrization
from cmbot.trajectory.quintic import QuinticTrajectory

__all__ = ["NlpEvaluation"]


@dataclass(frozen=True)
class NlpEvaluation:
    """A spline, and the torque problem around it: `NlpEvaluation.on` makes one.

    Attributes
    ----------
    known : ConstraintSet
    family : Parametrization
        Built around the spline.
    bound : float or None
        What the scaled torque is held below while its mean square is lowered; None where the peak is lowered.
    trajectory : QuinticTrajectory
        The spline.
    at : SiteValues
        The constraints that were known when the place was made.
    """

    known: ConstraintSet
    family: Parametrization
    bound: float | None
    trajectory: QuinticTrajectory
    at: SiteValues

    @staticmethod
    def on(known: ConstraintSet, family: Parametrization, bound: float | None) -> NlpEvaluation:
        """Return the place of the spline that a family is built around."""
        trajectory = known.problem.trajectory(family, family.start)
        at = site_values(known.sites(family.splines), trajectory)
        return NlpEvaluation(known, family, bound, trajectory, at)

    def moved(self, p: FloatArray) -> NlpEvaluation:
        """Step by the unknowns `p`; what is violated there is known from then on."""
        trial = NlpEvaluation.on(self.known, self.family.rebuilt(p, self.family.weight), self.bound)
        self.known.look(trial.trajectory, trial.values.peak if self.bound is None else self.bound)
        return trial.renewed()

    def renewed(self) -> NlpEvaluation:
        """Return the same spline with the constraints that are known by now."""
        sites = self.known.sites(self.family.splines)
        if sites is self.at.sites:
            return self
        return replace(self, at=site_values(sites, self.trajectory, self.at))

    def lifted(self, multipliers: FloatArray) -> FloatArray:
        """Multipliers of the constraints known by now, from those of constraints known some time before."""
        return self.known.lifted(multipliers)

    def thinned(self, multipliers: FloatArray) -> tuple[NlpEvaluation, FloatArray]:
        """Return the same spline with fewer constraints, where they were many, and their multipliers."""
        needed = self.known.needed(self.at.sites, self.values.value, multipliers)
        if needed is None:
            return self, multipliers
        left = self.at.kept(needed, self.known.sites(self.family.splines))
        return replace(self, at=left), multipliers[needed]

    @cached_property
    def values(self) -> LocalValues:
        """Values alone."""
        objective, value = self.family.smoothing()[0], self.at.all_values
        torques = self.at.sites.torques
        if self.bound is not None:
            value = value.copy()
            value[:torques] -= self.bound
            objective += 0.5 * sum(float(part.value @ part.value) for part in self._parts)
        return LocalValues(
            objective=objective,
            value=value,
            peaks=torques if self.bound is None else 0,
            kind=self.at.sites.kind,
            least=self.known.problem.content,
        )

    @cached_property
    def first(self) -> LocalModel:
        """Values and first derivatives; the Hessian is left empty."""
        family, at, values = self.family, self.at, self.values
        gradient = family.map.T @ family.smoothing()[1]
        if self.bound is not None:
            gradient = gradient + self._mean_jacobian.T @ np.concatenate([part.value for part in self._parts])
        rows, joints = at.sites.rows, family.via_points.shape[1]
        faced = np.tile(at.sites.faced, len(at.face_value))
        faces = at.face_derivative.reshape(1, len(faced), joints)
        return LocalModel(
            objective=values.objective,
            value=values.value,
            peaks=values.peaks,
            kind=values.kind,
            least=values.least,
            gradient=gradient,
            hessian=sparse.csr_array((family.dimension, family.dimension)),
            jacobian=family.assembly.jacobian(rows, at.all_derivatives),
            face_value=at.face_value.ravel(),
            face_jacobian=family.assembly.jacobian(rows[faced], faces),
            face_kind=at.sites.kind[faced],
        )

    def curvature(self, multipliers: FloatArray) -> sparse.csr_array:
        """Positive definite Hessian of the Lagrangian."""
        family = self.family
        H = family.smoothing_curvature
        if self.bound is not None:
            H = H + self._mean_jacobian.T @ self._mean_jacobian
        if multipliers.any():
            H = H + family.assembly.hessian(*self._bent(multipliers))
        if family.slides:
            H = H + family.bend_curvature(self._pull(multipliers))
        return convexified(sparse.csr_array(H), family.block_ends)

    def _bent(self, multipliers: FloatArray) -> tuple[LocalRows, FloatArray]:
        """Where the constraints' multipliers bend the Lagrangian, and by how much."""
        sites, total = self.at.sites, float(multipliers.sum())
        ends = np.cumsum(sites.sizes)
        active: list[IntArray] = [np.empty(0, dtype=np.intp)]
        curvatures: list[FloatArray] = [np.empty((0, *2 * (3 * self.family.via_points.shape[1],)))]
        for number, function in enumerate(sites.kinds):
            first = ends[number] - sites.sizes[number]
            share = multipliers[first : ends[number]]
            if isinstance(function, KinematicBound) or not share.any():
                continue
            times = sites.times[number]
            states = StateSamples(times, *self.trajectory.states(times))
            which, curvature = state_curvature(function, states, sites.component[number], share, total)
            active.append(first + which)
            curvatures.append(curvature)
        return sites.rows[np.concatenate(active)], np.concatenate(curvatures)

    def _pull(self, multipliers: FloatArray) -> FloatArray:
        """Gradient (size of u,) of the Lagrangian by u."""
        family, sites = self.family, self.at.sites
        pull = family.smoothing()[1]
        if self.bound is not None:
            for part in self._parts:
                by_state = part.value[:, None] * np.stack([part.d_q, part.d_v, part.d_a])
                pull = pull + family.pulled(self._mean_rows, by_state)
        active = np.flatnonzero(multipliers)
        by_state = multipliers[active, None] * self.at.all_derivatives[:, active]
        return pull + family.pulled(sites.rows[active], by_state)

    @cached_property
    def _parts(self) -> tuple[Linearisation, ...]:
        """What the mean of the squared torque is the sum of the squares of."""
        return self.known.problem.mean_parts(self.trajectory)

    @cached_property
    def _mean_rows(self) -> LocalRows:
        return self.family.rows(self.known.problem.mean_times)

    @cached_property
    def _mean_jacobian(self) -> sparse.csr_array:
        each = [np.stack([part.d_q, part.d_v, part.d_a]) for part in self._parts]
        J = [self.family.assembly.jacobian(self._mean_rows, by_state) for by_state in each]
        return sparse.csr_array(sparse.vstack(J))
