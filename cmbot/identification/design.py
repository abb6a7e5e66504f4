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
from scipy.linalg import block_diag

from cmbot.collision import Clearances
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError
from cmbot.common.representation import ShortRepr
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.identification.estimation import Identification
from cmbot.identification.measurements import MeasuringSetup
from cmbot.identification.model import DeflectionModel, SagAlong, measured_arm, prior_deviations, sag_along
from cmbot.identification.problem import whitener
from cmbot.planning import JobState, Plan, QuinticTrajectory, build_request, follow_path, starting_at_path
from cmbot.robot import Dynamics
from cmbot.scene import Scene

# Postures that are chosen from, random ones that are tried for them, and how many at a time.
_MAX_CANDIDATES, _MOST_TRIED, _AT_ONCE = 800, 40_000, 2000
# Postures of a job.
_JOB_POSTURES = 25
# Lag of the tool behind its path, m, beyond which a joint path does not follow it.
_MAX_PATH_LAG_M = 0.01
# Rounds of exchanges at most, and the least share by which one lowers the variance.
_MAX_EXCHANGE_ROUNDS, _MIN_EXCHANGE_GAIN_SHARE = 20, 1e-4
_HALF_TURN = np.pi
# Postures that are tried about each that was chosen, and how far away, rad, round by round.
_POSTURES_AROUND, _REFINED = 30, (0.5, 0.3, 0.15, 0.1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Proposal(ShortRepr):
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
        The sag along the job: as it is known so far, and how exact it will be.
    measured : int
        Number of postures that were measured in before.
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
    measured: int = 0

    def sheet(self, scene: str) -> str:
        """Return a file of measurements to fill in; `scene` is how it names the scene."""
        slides = measured_arm(self.scene).robot.limits.prismatic.any()
        axes = [axis for axis, seen in zip("xyz", self.seen, strict=True) if seen]
        named = ", ".join(f"{axis}: null" for axis in axes)
        blank = "[null, null, null]" if self.seen.all() else f"{{{named}}}"
        files = "THE_EARLIER_FILES THIS_FILE" if self.measured else "THIS_FILE"
        setup = self.setup.model_dump(mode="json", include=set(MeasuringSetup.model_fields))
        lines = [
            "# Hang the weight on the tool in each posture: deflection_mm is how far the tool point moves",
            f"# along {', '.join(axes)} of the world frame; null: not measured. Then: cmbot identify {files}",
            "format: cmbot-measurements/1",
            f"scene: {json.dumps(scene)}",
            *(f"{name}: {json.dumps(value)}" for name, value in setup.items()),
            "measurements:",
        ]
        for q, d in zip(self.q, self.deflection, strict=True):
            rows = np.round(q if slides else np.degrees(q), 4 if slides else 2).tolist()
            about = ", ".join(f"{1e3 * x:.2f}" for x in d[self.seen])
            lines.append(f"  - {'posture' if slides else 'posture_deg'}: {rows}")
            lines.append(f"    deflection_mm: {blank}  # about {about}")
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
    return np.asarray(q[np.unique(np.linspace(0, len(q) - 1, _JOB_POSTURES).round().astype(int))])


def _spread(trajectory: QuinticTrajectory) -> FloatArray:
    return np.linspace(trajectory.t[0], trajectory.t[-1], _JOB_POSTURES)


def _followed(scene: Scene) -> Iterator[FloatArray]:
    """Postures along each stroke, by gradient projection from where the one before ends."""
    request = build_request(scene, scene.planner)
    state = request.state
    for number in range(len(request.strokes)):
        request = request.at_stroke(number, state)
        if request.stroke.begins_elsewhere:
            request = starting_at_path(request)
        found = follow_path(request, stop_at_obstacles=False)
        if not (off := float(found.drift.max())) <= _MAX_PATH_LAG_M:
            got = f"a path that gradient projection leaves by {off:.2f} m"
            raise InputError(scene.source, request.stroke.key, got, "a plan of it in its place: --job DIR")
        state = JobState(posture=found.q[-1])
        yield found.q


def require_axes(axes: str, source: str = "propose", key: str = "axes") -> None:
    """Refuse components of a deflection other than ``x``, ``y`` and ``z`` with an `InputError`."""
    if not axes or set(axes) - set("xyz"):
        raise InputError(source, key, repr(axes), "letters of xyz")


def propose(
    scene: Scene,
    number: int,
    job: FloatArray,
    setup: MeasuringSetup | None = None,
    *,
    axes: str = "xyz",
    known: Identification | None = None,
    seed: int = 0,
) -> Proposal:
    """Propose postures in which measuring tells most of the sag along a job.

    They are clear of everything by the scene's safety margin, and all joints can hold them with the weight.
    Their order is a short way through them from the scene's posture.

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
    known : Identification, optional
        What was measured before, of the same robot and base: what tells most beside that is proposed.
    seed : int
        Of the random postures that are chosen from.

    Raises
    ------
    InputError
        When `number` or `axes` is wrong, or no posture can be held with the weight.
    """
    if not 1 <= number <= _MAX_CANDIDATES:
        raise InputError("propose", "number", number, f"1 to {_MAX_CANDIDATES} postures")
    require_axes(axes)
    setup = setup or MeasuringSetup()
    seen = np.array([axis in axes for axis in "xyz"])
    rng, design = np.random.default_rng(seed), _PostureDesign(scene, setup, seen, job, known)
    pool = design.clear(design.random(rng))
    if len(pool) < number:
        expected = f"{number} or more: a smaller safety margin, or less weight"
        raise InputError("propose", "number", f"{len(pool)} clear postures", expected)
    G = design.rows(pool)
    chosen = _exchanged(G, design.W, _greedy(G, design.W, number))
    count = len(pool)
    for size in _REFINED:
        best, near = pool[chosen], design.clear(design.near(rng, pool[chosen], size))
        count += len(near)
        pool = np.concatenate([best, near])
        G = np.concatenate([G[chosen], design.rows(near)]) if len(near) else G[chosen]
        chosen = _exchanged(G, design.W, list(range(number)))
    after = sag_along(design.arm, design.covariance(_covariance(G, chosen)), job)
    q = pool[chosen]
    q = q[_tour(np.array(scene.posture), q, design.speeds)]
    return Proposal(
        scene=scene,
        setup=setup,
        q=q,
        seen=seen,
        deflection=design.deflection(q),
        before=design.before,
        after=after,
        job=job,
        candidates=count,
        measured=0 if known is None else sum(len(each.q) for each in known.measurements),
    )


class _PostureDesign:
    """Which postures can be measured in, and what each would tell of the sag along a job."""

    def __init__(
        self,
        scene: Scene,
        setup: MeasuringSetup,
        seen: BoolArray,
        job: FloatArray,
        known: Identification | None,
    ) -> None:
        self._scene, self._setup, self._seen = scene, setup, seen
        self.arm = measured_arm(scene) if known is None else known.arm
        self._robot = measured_arm(scene, setup.weight_kg).robot
        self._dynamics, self._clearances = Dynamics(self._robot), Clearances(self._robot, scene.all_obstacles)
        self.speeds = self._robot.limits.velocity
        covariance = self._so_far(known)
        values, V = np.linalg.eigh(covariance)
        # Parameters and the error of the weight, kg, are this times independent unknowns of unit variance.
        self._root = V * np.sqrt(np.maximum(values, 0.0))
        self.before = sag_along(self.arm, covariance[:-1, :-1], job)
        self.W = self._root[:-1].T @ self.before.weight @ self._root[:-1]

    def _so_far(self, known: Identification | None) -> FloatArray:
        """Covariance (p + 1, p + 1) of the parameters and the weight before anything more is measured."""
        weight = self._setup.weight_sd_kg**2
        if known is None:
            prior = prior_deviations(StiffnessParameters(self.arm), self._setup.prior)
            return np.diag(np.append(prior**2, weight))
        p = len(known.mean)
        for k, each in enumerate(known.weights):
            if each.stated == self._setup.weight_kg and weight:
                return known.joint[np.ix_([*range(p), p + k], [*range(p), p + k])]
        return np.asarray(block_diag(known.joint[:p, :p], weight))

    def covariance(self, unknowns: FloatArray) -> FloatArray:
        """Of the parameters (p, p), from that of the unknowns."""
        return np.asarray(self._root[:-1] @ unknowns @ self._root[:-1].T)

    def random(self, rng: np.random.Generator) -> Iterator[FloatArray]:
        """Random postures within the joint ranges, a few at a time."""
        limits = self._robot.limits
        half = np.where(limits.prismatic, limits.range_half, np.minimum(limits.range_half, _HALF_TURN))
        for _ in range(_MOST_TRIED // _AT_ONCE):
            yield limits.range_middle + half * rng.uniform(-1, 1, (_AT_ONCE, self._robot.dof))

    def near(self, rng: np.random.Generator, q: FloatArray, size: float) -> Iterator[FloatArray]:
        """Random postures about others, `size`, rad, away."""
        limits = self._robot.limits
        moved = self._robot.metric.positions(size * rng.standard_normal((_POSTURES_AROUND, *q.shape)))
        low, high = limits.range_middle - limits.range_half, limits.range_middle + limits.range_half
        yield np.clip(q + moved, low, high).reshape(-1, q.shape[1])

    def clear(self, batches: Iterable[FloatArray]) -> FloatArray:
        """Those of some postures that are clear and that the joints can hold with the weight."""
        found, limits = list[FloatArray](), self._robot.limits
        for q in batches:
            torque = self._dynamics.static_efforts(q).joint_torque
            held = q[(np.abs(torque) <= limits.torque).all(axis=1)]
            if len(held):
                distance = self._clearances.query(held).distance
                found.append(held[distance >= self._scene.planner.safety_margin_m])
            if sum(map(len, found)) >= _MAX_CANDIDATES:
                break
        return np.concatenate(found)[:_MAX_CANDIDATES] if found else np.zeros((0, self._robot.dof))

    def deflection(self, q: FloatArray) -> FloatArray:
        """What is to be expected, (N, 3), m."""
        model = DeflectionModel(self.arm, self._setup, q)
        return model.at(np.zeros(model.parameters.count))[0]

    def rows(self, q: FloatArray) -> FloatArray:
        """Derivatives (N, k, p + 1) of what is measured by the unknowns, in units of its noise."""
        model = DeflectionModel(self.arm, self._setup, q)
        deflection, slope = model.at(np.zeros(model.parameters.count))
        # A deflection is nearly proportional to the weight.
        by_weight = deflection[:, :, None] / self._setup.weight_kg
        whole = np.concatenate([slope, by_weight], axis=2) @ self._root
        each = zip(model.noise, whole, strict=True)
        return np.stack([whitener(noise, self._seen) @ one for noise, one in each])


def _covariance(G: FloatArray, chosen: list[int]) -> FloatArray:
    """Covariance of the unknowns after measuring in some postures."""
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
    for _ in range(_MAX_EXCHANGE_ROUNDS):
        before = float(np.trace(W @ _covariance(G, chosen)))
        for k in range(len(chosen)):
            rest = chosen[:k] + chosen[k + 1 :]
            gains = _gains(G, W, _covariance(G, rest))
            gains[rest] = -np.inf
            chosen = [*rest[:k], int(gains.argmax()), *rest[k:]]
        if float(np.trace(W @ _covariance(G, chosen))) > (1 - _MIN_EXCHANGE_GAIN_SHARE) * before:
            break
    return chosen


def _tour(start: FloatArray, q: FloatArray, speeds: FloatArray) -> list[int]:
    """The order of postures `q` (N, n) in which joints travel for a short time from `start` on.

    The nearest neighbour first, then pieces of the tour are turned round while that shortens it (2-opt).
    """
    at = np.vstack([start, q])
    seconds = (np.abs(at[:, None] - at) / speeds).max(axis=2)
    order, left = [0], set(range(1, len(at)))
    while left:
        order.append(min(left, key=lambda k: (seconds[order[-1], k], k)))
        left.remove(order[-1])
    # The tour ends anywhere.
    pieces = [(i, j) for i in range(1, len(order)) for j in range(i + 1, len(order))]
    shorter = True
    while shorter:
        shorter = False
        for i, j in pieces:
            a, b, c, d = order[i - 1], order[i], order[j], order[j + 1 : j + 2]
            gain = seconds[a, b] - seconds[a, c] + sum(seconds[c, k] - seconds[b, k] for k in d)
            if gain > 1e-9:
                order[i : j + 1] = order[i : j + 1][::-1]
                shorter = True
    return [k - 1 for k in order[1:]]
