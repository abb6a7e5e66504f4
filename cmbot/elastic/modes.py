"""Small vibrations of the arm about its static equilibrium: matrices, natural frequencies, modal damping."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import pinocchio as pin
from scipy import linalg

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.elastic.stiffness_parameters import StiffnessParameters

# Share of the largest squared period below which a squared period is rounding: its coordinate has no mass.
_MASSLESS_SHARE = 1e-13
# Modes whose logarithms of frequencies differ by less may mix.
MIXED_MODES_LOG = 0.08


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearised:
    """Small motions of an arm about its static equilibria in N postures."""

    u: FloatArray  # (N, f), m and rad: the equilibria
    mass: FloatArray  # (N, f, f), of the elastic coordinates, with the guardrail's; symmetric
    stiffness: FloatArray  # (N, f, f), with the geometric stiffness of the loads: its symmetric part
    coupling: FloatArray  # (N, f, n): forces on the elastic coordinates by the joints' accelerations
    weight: FloatArray  # (N, f, n), derivative of the loads there with respect to the joint angles
    lever: FloatArray  # (N, 3, f): displacement of the tool point by the elastic coordinates, in W

    @cached_property
    def sag_slope(self) -> FloatArray:
        """Derivative (N, f, n) of the equilibria by the joint angles: the implicit function theorem."""
        return np.asarray(-np.linalg.solve(self.stiffness, self.weight))

    @property
    def yielding(self) -> FloatArray:
        """Displacement (N, 3, n) of the tool by the joints' accelerations, where these change slowly."""
        forces = self.coupling + self.mass @ self.sag_slope
        return np.asarray(-self.lever @ np.linalg.solve(self.stiffness, forces))


def linearised(arm: ElasticArm, q: FloatArray) -> Linearised:
    """Linearise an arm about its equilibria in postures `q` (N, n), rad; errors as `Sag.equilibria`.

    A force that turns with the tool has no potential: what it adds to the stiffness is not symmetric. Its
    skew part, which moves no frequency to first order, is left out.
    """
    u, tangent, weight = Sag(arm).equilibria(q)
    data = arm.model.createData()
    mass, lever = np.empty((len(q), arm.model.nv, arm.model.nv)), np.empty((len(q), 3, len(arm.elastic)))
    for k, configuration in enumerate(arm.configuration(q, u)):
        mass[k] = pin.crba(arm.model, data, configuration)
        lever[k] = arm.tool_jacobian(configuration, data)[1][:3, arm.elastic]
    rows = (np.triu(mass) + np.triu(mass, 1).transpose(0, 2, 1))[:, arm.elastic]
    M, coupling = rows[:, :, arm.elastic] + arm.added_mass, arm.by_joints(rows)
    K = (tangent + tangent.transpose(0, 2, 1)) / 2
    return Linearised(u=u, mass=M, stiffness=K, coupling=coupling, weight=weight, lever=lever)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmModes:
    """Natural modes of an arm about its static equilibrium, the joints held still."""

    frequencies: FloatArray  # (k,), Hz, ascending; fewer than f where some coordinates move no mass
    shapes: FloatArray  # (f, k): modes in the elastic coordinates, m and rad, of modal mass 1 kg m2
    u: FloatArray  # (f,), m and rad: the equilibrium
    mass: FloatArray  # (f, f), as that of `Linearised`
    stiffness: FloatArray  # (f, f)

    def damping(self, ratio: float) -> FloatArray:
        """Return the damping matrix (f, f) that gives every mode the same damping ratio, zero or more.

        ``D = M Phi diag(2 ratio omega) Phi' M`` with the shapes Phi and the angular frequencies omega.
        """
        if not (math.isfinite(ratio) and ratio >= 0):
            raise InputError("ArmModes.damping", "ratio", ratio, "a number that is not negative")
        momenta = self.mass @ self.shapes
        return np.asarray((momenta * (4 * np.pi * ratio * self.frequencies)) @ momenta.T)


def arm_modes(arm: ElasticArm, q: FloatArray) -> ArmModes:
    """Find the modes of an arm in posture `q` (n,), rad; errors as `Sag.equilibria`."""
    at = linearised(arm, q[None])
    M, K = at.mass[0], at.stiffness[0]
    omega, shapes = normal_modes(M, K)
    return ArmModes(frequencies=omega / (2 * np.pi), shapes=shapes, u=at.u[0], mass=M, stiffness=K)


def normal_modes(mass: FloatArray, stiffness: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return angular frequencies (k,), rad/s, the slowest first, and shapes (f, k) of unit modal mass.

    The mass (f, f) may be singular, the stiffness not: of what has no mass there is no mode.
    """
    # The roles of mass and stiffness are exchanged: eigenvalues 1/omega^2.
    squares, X = linalg.eigh(mass, stiffness)
    squares, X = squares[::-1], X[:, ::-1]
    moving = squares > _MASSLESS_SHARE * squares.max(initial=0.0)
    squares, X = squares[moving], X[:, moving]
    return 1 / np.sqrt(squares), X / np.sqrt(squares)


def frequency_slopes(
    arm: ElasticArm,
    parameters: StiffnessParameters,
    at: FloatArray,
    q: FloatArray,
    shapes: FloatArray,
    mixed: float = MIXED_MODES_LOG,
) -> tuple[FloatArray, FloatArray]:
    """Return logarithms (k,) of natural frequencies, Hz, in posture `q` (n,), and slopes (k, p).

    At parameters `at` (p,), of the modes whose shapes were those of `shapes` (f, k) at others:
    ``d ln f = phi' dK phi / (2 omega^2)``. Modes whose logarithms are less than `mixed` apart are taken
    together, as the combination that is nearest to a shape.
    """
    modes = arm_modes(replace(arm, stiffness=parameters.stiffness(at)), q)
    log = np.log(modes.frequencies)
    share = shapes.T @ modes.mass @ modes.shapes  # (k, modes)
    nearest = np.abs(share).argmax(axis=1)
    share = np.where(np.abs(log - log[nearest, None]) < mixed, share, 0.0)
    share /= np.linalg.norm(share, axis=1)[:, None]
    squares = share**2 @ modes.frequencies**2
    own = share @ modes.shapes.T
    lost = np.einsum("kf,kfp->kp", own, parameters.relaxation(own, at))
    return np.log(squares) / 2, -lost / (2 * (2 * np.pi) ** 2 * squares[:, None])


def newmark(
    mass: FloatArray,
    damping: FloatArray,
    stiffness: FloatArray,
    loads: FloatArray,
    interval: IntArray,
    step: float,
    start: FloatArray | float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Integrate ``M w'' + D w' + K w = f(t)`` from rest, by constant mean acceleration (Newmark, 1959).

    The matrices hold for an interval of time each.

    Parameters
    ----------
    mass, damping, stiffness : (I, F, f, f)
        M, D and K in I intervals, for F cases; each may be broadcast over these.
    loads : (N + 1, C, f)
        C loads f on all cases, at times that are a step apart.
    interval : (N + 1, C)
        Number of the interval in which each load is at each time.
    step : float, s
    start : (C, F, f), optional
        w at the first time, at rest; left out: zero. Loads count from the second time on.

    Returns
    -------
    w : (N + 1, C, F, f)
        At all times.
    v : (C, F, f)
        w' at the last one.
    """
    h, (times, number, size) = step, loads.shape
    inverse = h * h * np.linalg.inv(mass + 0.5 * h * damping + 0.25 * h * h * stiffness)
    by_state = inverse @ np.concatenate([stiffness, np.broadcast_to(damping / h, stiffness.shape)], axis=3)
    # What w and h w' are predicted to be, with which h^2 w'' and the next prediction are linear.
    x = np.zeros((times + 1, number, inverse.shape[1], 2, size))
    states, w, v = x.reshape(*x.shape[:3], -1, 1), x[..., 0, :], x[..., 1, :]
    w[:2] = start
    changes = np.flatnonzero((interval[2:] != interval[1:-1]).any(axis=1)) + 2
    for begin, end in pairwise([1, *changes.tolist(), times]):
        resists = by_state[interval[begin]]
        v[begin + 1 : end + 1] = (inverse[interval[begin]] @ loads[begin:end, :, None, :, None])[..., 0]
        for k in range(begin, end):
            v[k + 1] += v[k] - (resists @ states[k])[..., 0]
            np.add(w[k], v[k + 1], out=w[k + 1])
    return w[:-1] + 0.25 * np.diff(v, axis=0), (0.5 / h) * (v[-1] + v[-2])
