"""Natural frequencies of a frame, from its sparse stiffness and mass."""

from __future__ import annotations

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator, SuperLU, eigsh, splu

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError

__all__ = ["factorised", "natural_frequencies", "too_far_apart"]

# ARPACK needs room for more vectors than it is asked for; below this size all modes cost nothing anyway.
_SMALL = 60


def factorised(stiffness: sparse.csc_array) -> SuperLU:
    """Return the factors of a symmetric positive definite matrix.

    Raises
    ------
    InputError
        When it is singular.
    """
    options = {"SymmetricMode": True}
    try:
        return splu(stiffness, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:  # SuperLU's "exactly singular"
        raise too_far_apart() from error


def too_far_apart() -> InputError:
    """Error of a stiffness that is positive definite on paper but not in floating-point numbers."""
    got = "stiffnesses that floating-point numbers cannot hold side by side"
    return InputError("Frame", "members", got, "members of comparable stiffness and length")


def natural_frequencies(
    stiffness: sparse.csc_array, mass: sparse.csc_array, count: int, *, factor: SuperLU | None = None
) -> FloatArray:
    """Return the lowest natural frequencies, ascending, Hz.

    Parameters
    ----------
    stiffness, mass : (f, f)
        Symmetric; the stiffness positive definite, the mass at least semi-definite.
    count : int
        At most how many.
    factor : scipy.sparse.linalg.SuperLU, optional
        Of the stiffness, where it is there already.

    Returns
    -------
    (k,)
        Fewer than `count` where fewer coordinates have mass.

    Raises
    ------
    InputError
        When rounding leaves the stiffness less than positive definite.
    """
    size = stiffness.shape[0]
    if count < 1 or mass.count_nonzero() == 0:
        return np.zeros(0)
    if size <= max(_SMALL, 4 * count):
        # With the roles exchanged a mass that is only semi-definite is no trouble.
        try:
            squares = linalg.eigh(mass.toarray(), stiffness.toarray(), eigvals_only=True)[::-1][:count]
        except linalg.LinAlgError as error:
            raise too_far_apart() from error
        there = squares > size * np.finfo(float).eps * squares[0]
        return np.asarray(1 / (2 * np.pi * np.sqrt(squares[there])))
    solve = (factor or factorised(stiffness)).solve
    squares = eigsh(
        stiffness,
        count,
        mass,
        sigma=0.0,
        OPinv=LinearOperator(stiffness.shape, matvec=solve, dtype=float),
        # Any start will do, but it must be the same every time and have no symmetry that a mode lacks.
        v0=np.random.default_rng(0).normal(size=size),
        return_eigenvectors=False,
    )
    if not squares.min() > 0:
        raise too_far_apart()
    return np.sort(np.sqrt(squares)) / (2 * np.pi)
