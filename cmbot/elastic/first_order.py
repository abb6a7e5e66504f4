"""The elastic arm to first order about the rigid one, in batches: sag, modes and sway of many postures.

The elastic coordinates u are those of `ElasticArm`, with six of the base, displacements of O0 and rotations
about it, before them. At u = 0 each has a screw S_e; with the composite inertia I_e of all that it moves::

    M_ef = S_e . I_f S_f  (e before f),    loads Q_e = (I_e S_e) . (g, 0) + J_e . F,    tool J_e u_e

so that sag is ``J K^-1 Q`` and the modes are those of K and M. What is of second order in u is left out: that
weights move with what bends, and that they soften it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin

from cmbot.common.arrays import FloatArray, IntArray, cross
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.robot import Chain

BAND_HZ = (0.5, 30.0)
"""In which a response to a flat spectrum is stated, Hz: from 2 Hz on, a stance with a lower mode would
shine."""

# Postures at once, whose arrays fit into memory.
_AT_A_TIME = 2000
# Step of a joint for the gradient of sway, rad or m: where rounding and what is of second order are alike.
_GRADIENT_STEP = 1e-7
# A squared period, s2, below which a coordinate is taken to move no mass.
_LEAST_SQUARED_PERIOD = 1e-12


@dataclass(frozen=True, kw_only=True, eq=False)
class Bases:
    """What the arm stands on in N postures, in the axes of its base frame.

    Attributes
    ----------
    foot : (N, 3), m
        O0.
    stiffness : (N, 6, 6) or None
        At O0, linear then angular; None: rigid.
    carrier_mass : (N,), kg
        Of what moves with the base, and does not with the joints: a point mass.
    carrier_centre : (N, 3), m
    """

    foot: FloatArray
    stiffness: FloatArray | None
    carrier_mass: FloatArray
    carrier_centre: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class FirstOrderBatch:
    """An arm in N postures with f elastic coordinates; vectors in the axes of its base frame.

    Attributes
    ----------
    screw : (N, f, 6)
        Velocity at the origin, then rate of turning, by each coordinate.
    momentum : (N, f, 6)
        Of what it moves, then the moment of that momentum about the origin.
    tool : (N, 3), m
    root : (N, f, f)
        Lower triangular, ``root^T root`` the inverse of the stiffness.
    """

    screw: FloatArray
    momentum: FloatArray
    tool: FloatArray
    root: FloatArray

    @cached_property
    def lever(self) -> FloatArray:
        """Displacement of the tool (N, f, 3) by each coordinate."""
        v, w = self.screw[..., :3], self.screw[..., 3:]
        return np.asarray(v + cross(w, np.broadcast_to(self.tool[:, None], w.shape)))

    @cached_property
    def _modes(self) -> tuple[FloatArray, FloatArray]:
        """Angular frequencies (N, k), rad/s, ascending, and shapes (N, f, k) of modal mass 1."""
        v, w = self.screw[..., :3], self.screw[..., 3:]
        by_later = v @ self.momentum[..., :3].transpose(0, 2, 1) + w @ self.momentum[..., 3:].transpose(
            0, 2, 1
        )
        upper = np.triu(by_later)
        M = upper + np.triu(upper, 1).transpose(0, 2, 1)
        square, V = np.linalg.eigh(self.root @ M @ self.root.transpose(0, 2, 1))
        # Descending squared periods: the slowest mode first.
        square, V = square[:, ::-1], V[:, :, ::-1]
        period = np.sqrt(np.maximum(square, _LEAST_SQUARED_PERIOD))
        shapes = self.root.transpose(0, 2, 1) @ V / period[:, None]
        return 1 / period, np.where((square > _LEAST_SQUARED_PERIOD)[:, None], shapes, 0.0)

    @property
    def first_hz(self) -> FloatArray:
        """The slowest mode (N,), Hz."""
        return self._modes[0][:, 0] / (2 * np.pi)

    def shaken(self, damping: float, band: tuple[float, float]) -> FloatArray:
        """Return root mean squares (N,), m, of the tool in space by 1 m/s2 of the deck along each axis.

        Flat in a band, Hz: the modes answer as to white noise of that density. Those outside of the band
        count as well, so that the values are smooth; above it they add hardly anything.

        Parameters
        ----------
        damping : float
            Ratio of every mode.
        band : (float, float), Hz
        """
        omega, shapes = self._modes
        c = self.lever.transpose(0, 2, 1) @ shapes
        gain = self.momentum[..., :3].transpose(0, 2, 1) @ shapes
        a, b = omega[:, :, None], omega[:, None, :]
        # The integral over all frequencies of two modes' responses to white noise (Der Kiureghian, 1981).
        both = 4 * np.pi * damping * (a + b)
        both = both / ((a**2 - b**2) ** 2 + 4 * damping**2 * a * b * (a + b) ** 2)
        pairs = (c.transpose(0, 2, 1) @ c) * (gain.transpose(0, 2, 1) @ gain)
        density = 1 / (band[1] - band[0])
        return np.asarray(np.sqrt(np.maximum((pairs * both).sum(axis=(1, 2)), 0.0) * density / (4 * np.pi)))


@dataclass(frozen=True)
class _Body:
    """A rigid piece behind a driven joint, in the joint's frame."""

    mass: float
    centre: int  # number of its vector
    inertia: FloatArray  # (3, 3), about its centre


class FirstOrder:
    """Evaluates batches of postures of one arm.

    Parameters
    ----------
    arm : ElasticArm
        On a rigid base; its base frame is at the origin of W.
    """

    def __init__(self, arm: ElasticArm) -> None:
        model, data = arm.model, arm.model.createData()
        pin.forwardKinematics(model, data, np.zeros(model.nq), np.ones(model.nv))
        driven = (arm.driven + 1).tolist()
        vectors = [list[FloatArray]([*np.eye(3)]) for _ in driven]
        # Along the arm: pieces, and between them coordinates as their number, owner and vectors.
        self._along = list[tuple[int, _Body | None, tuple[int, int, bool] | None]]()
        order, owner = list[int](), -1
        for joint in range(1, model.njoints):
            if joint in driven:
                owner += 1
            X = data.oMi[driven[owner]].actInv(data.oMi[joint])
            coordinate = None
            if joint not in driven:
                S = np.asarray(data.joints[joint].S).reshape(6)
                slides = bool(np.any(S[:3]))
                axis = X.rotation @ (S[:3] if slides else S[3:])
                coordinate = (len(vectors[owner]), len(vectors[owner]) + 1, slides)
                vectors[owner] += [axis, np.array(X.translation)]
                order.append(joint - 1)
            body, piece = model.inertias[joint], None
            if body.mass > 0:
                turned = X.rotation @ body.inertia @ X.rotation.T
                piece = _Body(body.mass, len(vectors[owner]), turned)
                vectors[owner].append(np.array(X.act(body.lever)))
            self._along.append((owner, piece, coordinate))
        tool = model.frames[arm.tool_frame_id]
        X = data.oMi[driven[-1]].actInv(data.oMi[tool.parentJoint]) * tool.placement
        self._tool = len(vectors[-1])
        vectors[-1].append(np.array(X.translation))
        self._chain = Chain(arm.robot.model, [np.array(each) for each in vectors])
        self._coupling, self._fixed_tool = arm.robot.coupling, arm.robot.fixed_tool
        self.count = len(order)
        # The same order in which coordinates follow on each other along the arm.
        K = (
            arm.stiffness[np.ix_(*[np.searchsorted(np.sort(arm.elastic), order)] * 2)]
            if order
            else np.empty((0, 0))
        )
        self._soft = np.linalg.inv(np.linalg.cholesky(K)) if order else K

    def sag(
        self, q: FloatArray, bases: Bases, gravity: FloatArray, push: FloatArray | None = None
    ) -> FloatArray:
        """Return the displacements of the tool (N, 3), m, under gravity (N, 3) and forces on it (N, 3)."""
        parts = [np.empty((0, 3))]
        for k in range(0, len(q), _AT_A_TIME):
            some = slice(k, k + _AT_A_TIME)
            force = np.zeros_like(gravity[some]) if push is None else push[some]
            parts.append(self._sag(q[some], _some(bases, some), gravity[some], force))
        return np.concatenate(parts)

    def _sag(self, q: FloatArray, bases: Bases, gravity: FloatArray, push: FloatArray) -> FloatArray:
        places, tool = self._places(q)
        first: FloatArray = np.zeros_like(tool)
        mass, sag = 0.0, np.zeros_like(tool)
        loads, levers = list[FloatArray](), list[FloatArray]()
        for owner, piece, coordinate in reversed(self._along):
            p, turned = places[owner]
            if piece is not None:
                mass += piece.mass
                first = first + piece.mass * (p + turned[:, piece.centre])
            if coordinate is not None:
                axis, point, slides = turned[:, coordinate[0]], p + turned[:, coordinate[1]], coordinate[2]
                lever = axis if slides else cross(axis, tool - point)
                weight = mass * gravity if slides else cross(first - mass * point, gravity)
                loads.append((axis * weight).sum(axis=1) + (lever * push).sum(axis=1))
                levers.append(lever)
        if loads:
            bent = np.stack(loads[::-1], axis=1) @ (self._soft.T @ self._soft)
            sag = np.einsum("nf,fni->ni", bent, np.array(levers[::-1]))
        if bases.stiffness is not None:
            whole = mass + bases.carrier_mass
            first = first + bases.carrier_mass[:, None] * bases.carrier_centre
            away = tool - bases.foot
            about: FloatArray = first - whole[:, None] * bases.foot
            torque = cross(about, gravity) + cross(away, push)
            wrench = np.hstack([whole[:, None] * gravity + push, torque])
            moved = np.asarray(np.linalg.solve(bases.stiffness, wrench[:, :, None])[:, :, 0])
            turn: FloatArray = moved[:, 3:]
            sag = sag + moved[:, :3] + cross(turn, away)
        return np.asarray(sag)

    def _places(self, q: FloatArray) -> tuple[list[tuple[FloatArray, FloatArray]], FloatArray]:
        """Origin (N, 3) and vectors (N, k, 3) of what each joint moves, and the tool (N, 3).

        With a fixed tool, the point of the part that is there.
        """
        every = self._coupling.positions(q)
        places = [(p.T.copy(), turned.transpose(2, 0, 1)) for p, _, turned in self._chain.walk(every.T)]
        if self._fixed_tool is not None:
            return places, np.tile(self._fixed_tool.translation, (len(q), 1))
        return places, places[-1][0] + places[-1][1][:, self._tool]

    def at(self, q: FloatArray, bases: Bases) -> FirstOrderBatch:
        """Evaluate postures `q` (N, n), each on its base."""
        parts = [
            self._block(q[k : k + _AT_A_TIME], _some(bases, slice(k, k + _AT_A_TIME)))
            for k in range(0, len(q), _AT_A_TIME)
        ]
        f = self.count + (0 if bases.stiffness is None else 6)
        shapes = {"screw": (0, f, 6), "momentum": (0, f, 6), "tool": (0, 3), "root": (0, f, f)}
        return FirstOrderBatch(
            **{
                name: np.concatenate([np.empty(shape), *(getattr(part, name) for part in parts)])
                for name, shape in shapes.items()
            }
        )

    def _block(self, q: FloatArray, bases: Bases) -> FirstOrderBatch:
        N = len(q)
        places, tool = self._places(q)
        mass, first, about = np.zeros(N), np.zeros((N, 3)), np.zeros((N, 3, 3))
        screws, momenta = list[FloatArray](), list[FloatArray]()

        def add(m: FloatArray, centre: FloatArray, inertia: FloatArray) -> None:
            nonlocal mass, first, about
            mass = mass + m
            first = first + m[:, None] * centre
            square = (centre**2).sum(axis=1)[:, None, None] * np.eye(3)
            about = about + inertia + m[:, None, None] * (square - centre[:, :, None] * centre[:, None])

        def moved(v: FloatArray, w: FloatArray) -> None:
            screws.append(np.hstack([v, w]))
            momentum = mass[:, None] * v + cross(w, first)
            momenta.append(np.hstack([momentum, cross(first, v) + np.einsum("nij,nj->ni", about, w)]))

        for owner, piece, coordinate in reversed(self._along):
            p, turned = places[owner]
            if piece is not None:
                R = turned[:, :3].transpose(0, 2, 1)
                add(
                    np.full(N, piece.mass),
                    p + turned[:, piece.centre],
                    R @ piece.inertia @ R.transpose(0, 2, 1),
                )
            if coordinate is not None:
                axis, point, slides = turned[:, coordinate[0]], p + turned[:, coordinate[1]], coordinate[2]
                moved(axis, np.zeros_like(axis)) if slides else moved(cross(point, axis), axis)
        root = np.broadcast_to(self._soft, (N, self.count, self.count))
        if bases.stiffness is not None:
            add(bases.carrier_mass, bases.carrier_centre, np.zeros((N, 3, 3)))
            for axis in np.eye(3)[::-1]:
                turn = np.broadcast_to(axis, (N, 3))
                moved(cross(bases.foot, turn), turn)
            for axis in np.eye(3)[::-1]:
                moved(np.broadcast_to(axis, (N, 3)), np.zeros((N, 3)))
            arm, root = root, np.zeros((N, self.count + 6, self.count + 6))
            root[:, :6, :6] = np.linalg.inv(np.linalg.cholesky(bases.stiffness))
            root[:, 6:, 6:] = arm
        return FirstOrderBatch(
            screw=np.stack(screws[::-1], axis=1) if screws else np.empty((N, 0, 6)),
            momentum=np.stack(momenta[::-1], axis=1) if momenta else np.empty((N, 0, 6)),
            tool=tool,
            root=np.asarray(root),
        )


class StandingArm:
    """An arm to first order where it stands; mass of the guardrail that moves with the foot is left out.

    Parameters
    ----------
    arm : ElasticArm
    """

    def __init__(self, arm: ElasticArm) -> None:
        robot = arm.robot
        carrier = robot.model.inertias[0]
        self._first = FirstOrder(elastic_arm(robot, None, arm.options))
        self._gravity = arm.model.gravity.linear
        self._base = Bases(
            foot=np.array(robot.foot_point)[None],
            stiffness=None if arm.base is None else arm.base.stiffness[None],
            carrier_mass=np.array([carrier.mass]),
            carrier_centre=np.array(carrier.lever)[None],
        )

    def at(self, q: FloatArray) -> FirstOrderBatch:
        """Evaluate postures `q` (N, n)."""
        return self._first.at(q, self._bases(q))

    def sag(self, q: FloatArray) -> FloatArray:
        """Return the displacements of the tool (N, 3), m, by the weights alone, in postures `q` (N, n)."""
        return self._first.sag(q, self._bases(q), np.tile(self._gravity, (len(q), 1)))

    def _bases(self, q: FloatArray) -> Bases:
        return _some(self._base, np.zeros(len(q), dtype=np.intp))


class DeckSway:
    """How far an arm's tool sways by 1 m/s2 of its deck: a function of the posture alone.

    Parameters
    ----------
    arm : ElasticArm
        Where it stands.
    """

    def __init__(self, arm: ElasticArm) -> None:
        self._damping, self._arm = arm.robot.damping_ratio, StandingArm(arm)

    def values(self, q: FloatArray, above: float = -np.inf) -> FloatArray:
        """Return root mean squares (N,), m, in postures (N, n), as `FirstOrderBatch.shaken` has them.

        All are exact, whether `above` it or not.
        """
        return self._arm.at(q).shaken(self._damping, BAND_HZ)

    def __call__(self, q: FloatArray, /) -> tuple[FloatArray, FloatArray]:
        """Return them, and their gradients (N, n), by differences."""
        N, n = q.shape
        steps = _GRADIENT_STEP * np.vstack([np.zeros(n), np.eye(n)])
        value = self.values((q[:, None] + steps).reshape(-1, n)).reshape(N, n + 1)
        return value[:, 0], (value[:, 1:] - value[:, :1]) / _GRADIENT_STEP


def _some(bases: Bases, which: slice | IntArray) -> Bases:
    return Bases(
        foot=bases.foot[which],
        stiffness=None if bases.stiffness is None else bases.stiffness[which],
        carrier_mass=bases.carrier_mass[which],
        carrier_centre=bases.carrier_centre[which],
    )
