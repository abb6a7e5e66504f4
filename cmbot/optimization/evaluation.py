"""A program at one trajectory, with its derivatives: what solvers step from."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.constraint_set import OBJECTIVE, ConstraintSet
from cmbot.optimization.curvature import convexified, state_curvature
from cmbot.optimization.linearization import ConstraintValues, families_of, linearize
from cmbot.optimization.program import KinematicBound, Linearization, Program, StateSamples
from cmbot.optimization.qp import NlpModel, NlpValues
from cmbot.optimization.separation import find_violations
from cmbot.trajectory import LocalRows, Parametrization

# At most so many constraints of a family are added for a step: the worst, which usually hold the others.
_MAX_ADDED_CONSTRAINTS = 40


@dataclass(frozen=True, kw_only=True)
class Stage:
    """Which of a program's objectives is minimised, and with how much smoothing.

    Without `bound` the peak is minimised, with it the mean square, the peak held below `bound`; with `weight`
    0 only the constraints count, and steps are the least by the curvature of the objective.
    """

    smoothing: float  # weight of half the mean squared jerk beside the objective
    bound: float | None = None
    weight: float = 1.0  # of the objective and the smoothing
    target: float = 0.0  # the peak need not fall below this
    tolerance: float  # violations up to this count as met

    @property
    def name(self) -> str:
        """How reports call it."""
        return "peak" if self.bound is None else "mean square"


@dataclass(frozen=True, kw_only=True, eq=False)
class NlpEvaluation:
    """A stage of a program at one trajectory: an iterate of a solver."""

    program: Program
    stage: Stage
    parametrization: Parametrization  # built around the trajectory
    constraints: ConstraintSet
    at: ConstraintValues  # the constraints there

    @staticmethod
    def around(
        program: Program, stage: Stage, parametrization: Parametrization, constraints: ConstraintSet
    ) -> NlpEvaluation:
        """Evaluate a program at the trajectory that a parametrization was built around."""
        return NlpEvaluation(
            program=program,
            stage=stage,
            parametrization=parametrization,
            constraints=constraints,
            at=linearize(program, constraints, parametrization.trajectory),
        )

    def displaced(self, p: FloatArray) -> NlpEvaluation:
        """Return the program after a step `p` (n,), with the same constraints."""
        return self.around(self.program, self.stage, self.parametrization.step(p), self.constraints)

    def separated(self) -> NlpEvaluation:
        """Return the same point with what is violated there among its constraints."""
        limit = self.values.peak if self.stage.bound is None else self.stage.bound
        trajectory, tolerance = self.parametrization.trajectory, self.stage.tolerance
        found = find_violations(self.program, trajectory, limit, tolerance, _MAX_ADDED_CONSTRAINTS)
        return self._with(found.added_to(self.constraints))

    def refresh(self, other: NlpEvaluation) -> NlpEvaluation:
        """Return the same point with the constraints of another one, which extend its own."""
        return self._with(other.constraints)

    def drop_constraints(self, multipliers: FloatArray) -> tuple[NlpEvaluation, FloatArray]:
        """Return the same point without constraints that do not matter, and the multipliers of the others."""
        needed = self.constraints.needed(self.values.value, multipliers)
        if needed.all():
            return self, multipliers
        left = replace(self, constraints=self.constraints.kept(needed), at=self.at.kept(needed))
        return left, multipliers[needed]

    def _with(self, constraints: ConstraintSet) -> NlpEvaluation:
        if constraints is self.constraints:
            return self
        at = linearize(self.program, constraints, self.parametrization.trajectory, self.at)
        return replace(self, constraints=constraints, at=at)

    @property
    def peak(self) -> float:
        """Largest value of the objective at the constraints' times."""
        return float(self.at.value[self.constraints.family == OBJECTIVE].max())

    @property
    def violation_beside_peak(self) -> float:
        """Largest violation of the constraints but for the bound on the objective, or 0."""
        return float(self.at.value[self.constraints.family != OBJECTIVE].max(initial=0.0))

    @cached_property
    def values(self) -> NlpValues:
        """Values alone."""
        bound, value = self.stage.bound, self.at.value
        objective = self.stage.smoothing * self._jerk[0]
        if bound is not None:
            value = value - bound * (self.constraints.family == OBJECTIVE)
            objective += 0.5 * sum(float(part.value @ part.value) for part in self._residuals)
        return NlpValues(
            objective=self.stage.weight * objective,
            value=value,
            family=self.constraints.family,
            epigraph=bound is None,
            least=self.stage.target,
        )

    @cached_property
    def model(self) -> NlpModel:
        """Values and first derivatives; the Hessian is left empty."""
        form, at, values = self.parametrization, self.at, self.values
        gradient = self.stage.smoothing * (form.map.T @ self._jerk[1])
        if self.stage.bound is not None:
            gradient = gradient + self._mean_jacobian.T @ self._residual
        rows = self._rows
        return NlpModel(
            **vars(values),
            gradient=self.stage.weight * gradient,
            hessian=sparse.csr_array((form.dimension, form.dimension)),
            jacobian=form.jacobian(rows, at.derivative),
            cut_value=at.cut_value,
            cut_jacobian=form.jacobian(rows[at.cut_of], at.cut_derivative),
            cut_family=values.family[at.cut_of],
        )

    def hessian(self, multipliers: FloatArray) -> sparse.csr_array:
        """Positive definite Hessian (n, n) of the Lagrangian, with multipliers (K,) of the constraints."""
        form = self.parametrization
        H = self.stage.smoothing * form.smoothing_hessian
        if self.stage.bound is not None:
            H = H + self._mean_jacobian.T @ self._mean_jacobian
        if multipliers.any():
            H = H + form.hessian(*self._curvatures(multipliers))
        if form.displacements:
            H = H + form.bend_hessian(self._pullback(multipliers))
        return convexified(sparse.csr_array(H), form.block_ends)

    def dense(self, M: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return gradient (m,), constraints' Jacobian (K, m) and the residuals' (R, m) by other unknowns.

        `M` (size of u, m) has the derivatives by them of coefficients and via-points.
        """
        splines = self.parametrization.splines
        jacobian = splines.jacobian(self._rows, self.at.derivative) @ M
        gradient, residuals = self.stage.smoothing * (M.T @ self._jerk[1]), np.empty((0, M.shape[1]))
        if self.stage.bound is not None:
            rows = splines.rows(self.program.mean_times)
            J = sparse.vstack([splines.jacobian(rows, part.derivatives) for part in self._residuals])
            residuals = J @ M
            gradient = gradient + residuals.T @ self._residual
        return self.stage.weight * gradient, jacobian, residuals

    def _curvatures(self, multipliers: FloatArray) -> tuple[LocalRows, FloatArray]:
        """Where the constraints' multipliers bend the Lagrangian, and by how much."""
        known, total = self.constraints, float(multipliers.sum())
        active: list[IntArray] = [np.empty(0, dtype=np.intp)]
        d = self.parametrization.via_points.shape[1]
        curvatures: list[FloatArray] = [np.empty((0, 3 * d, 3 * d))]
        for number, function in enumerate(families_of(self.program)):
            here = np.flatnonzero(known.family == number)
            if isinstance(function, KinematicBound) or not multipliers[here].any():
                continue
            states = StateSamples.along(self.parametrization.trajectory, known.time[here])
            which, curvature = state_curvature(
                function, states, known.component[here], multipliers[here], total
            )
            active.append(here[which])
            curvatures.append(curvature)
        return self._rows[np.concatenate(active)], np.concatenate(curvatures)

    def _pullback(self, multipliers: FloatArray) -> FloatArray:
        """Gradient (size of u,) of the Lagrangian by u."""
        form = self.parametrization
        gradient = self.stage.smoothing * self._jerk[1]
        if self.stage.bound is not None:
            for part in self._residuals:
                gradient = gradient + form.pullback(self._mean_rows, part.value[:, None] * part.derivatives)
        active = np.flatnonzero(multipliers)
        by_state = multipliers[active, None] * self.at.derivative[:, active]
        return self.stage.weight * gradient + form.pullback(self._rows[active], by_state)

    @cached_property
    def _jerk(self) -> tuple[float, FloatArray]:
        return self.parametrization.smoothing()

    @cached_property
    def _rows(self) -> LocalRows:
        """The splines at the constraints' times."""
        return self.parametrization.splines.rows(self.constraints.time)

    @cached_property
    def _residuals(self) -> tuple[Linearization, ...]:
        return self.program.mean_residuals(self.parametrization.trajectory)

    @cached_property
    def _residual(self) -> FloatArray:
        return np.concatenate([part.value for part in self._residuals])

    @cached_property
    def _mean_rows(self) -> LocalRows:
        return self.parametrization.splines.rows(self.program.mean_times)

    @cached_property
    def _mean_jacobian(self) -> sparse.csr_array:
        form = self.parametrization
        each = [form.jacobian(self._mean_rows, part.derivatives) for part in self._residuals]
        return sparse.csr_array(sparse.vstack(each))
