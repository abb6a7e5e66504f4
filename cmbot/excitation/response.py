"""How an arm whose joints are still answers when its base is shaken, or its links are pushed.

Relative to the deck, with the elastic coordinates u about their equilibrium, the acceleration a of the deck
(3,) and loads p (l,) of given distributions over the links::

    M u'' + D u' + K u = -B a + P p,        u = Phi eta,    Phi' M Phi = I
    eta_k'' + 2 zeta_k w_k eta_k' + w_k^2 eta_k = gamma_k' x,    x = (a, p),  gamma = Phi' [-B, P]

B are the loads on the elastic coordinates by an acceleration of the deck: those of a gravity that is turned
the other way, and the guardrail's mass at the foot. The tool moves by ``J u``; the wrench of the arm on what
it stands on is that of the springs of its modes, and of the mass that no mode moves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import expm
from scipy.signal import lfilter

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import shown
from cmbot.common.representation import ShortRepr
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.first_order import BAND_HZ
from cmbot.elastic.modes import arm_modes

AXES = 3
"""Inputs of every response: the deck's acceleration along x, y and z."""

# Points of the quadrature over frequency on either side of a mode, and how far the densest lie from it at
# most, as a share of its half-power bandwidth; points over the whole band. Variances are then within 2e-3.
_BESIDE_A_MODE, _DENSEST_BANDWIDTHS, _OVER_THE_BAND = 100, 0.05, 200

Loads = Callable[[ElasticArm, FloatArray], FloatArray]
Spectrum = Callable[[FloatArray], FloatArray]
"""One-sided spectral densities (F, m) of the inputs at frequencies (F,), Hz, unit^2/Hz; zero outside its
band."""


def flat_band(rms: float = 1.0, band: tuple[float, float] = BAND_HZ) -> Spectrum:
    """Return the flat spectrum of the deck's acceleration with `rms`, m/s2, along each axis in a band, Hz."""
    low, high = band
    level = rms**2 / (high - low)
    return lambda f: np.where((f >= low) & (f <= high), level, 0.0)[:, None] * np.ones(AXES)


def linear_spectrum(rows: FloatArray) -> Spectrum:
    """Return the spectrum through `rows` (K, 1 + m) of a frequency, Hz, and densities; linear between."""
    f, levels = rows[:, 0], rows[:, 1:]
    return lambda at: np.stack([np.interp(at, f, level, left=0.0, right=0.0) for level in levels.T], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Moments(ShortRepr):
    """Second moments of stationary outputs y and of their rates.

    Attributes
    ----------
    value : (d, d)
        Covariance of y.
    rate : (d, d)
        Covariance of the rates.
    cross : (d, d)
        Of the rates with y, ``E[y' y^T]``: skew.
    first : (d, d)
        Of first order: the integral of ``2 pi f S(f)``, as value is that of ``S(f)``.
    """

    value: FloatArray
    rate: FloatArray
    cross: FloatArray
    first: FloatArray

    def along(self, rows: FloatArray) -> Moments:
        """Return those of ``rows @ y``, rows (k, d)."""
        parts = (self.value, self.rate, self.cross, self.first)
        value, rate, cross, first = (rows @ part @ rows.T for part in parts)
        return Moments(value=value, rate=rate, cross=cross, first=first)


@dataclass(frozen=True, kw_only=True)
class TunedDamper:
    """A mass, kg, on springs that are alike in all directions: its frequency, Hz, and damping ratio."""

    mass: float
    frequency: float
    damping: float

    def dynamic_mass(self, f: FloatArray) -> FloatArray:
        """Return the force by which it resists an acceleration of its place (F,), N per m/s2, complex."""
        r = f / self.frequency
        yields = 1 + 2j * self.damping * r
        return np.asarray(self.mass * yields / (yields - r**2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Undamped:
    """Transfer functions of an arm without damper at frequencies `f` (F,), Hz.

    Of d outputs by m inputs (F, d, m) and by a force at the damper's place (F, d, 3), and of that place's
    displacement, m, by both.
    """

    f: FloatArray
    by_inputs: FloatArray
    by_force: FloatArray
    place_by_inputs: FloatArray
    place_by_force: FloatArray

    def damped(self, damper: TunedDamper | None) -> FloatArray:
        """Return those of the outputs by the inputs (F, d, m) with a damper; without one as they are."""
        if damper is None:
            return self.by_inputs
        # F = -m(f) (a - w^2 x), x = place_by_inputs a + place_by_force F.
        w2, resists = (2 * np.pi * self.f) ** 2, damper.dynamic_mass(self.f)[:, None, None]
        shaken = np.eye(AXES, self.by_inputs.shape[2]) - w2[:, None, None] * self.place_by_inputs
        yields = np.eye(AXES) - resists * w2[:, None, None] * self.place_by_force
        return np.asarray(self.by_inputs + self.by_force @ np.linalg.solve(yields, -resists * shaken))


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalResponse(ShortRepr):
    """An arm in one posture as its modes; nine outputs: of the tool and of the wrench; m inputs.

    Attributes
    ----------
    frequencies : (k,), Hz
        Ascending.
    damping : (k,)
        Ratios, above zero.
    gain : (k, m)
        Modal force by each input: the deck's acceleration along x, y, z, then loads.
    tool : (3, k)
        Displacement of the tool point, m, by each mode, in W.
    wrench : (6, k)
        Wrench on what the arm stands on, N and Nm, about O0 in W, by each mode, of its spring.
    direct : (6, m)
        What the inputs add to the wrench, by the mass that no mode moves.
    place : (3, k)
        Displacement, m, of the damper's place by each mode.
    place_direct : (6, 3)
        What a force at that place adds to the wrench, as `direct`.
    axis : (3,)
        Of the tool, in W.
    shapes, momenta : (f, k)
        Of the modes in the elastic coordinates, and the mass matrix times them.
    damper : TunedDamper or None
    """

    frequencies: FloatArray
    damping: FloatArray
    gain: FloatArray
    tool: FloatArray
    wrench: FloatArray
    direct: FloatArray
    place: FloatArray
    place_direct: FloatArray
    axis: FloatArray
    shapes: FloatArray
    momenta: FloatArray
    damper: TunedDamper | None = None

    @cached_property
    def outputs(self) -> FloatArray:
        """Of each mode (9, k): the tool's displacement, then the wrench."""
        return np.vstack([self.tool, self.wrench])

    def transfer(self, f: FloatArray) -> FloatArray:
        """Return the transfer functions (F, 9, m) at frequencies `f` (F,), Hz."""
        return self.undamped(f).damped(self.damper)

    def undamped(self, f: FloatArray, outputs: int = 9) -> Undamped:
        """Return what makes the transfer functions of the first outputs, with a damper or without."""
        squares = self.frequencies**2 - f[:, None] ** 2
        H = 1 / ((2 * np.pi) ** 2 * (squares + 2j * self.damping * self.frequencies * f[:, None]))

        def through(rows: FloatArray, columns: FloatArray) -> FloatArray:
            pairs = rows[:, None, :] * columns.T
            return (H @ pairs.reshape(-1, len(self.frequencies)).T).reshape(len(f), len(rows), -1)

        rows, P = self.outputs[:outputs], self.place
        by_inputs, by_force = through(rows, self.gain), through(rows, P.T)
        by_inputs[:, AXES:] += self.direct[: outputs - AXES]
        by_force[:, AXES:] += self.place_direct[: outputs - AXES]
        return Undamped(
            f=f,
            by_inputs=by_inputs,
            by_force=by_force,
            place_by_inputs=through(P, self.gain),
            place_by_force=through(P, P.T),
        )

    def static(self, load: FloatArray) -> FloatArray:
        """Return the outputs (..., 9) under inputs `load` (..., m) that do not change."""
        eta = load @ self.gain.T / (2 * np.pi * self.frequencies) ** 2
        still = eta @ self.outputs.T
        still[..., 3:] += load @ self.direct.T
        return np.asarray(still)

    def moments(self, spectrum: Spectrum, band: tuple[float, float]) -> Moments:
        """Return the moments of the outputs under inputs that are independent, Gaussian and stationary.

        Parameters
        ----------
        spectrum : callable
            One-sided densities of the m inputs, zero outside the band.
        band : (float, float), Hz
        """
        f, weight = self.quadrature(band)
        Y, S, w = self.transfer(f), spectrum(f) * weight[:, None], 2 * np.pi * f

        def integral(factor: FloatArray | float) -> FloatArray:
            left = (Y * (S * factor)[:, None]).transpose(1, 0, 2).reshape(Y.shape[1], -1)
            return np.asarray(left @ Y.conj().transpose(0, 2, 1).reshape(-1, Y.shape[1]))

        first = integral(w[:, None])
        return Moments(
            value=integral(1.0).real, rate=integral(w[:, None] ** 2).real, cross=-first.imag, first=first.real
        )

    def tool_variance(self, spectrum: Spectrum, band: tuple[float, float]) -> float:
        """Return the variance of the tool's displacement in space, m2, as `moments` has it."""
        f, weight = self.quadrature(band)
        Y = self.undamped(f, AXES).damped(self.damper)
        return float(((np.abs(Y) ** 2).sum(axis=1) * spectrum(f) * weight[:, None]).sum())

    def quadrature(self, band: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
        """Return frequencies (F,), Hz, dense about each mode, and their weights by the trapezoidal rule."""
        frequencies, damping = self.frequencies, self.damping
        if self.damper is not None:
            frequencies = np.append(frequencies, self.damper.frequency)
            damping = np.append(damping, self.damper.damping)
        f = _nodes(frequencies, damping, *band)
        half = np.diff(f) / 2
        return f, np.append(half, 0.0) + np.append(0.0, half)

    def history(self, inputs: FloatArray, step: float) -> FloatArray:
        """Return the outputs (N, 9) from rest under `inputs` (N, m) every `step` s, linear in between.

        They rise to the first ones from zero a step before.

        Without a damper each mode is integrated exactly (Nigam and Jennings, 1969); with one the transfer
        functions are used, the inputs followed by as much silence.
        """
        if self.damper is not None:
            count = 2 * len(inputs)
            Y = self.transfer(np.arange(count // 2 + 1) / (count * step))
            spectra = np.einsum("fdm,fm->fd", Y, np.fft.rfft(inputs, count, axis=0))
            return np.asarray(np.fft.irfft(spectra, count, axis=0)[: len(inputs)])
        forces = inputs @ self.gain.T
        eta = np.empty_like(forces)
        for k, (f, zeta) in enumerate(zip(self.frequencies, self.damping, strict=True)):
            b, a = _exact_filter(2 * np.pi * f, zeta, step)
            eta[:, k] = lfilter(b, a, forces[:, k])
        out = eta @ self.outputs.T
        out[:, 3:] += inputs @ self.direct.T
        return np.asarray(out)


def modal_response(
    arm: ElasticArm, q: FloatArray, damping: float, loads: Sequence[Loads] = (), place: str = "tool"
) -> ModalResponse:
    """Return how an arm in posture `q` (n,) answers.

    Parameters
    ----------
    arm : ElasticArm
    q : (n,), rad and m
    damping : float
        Ratio of every mode, above zero; what joints and base damp of their own comes on top.
    loads : sequence of callable
        More inputs: for each the generalised forces, and the wrench about O0, (nv + 6,), by the arm and its
        configuration.
    place : str
        Of a damper: ``tool``, ``arm_base`` or the name of a joint.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself.
    """
    modes = arm_modes(arm, q)
    model, data, Phi = arm.model, arm.model.createData(), modes.shapes
    configuration = arm.configuration(q, modes.u)
    own = np.einsum("fk,fg,gk->k", Phi, arm.damping, Phi) / (4 * np.pi * modes.frequencies)
    # The wrench of the moving masses: their momentum by the rates, moved to O0.
    pin.computeCentroidalMap(model, data, configuration)
    com = data.com[0] - np.array(arm.robot.foot_point)
    momentum = np.array(data.Ag)
    momentum[3:] += np.cross(com, momentum[:3], axis=0)
    momentum = momentum[:, arm.elastic] @ Phi
    rigid = _rigid(pin.computeTotalMass(model), com)
    if arm.base is None:  # else the model has it
        carrier = arm.robot.model.inertias[0]
        rigid += _rigid(carrier.mass, carrier.lever - np.array(arm.robot.foot_point))
    gain, direct = -Phi.T @ ground_loads(arm, configuration), -rigid
    for load in loads:
        added = load(arm, configuration)[:, None]
        gain = np.hstack([gain, Phi.T @ added[arm.elastic]])
        direct = np.hstack([direct, added[model.nv :]])
    J, X_WT = _jacobian(arm, data, configuration, "tool")
    J_place, X_WP = _jacobian(arm, data, configuration, place)
    held = np.vstack([np.eye(3), np.cross(X_WP.translation - np.array(arm.robot.foot_point), np.eye(3)).T])
    # W = loads - rigid a - momentum eta'', with eta'' = gain x - w^2 eta.
    return ModalResponse(
        frequencies=modes.frequencies,
        damping=damping + own,
        gain=gain,
        tool=J @ Phi,
        wrench=momentum * (2 * np.pi * modes.frequencies) ** 2,
        direct=direct - momentum @ gain,
        place=J_place @ Phi,
        place_direct=held - momentum @ (J_place @ Phi).T,
        axis=np.array(X_WT.rotation[:, 2]),
        shapes=Phi,
        momenta=modes.mass @ Phi,
    )


def ground_loads(arm: ElasticArm, configuration: FloatArray) -> FloatArray:
    """Return B (f, 3): forces on the elastic coordinates that hold an arm still on an accelerated deck."""
    model, data = arm.model.copy(), arm.model.createData()
    B = np.empty((len(arm.elastic), AXES))
    for axis in range(AXES):
        model.gravity.linear = -np.eye(3)[axis]
        B[:, axis] = pin.computeGeneralizedGravity(model, data, configuration)[arm.elastic]
    if arm.base is not None:
        B[arm.springs["base", ""]] += arm.base.mass[:, :AXES]
    return B


def _rigid(mass: float, lever: FloatArray) -> FloatArray:
    """Rate of the momentum about O0 (6, 3) of a mass by the acceleration of the deck."""
    return mass * np.vstack([np.eye(3), np.cross(lever, np.eye(3)).T])


def _jacobian(arm: ElasticArm, data: Any, configuration: FloatArray, place: str) -> tuple[FloatArray, Any]:
    """Jacobian (3, f) of a place of the bent arm by the elastic coordinates, and its pose."""
    model = arm.model
    if place == "tool":
        pose, J = arm.tool_jacobian(configuration, data)
    else:
        names = require_place(place, arm.robot.joints)
        joint = model.getJointId(names[0] if place == "arm_base" else place)
        pin.computeJointJacobians(model, data, configuration)
        J = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        pose = data.oMi[joint]
    return np.asarray(J.reshape(6, model.nv)[:3, arm.elastic]), pose


def require_place(place: str, joints: tuple[str, ...], source: str = "damper") -> tuple[str, ...]:
    """Return the names of an arm's joints; an `InputError` for a damper's place that is none on it."""
    places = ("tool", "arm_base", *joints)
    if place not in places:
        raise InputError(source, "damper.at", shown(place), "a place on the arm", places)
    return joints


def _nodes(frequencies: FloatArray, damping: FloatArray, low: float, high: float) -> FloatArray:
    """Frequencies of a quadrature: dense about each mode, by its bandwidth."""
    span = np.linspace(0.0, 1.0, _BESIDE_A_MODE + 1)[1:]
    inside = (frequencies > low) & (frequencies < high)
    each = [np.geomspace(max(low, 1e-3), high, _OVER_THE_BAND)]
    for f, zeta in zip(frequencies[inside], damping[inside], strict=True):
        width = zeta * f
        reach = np.arcsinh(f / (_DENSEST_BANDWIDTHS * width))
        away = _DENSEST_BANDWIDTHS * width * np.sinh(span * reach)
        each += [f - away, f + away, np.array([f])]
    joined = np.unique(np.concatenate([*each, [low, high]]))
    return joined[(joined >= low) & (joined <= high)]


def _exact_filter(w: float, zeta: float, h: float) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the filter from a force, linear between steps of `h`, to a mode's displacement."""
    # Displacement, rate, the force before, and by how much the one after is more.
    rates = np.array([[0.0, h, 0, 0], [-(w**2) * h, -2 * zeta * w * h, h, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    E = expm(rates)
    A, before, after = E[:2, :2], E[:2, 2] - E[:2, 3], E[:2, 3]
    # From state space to a difference equation, by Cayley and Hamilton.
    trace = float(np.trace(A))
    b = [after[0], before[0] + (A @ after)[0] - trace * after[0], (A @ before)[0] - trace * before[0]]
    return np.array(b), np.array([1.0, -trace, float(np.linalg.det(A))])
