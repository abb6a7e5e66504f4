"""Parameters of an arm's stiffness: what measurements estimate, and what their covariance is of.

Of every link and joint the logarithm of its compliance, and of the base the symmetric X (6, 6) of

    C = L exp(X) L',    K = C^-1,

with a factor L of the arm's own compliance ``C_0 = L L'``: 21 numbers, with which C stays positive definite.
All are zero for the arm's own stiffness.
"""

from __future__ import annotations

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm

# Entries on and above the diagonal of a symmetric matrix (6, 6), row by row.
_ROW, _COLUMN = np.triu_indices(6)
_SYMMETRIC_BASIS = np.zeros((21, 6, 6))
_SYMMETRIC_BASIS[np.arange(21), _ROW, _COLUMN] = _SYMMETRIC_BASIS[np.arange(21), _COLUMN, _ROW] = 1.0
# Eigenvalues closer than this are one in the derivative of the exponential.
_EQUAL_EIGENVALUES = 1e-9


class StiffnessParameters:
    """The p parameters of an elastic arm's stiffness, links first, then joints, then the base.

    Attributes
    ----------
    springs : tuple of (str, str)
        Kind and name of every link and joint, in the order of their parameters.
    has_base : bool
        Whether 21 parameters of the base follow.
    factor : (6, 6)
        L, the lower triangular one, of an elastic base.
    """

    def __init__(self, arm: ElasticArm) -> None:
        self._own, springs = arm.stiffness, arm.springs
        self.springs = tuple(
            (kind, name) for wanted in ("link", "joint") for kind, name in springs if kind == wanted
        )
        self._index = [springs[spring] for spring in self.springs]
        self.has_base = ("base", "") in springs
        if self.has_base:
            self._at_base = springs["base", ""]
            own = self._own[np.ix_(self._at_base, self._at_base)]
            inverse = np.linalg.inv(own)
            self.factor = np.linalg.cholesky((inverse + inverse.T) / 2)
            self._inverse = np.linalg.inv(self.factor)

    @property
    def count(self) -> int:
        """The number p."""
        return len(self.springs) + (len(_SYMMETRIC_BASIS) if self.has_base else 0)

    def stiffness(self, parameters: FloatArray) -> FloatArray:
        """Return the stiffness (f, f) of the elastic coordinates at parameters (p,)."""
        K = self._own.copy()
        for at, parameter in zip(self._index, parameters, strict=False):
            K[np.ix_(at, at)] *= np.exp(-parameter)
        if self.has_base:
            values, V = np.linalg.eigh(-self._of_base(parameters))
            base = self._inverse.T @ (V * np.exp(values)) @ V.T @ self._inverse
            K[np.ix_(self._at_base, self._at_base)] = (base + base.T) / 2
        return K

    def relaxation(self, u: FloatArray, parameters: FloatArray | None = None) -> FloatArray:
        """Return the forces (N, f, p) that springs at `u` (N, f) lose as each parameter grows, -dK/dp u."""
        parameters = np.zeros(self.count) if parameters is None else parameters
        lost = np.zeros((*u.shape, self.count))
        for k, at in enumerate(self._index):
            own = self._own[np.ix_(at, at)] * np.exp(-parameters[k])
            lost[:, at, k] = u[:, at] @ own
        if self.has_base:
            D = -exponential_slopes(-self._of_base(parameters), -_SYMMETRIC_BASIS)
            strained = (D @ (u[:, self._at_base] @ self._inverse.T).T).transpose(2, 0, 1)
            lost[:, self._at_base, len(self.springs) :] = (strained @ self._inverse).transpose(0, 2, 1)
        return lost

    def _of_base(self, parameters: FloatArray) -> FloatArray:
        return symmetric(parameters[len(self.springs) :])


def symmetric(entries: FloatArray) -> FloatArray:
    """Return the symmetric matrix (6, 6) of the entries (21,) on and above its diagonal, row by row."""
    return np.asarray(np.tensordot(entries, _SYMMETRIC_BASIS, axes=1))


def entries_of(matrix: FloatArray) -> FloatArray:
    """Return the entries (..., 21) on and above the diagonal of symmetric matrices (..., 6, 6)."""
    return np.asarray(matrix[..., _ROW, _COLUMN])


def exponential_slopes(Y: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the derivatives (k, 6, 6) of exp(Y) along symmetric directions (k, 6, 6) (Daleckii, Krein)."""
    values, V = np.linalg.eigh(Y)
    grown, apart = np.exp(values), values[:, None] - values
    same = np.abs(apart) < _EQUAL_EIGENVALUES
    quotient = (grown[:, None] - grown) / np.where(same, 1.0, apart)
    weight = np.where(same, np.sqrt(np.outer(grown, grown)), quotient)
    return np.asarray(V @ (weight * (V.T @ directions @ V)) @ V.T)
