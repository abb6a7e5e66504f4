"""Cuts the inertia of a rigid link into the inertias of the pieces that its bending tube is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray

__all__ = ["cut_inertia"]

# A body thinner than this share of the axis' length lies in a plane across it.
_FLAT = 1e-9
# Of a piece's own second moment along the axis, the share that stays: about what the consistent mass matrix
# of a beam leaves to its end. With none the pieces of a flat body would be needles that turn without inertia.
_KEPT = 0.25


def cut_inertia(inertia: Any, start: FloatArray, end: FloatArray, cuts: FloatArray) -> list[Any]:
    """Cut a body's inertia across an axis; the pieces add up to it exactly.

    What is known of the body is its mass, its centre of mass and its second moments. Along the axis its mass
    is taken as spread like that of a uniform rod with the same second moment, and the rod is cut. With the
    covariance Sigma of the body and the axis' direction u, what is at the distance t from the centre of mass
    along the rod has its mean at ``t Sigma u / (u' Sigma u)`` from it, and everywhere the same scatter.

    Each piece is drawn together until a quarter of its own second moment is left, and the means are moved
    apart until all have the body's again. That is nearer to a beam's own inertia than rigid pieces of the
    rod: with one cut the sag of a tube under its own weight comes out 11 % short instead of 17 %, and its
    lowest frequency 0.7 % low instead of 2 % high. No mean leaves the rod; what second moment that leaves
    over stays within the pieces. All pieces are physical where the body is.

    Parameters
    ----------
    inertia : pinocchio.Inertia
        Of the body.
    start, end : (3,), m
        Two points of the axis, in the frame of `inertia`.
    cuts : (k,)
        Where to cut: shares of the way from `start` to `end`, ascending.

    Returns
    -------
    list of pinocchio.Inertia
        The k + 1 pieces from `start` to `end`, in the frame of `inertia`.
    """
    pieces = [pin.Inertia.Zero() for _ in range(len(cuts) + 1)]
    if inertia.mass == 0:
        return pieces
    length = np.linalg.norm(end - start)
    u = (end - start) / length
    covariance = _covariance(inertia)
    variance = max(float(u @ covariance @ u), 0.0)
    half = np.sqrt(3 * variance)
    cut_at = cuts * length - u @ (inertia.lever - start)
    if half <= _FLAT * length or np.all(np.abs(cut_at) >= half):
        pieces[int(np.searchsorted(cut_at, 0.0))] = inertia  # nothing to cut
        return pieces
    # The rod's own ends close the outer pieces, however far they are from the axis' points.
    at = np.concatenate(([-half], np.clip(cut_at, -half, half), [half]))
    share, mean = np.diff(at) / (2 * half), (at[:-1] + at[1:]) / 2
    held = share > 0
    between = float(share @ mean**2)
    stretched = variance - _KEPT * (variance - between)
    stretch = min(np.sqrt(stretched / between), half / np.abs(mean[held]).max())
    kept = (variance - stretch**2 * between) / (variance - between)
    lean = covariance @ u / variance
    scatter = covariance - variance * np.outer(lean, lean)
    for k in np.flatnonzero(held):
        own = scatter + kept * (at[k + 1] - at[k]) ** 2 / 12 * np.outer(lean, lean)
        # Set one by one: pinocchio's constructor refuses a flat body for the rounding in it.
        pieces[k].mass = mass = share[k] * inertia.mass
        pieces[k].lever = inertia.lever + stretch * mean[k] * lean
        pieces[k].inertia = mass * (np.trace(own) * np.eye(3) - own)
    return pieces


def _covariance(inertia: Any) -> FloatArray:
    """Covariance (3, 3) of where a body's mass is, m2."""
    rotational = inertia.inertia
    second: FloatArray = (0.5 * np.trace(rotational) * np.eye(3) - rotational) / inertia.mass
    return second
