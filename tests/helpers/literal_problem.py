"""Chang 2021, Eqs. (30)-(37), as written: knot velocities and accelerations are the variables.

Splines by SciPy's Bernstein polynomials, the jerk conditions as equalities, torque and tool on one grid.
Bounds on the joints are left out: where the solution keeps them anyway, it is the solution with them too.
"""

from dataclasses import dataclass

import numpy as np
from quadrature import gauss_points
from scipy.interpolate import BPoly
from scipy.optimize import minimize

from cmbot.common.arrays import FloatArray
from cmbot.planning.task import ToolTask
from cmbot.robot import Dynamics, Kinematics, Robot


@dataclass(frozen=True, kw_only=True)
class Literal:
    """A problem over variables z: per joint, velocities then accelerations at the inner knots."""

    robot: Robot
    task: ToolTask
    t: FloatArray
    via_points: FloatArray
    scale: float
    smoothing_weight: float
    max_tool_deviation: float
    per_segment: int = 20

    def solve(self, peak: float | None = None) -> tuple[float, FloatArray]:
        """Minimise the peak of the torque, or its mean square below a given `peak`; return optimum and z."""
        n = 14 * (len(self.t) - 2)
        start = np.zeros(n + 1)
        start[-1] = 1.1

        # The variables in other units, so that the smoothing term is as steep along all of them.
        A = self._at_gauss[3][1]
        rows = np.sqrt(self._weights)[:, None, None] * A / self.robot.limits.jerk[:, None]
        H = np.einsum("kiz,kiy->zy", rows, rows) * self.smoothing_weight / 7
        C = np.zeros((n + 1, n + 1))
        C[:n, :n] = np.linalg.inv(np.linalg.cholesky(H)).T
        C[n, n] = 1.0

        def objective(u: FloatArray) -> tuple[float, FloatArray]:
            z, bound = np.split(C @ u, [n])
            smooth, d_smooth = self.smoothing(z)
            if peak is None:
                return bound[0] + smooth, C.T @ np.append(d_smooth, 1.0)
            torque, J = self._torques(z, self._at_gauss)
            gradient = np.einsum("k,ki,kij->j", self._weights, torque, J) + d_smooth
            return self.mean_square(z) + smooth, C.T @ np.append(gradient, 0.0)

        def inequalities(u: FloatArray) -> FloatArray:
            z, bound = np.split(C @ u, [n])
            return np.concatenate(
                [(bound if peak is None else peak) - self._norms(z)[0], 1 - self._deviations(z)[0]]
            )

        def d_inequalities(u: FloatArray) -> FloatArray:
            z = (C @ u)[:n]
            d_torque, d_tool = self._norms(z)[1], self._deviations(z)[1]
            last = np.zeros((len(d_torque) + len(d_tool), 1))
            last[: len(d_torque)] = 1.0 if peak is None else 0.0
            return np.asarray(np.hstack([-np.vstack([d_torque, d_tool]), last]) @ C)

        jerks = np.hstack([self._jerk_conditions, np.zeros((len(self._jerk_conditions), 1))]) @ C
        assert len(jerks) < n
        result = minimize(
            objective,
            np.linalg.solve(C, start),
            jac=True,
            method="SLSQP",
            constraints=[
                {"type": "eq", "fun": lambda u: jerks @ u + self._jerk_offset, "jac": lambda u: jerks},
                {"type": "ineq", "fun": inequalities, "jac": d_inequalities},
            ],
            options={"maxiter": 300, "ftol": 1e-9},
        )
        assert result.success, result.message
        return float(result.fun), (C @ result.x)[:n]

    def mean_square(self, z: FloatArray) -> float:
        """Half the time mean of the squared, scaled torque."""
        return 0.5 * float(self._weights @ (self._torques(z, self._at_gauss)[0] ** 2).sum(axis=1))

    def smoothing(self, z: FloatArray) -> tuple[float, FloatArray]:
        """Half the weight times the mean of (velocity/V_C)^2 + (jerk/J_C)^2, with its gradient."""
        factor = self.smoothing_weight / 7 * self._weights[:, None]
        value, gradient = 0.0, np.zeros_like(z)
        for order, bound in ((1, self.robot.limits.velocity), (3, self.robot.limits.jerk)):
            offset, A = self._at_gauss[order]
            share = (offset + A @ z) / bound
            value += 0.5 * float((factor * share**2).sum())
            gradient += np.einsum("ki,kij->j", factor * share / bound, A)
        return value, gradient

    def spline(self, z: FloatArray) -> BPoly:
        """The spline of the variables, over all joints."""
        v, a = np.zeros_like(self.via_points), np.zeros_like(self.via_points)
        v[1:-1], a[1:-1] = z.reshape(2, len(self.t) - 2, 7)
        return BPoly.from_derivatives(self.t, np.stack([self.via_points, v, a], axis=1))

    def __post_init__(self) -> None:
        grid = np.linspace(self.t[:-1], self.t[1:], self.per_segment, endpoint=False, axis=1).ravel()
        gauss, weights = gauss_points(self.t, 6)
        values = {
            "_grid": np.append(grid, self.t[-1]),
            "_gauss": gauss,
            "_weights": weights,
        }
        values["_at_grid"], values["_at_gauss"] = self._affine(values["_grid"]), self._affine(gauss)
        eps = 1e-9
        # Jerk just after the start, on both sides of each inner knot, just before the end.
        sides = self._affine(np.concatenate([self.t[:-1] + eps, self.t[1:] - eps]), orders=(3,))[0]
        m = len(self.t) - 1
        offset, A = (np.concatenate([x[:1], x[1:m] - x[m:-1], x[-1:]]) for x in sides)
        values["_jerk_offset"] = offset.ravel() / self.robot.limits.jerk.max()
        values["_jerk_conditions"] = A.reshape(len(offset) * 7, -1) / self.robot.limits.jerk.max()
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _affine(
        self, times: FloatArray, orders: tuple[int, ...] = (0, 1, 2, 3)
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Each derivative at `times` as ``offset + A z``: the spline is affine in its knots' derivatives."""
        n = 14 * (len(self.t) - 2)
        found = []
        for order in orders:
            values = [self.spline(z)(times, nu=order) for z in np.vstack([np.zeros(n), np.eye(n)])]
            found.append((values[0], np.stack(values[1:], axis=-1) - values[0][..., None]))
        return found

    def _torques(
        self, z: FloatArray, affine: list[tuple[FloatArray, FloatArray]]
    ) -> tuple[FloatArray, FloatArray]:
        """Scaled guardrail torques (N, 3), and their Jacobian (N, 3, n)."""
        q, v, a = (offset + A @ z for offset, A in affine[:3])
        at = Dynamics(self.robot).derivatives(q, v, a)
        parts = zip((at.d_q, at.d_v, at.d_a), affine[:3], strict=True)
        J = sum(np.einsum("kij,kjz->kiz", d[:, :3], A) for d, (_, A) in parts)
        return at.value[:, :3] / self.scale, np.asarray(J) / self.scale

    def _norms(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        torque, J = self._torques(z, self._at_grid)
        norm = np.linalg.norm(torque, axis=1)
        return norm, np.einsum("ki,kiz->kz", torque / norm[:, None], J)

    def _deviations(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distance of the tool from its leg as a share of the bound, squared, and its Jacobian."""
        offset, A = self._at_grid[0]
        p, J = Kinematics(self.robot).tool_point_jacobians(offset + A @ z)
        away = self.task.path.leg_offset(self._grid, p) / self.max_tool_deviation
        d = 2 * np.einsum("ki,kij,kjz->kz", away, J, A) / self.max_tool_deviation
        return (away**2).sum(axis=1), d
