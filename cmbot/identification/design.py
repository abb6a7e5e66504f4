"""Which postures to measure in: those after which the sag along a job is known best.

The design is V-optimal: of all sets of postures that are tried, the one with the least mean variance of the
sag along the job, ``min trace(W Sigma)``: greedily, by exchanges, and by moving each of them a little. It is
the design for the modelled stiffness, and its promise that of the linearised problem there.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.identification.estimation import whitener
from cmbot.identification.measurements import MeasuringSetup
from cmbot.identification.model import DeflectionModel, SagAlong, measured_arm, prior_deviations, sag_along
from cmbot.planning import Plan, QuinticTrajectory, build_context, follow_path, starting_at_path
from cmbot.robot import Dynamics
from cmbot.scene import Scene

__all__ = ["Proposal", "job_postures", "propose"]

# Postures that are chosen from, random ones that are tried for them, and how many at a time.
_CANDIDATES, _MOST_TRIED, _AT_ONCE = 800, 40_000, 2000
# Postures of a job.
_OF_JOB = 25
# Lag of the tool behind its path, m, beyond which a joint path does not follow it.
_LOST = 0.01
# Rounds of exchanges at most, and the least share by which one lowers the variance.
_ROUNDS, _GAIN = 20, 1e-4
_FULL_TURN = np.pi
# Postures that are tried about each that was chosen, and how far away, rad, round by round.
_NEAR, _REFINED = 30, (0.5, 0.3, 0.15, 0.1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal:
    """Postures to measure in.

    Attributes
    ----------
    scene : Scene
    setup : MeasuringSetup
    q : (N, n), rad and m
    seen : (3,) of bool
        Which components of the deflection are to be measured.
    deflection : (N, 3), m
        About what is to be expected.
    before, after : SagAlong
        The sag along the job: as modelled, and how exact it will be.
    job : (M, n), rad and m
    candidates : int
        Number of postures that these were chosen from.
    """

    scene: Scene
    setup: MeasuringSetup
    q: FloatArray
    seen: BoolArray
    deflection: FloatArray
    before: SagAlong
    after: SagAlong
    job: FloatArray
    candidates: int

    def sheet(self, scene: str) -> str:
        """Return a file of measurements to fill in; `scene` is how it names the scene."""
        slides = measured_arm(self.scene).robot.limits.prismatic.any()
        lines = [
            "# Hang the weight on the tool in each posture: deflection_mm is how far the tool point moves",
            "# along x, y, z of the world frame; null: not measured. Then: cmbot identify THIS_FILE",
            "format: cmbot-measurements/1",
            f"scene: {json.dumps(scene)}",
            *(
                f"{name}: {json.dumps(value)}"
                for name, value in self.setup.model_dump(
                    mode="json", include=set(MeasuringSetup.model_fields)
                ).items()
            ),
            "measurements:",
        ]
        for q, d in zip(self.q, self.deflection, strict=True):
            rows = np.round(q if slides else np.degrees(q), 4 if slides else 2).tolist()
            about = ", ".join(f"{1e3 * x:.2f}" for x in d)
            lines.append(f"  - {'posture' if slides else 'posture_deg'}: {rows}")
            lines.append(f"    deflection_mm: [null, null, null]  # about {about}")
        lines.append("job:  # where the sag is wanted, rad and m")
        lines += [f"  - {np.round(row, 5).tolist()}" for row in self.job]
        return "\n".join(lines) + "\n"


def job_postures(job: Scene | Plan) -> FloatArray:
    """Return postures (M, n) along a job: a plan's, or of a scene those that follow the tool path.

    The latter need not be clear of obstacles.

    Raises
    ------
    InputError
        When a tool path of a scene cannot be followed.
    PathNotFound
        When no posture is found in which one begins.
    """
    if isinstance(job, Plan):
        each = [segment.trajectory.evaluate(_spread(segment.trajectory)) for segment in job.job.strokes]
    else:
        each = list(_followed(job))
    q = np.concatenate(each)
    return np.asarray(q[np.unique(np.linspace(0, len(q) - 1, _OF_JOB).round().astype(int))])


def _spread(trajectory: QuinticTrajectory) -> FloatArray:
    return np.linspace(trajectory.t[0], trajectory.t[-1], _OF_JOB)


def _followed(scene: Scene) -> Iterator[FloatArray]:
    """Postures along each stroke, by gradient projection from where the one before ends."""
    context = build_context(scene, scene.planner)
    reached = context.posture
    for number in range(len(context.strokes)):
        context = context.at_stroke(number, scene, reached, 0.0, 0.0)
        if context.stroke.begins_elsewhere:
            context = starting_at_path(context)
        found = follow_path(context, stop_at_obstacles=False)
        if not (off := float(found.drift.max())) <= _LOST:
            got = f"a path that gradient projection leaves by {off:.2f} m"
            raise InputError(scene.source, context.stroke.key, got, "a plan of it in its place: --job DIR")
        reached = found.q[-1]
        yield found.q


def propose(
    scene: Scene,
    number: int,
    job: FloatArray,
    setup: MeasuringSetup | None = None,
    *,
    axes: str = "xyz",
    seed: int = 0,
) -> Proposal:
    """Propose postures in which measuring tells most of the sag along a job.

    They are clear of everything by the scene's safety margin, and all joints can hold them with the weight.

    Parameters
    ----------
    scene : Scene
        Robot and base.
    number : int
        Of postures.
    job : (M, n), rad and m
        From `job_postures`.
    setup : MeasuringSetup, optional
    axes : str
        Components of the deflection that are measured, of ``xyz``.
    seed : int
        Of the random postures that are chosen from.

    Raises
    ------
    InputError
        When `number` or `axes` is wrong, or no posture can be held with the weight.
    """
    if not 1 <= number <= _CANDIDATES:
        raise InputError("propose", "number", number, f"1 to {_CANDIDATES} postures")
    if not axes or set(axes) - set("xyz"):
        raise InputError("propose", "axes", repr(axes), "letters of xyz")
    setup = setup or MeasuringSetup()
    seen = np.array([axis in axes for axis in "xyz"])
    rng, tell = np.random.default_rng(seed), _Telling(scene, setup, seen, job)
    pool = tell.clear(tell.random(rng))
    if len(pool) < number:
        expected = f"{number} or more: a smaller safety margin, or less weight"
        raise InputError("propose", "number", f"{len(pool)} clear postures", expected)
    G = tell.rows(pool)
    chosen = _exchanged(G, tell.W, _greedy(G, tell.W, number))
    count = len(pool)
    for size in _REFINED:
        best, near = pool[chosen], tell.clear(tell.near(rng, pool[chosen], size))
        count += len(near)
        pool = np.concatenate([best, near])
        G = np.concatenate([G[chosen], tell.rows(near)]) if len(near) else G[chosen]
        chosen = _exchanged(G, tell.W, list(range(number)))
    after = sag_along(tell.arm, tell.covariance(_covariance(G, chosen)), job)
    q = pool[[chosen[k] for k in _in_a_row(pool[chosen], np.array(scene.posture))]]
    return Proposal(
        scene=scene,
        setup=setup,
        q=q,
        seen=seen,
        deflection=tell.deflection(q),
        before=tell.before,
        after=after,
        job=job,
        candidates=count,
    )


class _Telling:
    """Which postures can be measured in, and what each would tell of the sag along a job."""

    def __init__(self, scene: Scene, setup: MeasuringSetup, seen: BoolArray, job: FloatArray) -> None:
        self._scene, self._setup, self._seen = scene, setup, seen
        self.arm = measured_arm(scene)
        self._robot = measured_arm(scene, setup.weight_kg).robot
        self._dynamics, self._clearances = Dynamics(self._robot), Clearances(self._robot, scene.obstacles)
        self._prior = prior_deviations(StiffnessParameters(self.arm), setup.prior)
        self.before = sag_along(self.arm, np.diag(self._prior**2), job)
        # Unknowns in units of their priors; the last is the error of the weight.
        self.W = np.zeros((len(self._prior) + 1, len(self._prior) + 1))
        self.W[:-1, :-1] = self.before.weight * np.outer(self._prior, self._prior)

    def covariance(self, scaled: FloatArray) -> FloatArray:
        """Of the parameters (p, p), from that of the unknowns."""
        return scaled[:-1, :-1] * np.outer(self._prior, self._prior)

    def random(self, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Random postures within the joint ranges, a few at a time."""
        limits = self._robot.limits
        half = np.where(limits.prismatic, limits.range_half, np.minimum(limits.range_half, _FULL_TURN))
        for _ in range(_MOST_TRIED // _AT_ONCE):
            yield limits.range_middle + half * rng.uniform(-1, 1, (_AT_ONCE, self._robot.dof))

    def near(self, rng: np.random.Generator, q: FloatArray, size: float) -> Iterator[FloatArray]:
        """Random postures about others, `size`, rad, away."""
        limits = self._robot.limits
        moved = self._robot.metric.positions(size * rng.standard_normal((_NEAR, *q.shape)))
        low, high = limits.range_middle - limits.range_half, limits.range_middle + limits.range_half
        yield np.clip(q + moved, low, high).reshape(-1, q.shape[1])

    def clear(self, batches: Iterable[FloatArray]) -> FloatArray:
        """Those of some postures that are clear and that the joints can hold with the weight."""
        found, limits = list[FloatArray](), self._robot.limits
        for q in batches:
            torque = self._dynamics.static_efforts(q).joint_torque
            held = q[(np.abs(torque) <= limits.torque).all(axis=1)]
            if len(held):
                distance = self._clearances.smallest(held).distance
                found.append(held[distance >= self._scene.planner.safety_margin_m])
            if sum(map(len, found)) >= _CANDIDATES:
                break
        return np.concatenate(found)[:_CANDIDATES] if found else np.zeros((0, self._robot.dof))

    def deflection(self, q: FloatArray) -> FloatArray:
        """What is to be expected, (N, 3), m."""
        return DeflectionModel(self.arm, self._setup, q).at(np.zeros(len(self._prior)))[0]

    def rows(self, q: FloatArray) -> FloatArray:
        """Derivatives (N, k, p + 1) of what is measured by the unknowns, in units of its noise."""
        model = DeflectionModel(self.arm, self._setup, q)
        deflection, slope = model.at(np.zeros(len(self._prior)))
        # A deflection is nearly proportional to the weight.
        by_weight = deflection[:, :, None] * (self._setup.weight_sd_kg / self._setup.weight_kg)
        whole = np.concatenate([slope * self._prior, by_weight], axis=2)
        each = zip(model.noise, whole, strict=True)
        return np.stack([whitener(noise, self._seen) @ one for noise, one in each])


def _covariance(G: FloatArray, chosen: list[int]) -> FloatArray:
    """Covariance of the unknowns, in units of their priors, after measuring in some postures."""
    rows = G[chosen].reshape(-1, G.shape[2])
    return np.asarray(np.linalg.inv(np.eye(G.shape[2]) + rows.T @ rows))


def _gains(G: FloatArray, W: FloatArray, Sigma: FloatArray) -> FloatArray:
    """By how much each posture (C,) lowers trace(W Sigma)."""
    A = G @ Sigma
    S = np.eye(G.shape[1]) + A @ G.transpose(0, 2, 1)
    return np.asarray(np.trace(np.linalg.solve(S, A @ W @ A.transpose(0, 2, 1)), axis1=1, axis2=2))


def _greedy(G: FloatArray, W: FloatArray, number: int) -> list[int]:
    chosen = list[int]()
    for _ in range(number):
        gains = _gains(G, W, _covariance(G, chosen))
        gains[chosen] = -np.inf
        chosen.append(int(gains.argmax()))
    return chosen


def _exchanged(G: FloatArray, W: FloatArray, chosen: list[int]) -> list[int]:
    """Postures of which no exchange of one for another lowers the variance any more."""
    for _ in range(_ROUNDS):
        before = float(np.trace(W @ _covariance(G, chosen)))
        for k in range(len(chosen)):
            rest = chosen[:k] + chosen[k + 1 :]
            gains = _gains(G, W, _covariance(G, rest))
            gains[rest] = -np.inf
            chosen = [*rest[:k], int(gains.argmax()), *rest[k:]]
        if float(np.trace(W @ _covariance(G, chosen))) > (1 - _GAIN) * before:
            break
    return chosen


def _in_a_row(q: FloatArray, start: FloatArray) -> list[int]:
    """The order in which each posture is near the one before."""
    left, order, at = list(range(len(q))), list[int](), start
    while left:
        nearest = min(left, key=lambda k: float(np.abs(q[k] - at).max()))
        left.remove(nearest)
        order.append(nearest)
        at = q[nearest]
    return order
