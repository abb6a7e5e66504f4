"""Where a workpiece is, from places that the tool touched on it: a pose with its covariance.

Unknown is the displacement xi of the workpiece from where it was thought to be: a shift, m, and a turn, rad,
about the middle of the touched features. The estimate is the maximum a posteriori of

    sum |r_i(xi)|^2 / s^2 + xi' P^-1 xi,

with the residuals r_i of the touched features and the prior's covariance P. Its covariance is that of the
posterior about it, by importance sampling from the normal distribution of ``(J' J / s^2 + P^-1)^-1``: where
the prior decides, residuals curve. Touches that do not fit the others are left out one by one, by their
studentised residuals (Baarda, 1968), as long as at most a third of them goes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.special import chdtrc, ndtri

from cmbot.collision import Box
from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import counted
from cmbot.common.representation import ShortRepr
from cmbot.identification.touches import Feature, Touches, TouchSetup, read_touches
from cmbot.planning import robot_of, strokes_of
from cmbot.scene import Placement, Scene

# Probability by chance of the residual of a touch that is left out, and the share that may go.
_CHANCE, _MOST_LEFT_OUT = 1e-3, 1 / 3
# A place further from the prior's, in its standard deviations, is a mistake.
_MAX_PRIOR_SIGMAS = 6.0
# A direction whose variance is more than this share of the prior's is not fixed by the touches.
_UNOBSERVED_VARIANCE_SHARE = 0.8
# Residual, in standard deviations, beyond which the first estimate counts touches linearly.
_HUBER_SIGMAS = 2.0
# Draws of importance sampling, by so much wider than what they stand for, how often they are drawn anew from
# the moments before, and the share of them that has to count.
_DRAWS, _WIDER, _ROUNDS, _COUNTING_SHARE = 1024, 1.5, 3, 0.1
# Root of x^7 = x + 1: its powers spread draws evenly in six dimensions (Roberts, 2018).
_SPREADING = 1.1127756842787055
# The tool points towards faces whose normals are within 60 degrees of it: at least one of any box.
_FACED = 0.5
_POSE_DIRECTIONS = ("along x", "along y", "along z", "about x", "about y", "about z")


@dataclass(frozen=True, kw_only=True, eq=False)
class Location(ShortRepr):
    """Where a frame is.

    Attributes
    ----------
    frame : str
    X_WF : (4, 4)
        Its pose in W.
    moved : (6,), m, rad
        From where it was thought to be: shift and rotation vector in W, about the middle of what was touched.
    covariance : (6, 6), m2, m rad, rad2
        Of these.
    residuals : tuple of (k,) arrays, m
        How far each touched place is from its feature then.
    left_out : tuple of int
        Touches that do not fit the others.
    not_fixed : tuple of str
        Directions of which the touches say next to nothing: there the place is what it was thought to be.
    """

    frame: str
    X_WF: FloatArray
    moved: FloatArray
    covariance: FloatArray
    residuals: tuple[FloatArray, ...]
    left_out: tuple[int, ...]
    not_fixed: tuple[str, ...]

    @property
    def placement(self) -> Placement:
        """How exactly its place is known: the largest standard deviations along and about any direction."""
        return placement_of(self.covariance)

    @property
    def rpy(self) -> FloatArray:
        """Roll, pitch and yaw (3,) of the frame, rad."""
        return np.asarray(pin.rpy.matrixToRpy(self.X_WF[:3, :3]))


def placement_of(covariance: FloatArray) -> Placement:
    """Return the largest standard deviations along and about any direction, of a covariance (6, 6)."""
    along, about = (
        float(np.sqrt(np.linalg.eigvalsh(block)[-1])) for block in (covariance[:3, :3], covariance[3:, 3:])
    )
    return Placement(mm=1e3 * along, deg=float(np.degrees(about)))


def locate(source: str | Path | Mapping[str, Any], scene: Scene | str | Path | None = None) -> Location:
    """Find out where a workpiece is, from places that the tool touched on it.

    Parameters
    ----------
    source : str, Path or mapping
        A file of touches, or its content: `cmbot.identification.read_touches`.
    scene : Scene, str or Path, optional
        In place of the file's; of a CSV file, which names none, it is needed.

    Returns
    -------
    Location
        The pose of the frame, and its covariance.

    Raises
    ------
    InputError
        When a key or value is wrong, or more than a third of the touches does not fit the others.

    Examples
    --------
    >>> found = cmbot.locate("touches.yaml")  # doctest: +SKIP
    >>> found.X_WF, found.placement  # doctest: +SKIP
    """
    return located(read_touches(source, scene))


def located(touches: Touches) -> Location:
    """Return where the frame of touches is; errors as `locate`."""
    problem, number = _Problem(touches), len(touches.features)
    start = problem.solved(np.zeros(6), range(number), robust=True).x
    xi, covariance, counted_in, worst = problem.fitting(start, range(number))
    if worst is not None and number >= 1 / _MOST_LEFT_OUT:
        # A gross mistake draws the linear fit so far to it that others look worse, not the robust one.
        far = np.argmax([np.linalg.norm(r) for r in problem.residuals(start, range(number))])
        again = problem.fitting(start, [k for k in range(number) if k != far])
        if again[-1] is None:
            xi, covariance, counted_in, worst = again
    if worst is not None:
        off = 1e3 * float(np.linalg.norm(problem.residuals(xi, [worst])[0]))
        misfits = f"{number + 1 - len(counted_in)} of {number} do not, more than a third"
        expected = f"touches that fit each other: {misfits}; look at features and units"
        raise InputError(touches.source, touches.key(worst), f"{off:.1f} mm from its feature", expected)
    if (off := float(np.abs(xi / problem.prior).max())) > _MAX_PRIOR_SIGMAS:
        shift, turned = 1e3 * np.linalg.norm(xi[:3]), np.degrees(np.linalg.norm(xi[3:]))
        prior, frame = touches.setup.prior, touches.frame
        got = f"{frame} {shift:.0f} mm and {turned:.1f} deg from where the scene has it, {off:.0f} deviations"
        within = f"a place within {_MAX_PRIOR_SIGMAS:g} of prior: {{mm: {prior.mm:g}, deg: {prior.deg:g}}}"
        look = "look at the units and the frame that the points are given in (locates), or widen prior"
        raise InputError(touches.source, "prior", got, f"{within}; {look}")
    X, turn = touches.X_WF.copy(), pin.exp3(xi[3:])
    X[:3, 3] = problem.middle + xi[:3] + turn @ (X[:3, 3] - problem.middle)
    X[:3, :3] = turn @ X[:3, :3]
    return Location(
        frame=touches.frame,
        X_WF=X,
        moved=xi,
        covariance=problem.spread(xi, covariance, counted_in),
        residuals=tuple(problem.residuals(xi, range(len(touches.features)))),
        left_out=tuple(sorted(set(range(len(touches.features))) - set(counted_in))),
        not_fixed=tuple(_not_fixed(covariance, problem.prior)),
    )


class _Problem:
    """Residuals of touches in units of their standard deviation, and of the prior."""

    def __init__(self, touches: Touches) -> None:
        setup = touches.setup
        self._places, self._features, self._X = touches.places, touches.features, touches.X_WF
        self._deviation, self._tip = 1e-3 * setup.touch_sd_mm, 1e-3 * setup.tip_radius_mm
        self.prior = _prior(setup)
        middle = np.mean([feature.point for feature in touches.features], axis=0)
        self.middle = self._X[:3, :3] @ middle + self._X[:3, 3]

    def residuals(self, xi: FloatArray, numbers: Sequence[int]) -> list[FloatArray]:
        """How far touched places are from their features, m, the workpiece displaced by `xi` (..., 6)."""
        R = Rotation.from_rotvec(xi[..., 3:]).as_matrix()
        back = self.middle + (self._places - self.middle - xi[..., None, :3]) @ R
        touched = (back - self._X[:3, 3]) @ self._X[:3, :3]
        return [self._features[k].residual(touched[..., k, :], self._tip) for k in numbers]

    def stacked(self, xi: FloatArray, numbers: Sequence[int]) -> FloatArray:
        """Whitened residuals of touches, and of the prior, at displacements `xi` (..., 6)."""
        each = [residual / self._deviation for residual in self.residuals(xi, numbers)]
        return np.concatenate([*each, xi / self.prior], axis=-1)

    def spread(self, xi: FloatArray, covariance: FloatArray, numbers: Sequence[int]) -> FloatArray:
        """The posterior's second moments (6, 6) about an estimate `xi`, from those of the linearised one.

        Where residuals are linear these are as they were.
        """
        draws, chance = _draws()
        for _ in range(_ROUNDS):
            off, weight = draws @ np.linalg.cholesky(covariance).T, np.eye(_DRAWS)[0]
            square = np.square(self.stacked(xi + off, numbers)).sum(axis=1)
            log = 0.5 * (np.square(draws).sum(axis=1) - square)
            # Where few count the density is flattened: the next draws are nearer to it.
            while np.square(weight).sum() > 1 / (_COUNTING_SHARE * _DRAWS):
                weight = chance * np.exp(log - log.max())
                weight, log = weight / weight.sum(), 0.5 * log
            covariance = (weight * off.T) @ off
        return covariance

    def solved(self, start: FloatArray, numbers: Sequence[int], *, robust: bool = False) -> Any:
        """SciPy's result for those touches, its `x` the estimate (6,); with `robust`, far ones count less."""
        how: Any = {"args": (numbers,), "jac": "3-point", "x_scale": self.prior, "f_scale": _HUBER_SIGMAS}
        how |= dict.fromkeys(("xtol", "ftol", "gtol"), 1e-12)
        return least_squares(self.stacked, start, loss="soft_l1" if robust else "linear", **how)

    def fitting(
        self, xi: FloatArray, numbers: Sequence[int]
    ) -> tuple[FloatArray, FloatArray, list[int], int | None]:
        """The estimate by touches that fit each other, from `xi` on, its covariance (6, 6), and the touches.

        At last one that does not fit them, where too many would be left out.
        """
        kept = list(numbers)
        while True:
            estimate = self.solved(xi, kept)
            xi, covariance = estimate.x, np.linalg.inv(estimate.jac.T @ estimate.jac)
            worst = self.worst(estimate, covariance, kept)
            if worst is None or len(self._features) + 1 - len(kept) > _MOST_LEFT_OUT * len(self._features):
                return xi, covariance, kept, worst
            kept.remove(worst)

    def worst(self, estimate: Any, covariance: FloatArray, numbers: Sequence[int]) -> int | None:
        """The touch that fits the others least, where chance hardly makes it so."""
        at, found = 0, list[tuple[float, float, int]]()
        for number, residual in zip(numbers, self.residuals(estimate.x, numbers), strict=True):
            own = slice(at, at + len(residual))
            at, r, J = own.stop, estimate.fun[own], estimate.jac[own]
            left = np.eye(len(r)) - J @ covariance @ J.T
            square = float(r @ np.linalg.pinv(left, rcond=1e-9) @ r)
            found.append((float(chdtrc(len(r), square)), -square, number))
        chance, _, number = min(found)
        return number if chance * len(numbers) < _CHANCE else None


@cache
def _draws() -> tuple[FloatArray, FloatArray]:
    """Draws (k, 6) and their weights (k,), whose mean is 0 and whose covariance is 1, with wide tails."""
    each = np.arange(1, _DRAWS // 2 + 1)[:, None] * _SPREADING ** -np.arange(1.0, 7.0)
    half = _WIDER * ndtri((0.5 + each) % 1.0)
    x = np.hstack([half.T, -half.T])
    weight = np.exp(-0.5 * (1 - _WIDER**-2) * np.square(x).sum(axis=0))
    weight /= weight.sum()
    return read_only(np.linalg.solve(np.linalg.cholesky((weight * x) @ x.T), x).T), read_only(weight)


def _prior(setup: TouchSetup) -> FloatArray:
    """Standard deviations (6,) of shift and turn before, m and rad."""
    return np.repeat([1e-3 * max(setup.prior.mm, 1e-6), np.radians(max(setup.prior.deg, 1e-6))], 3)


def _not_fixed(covariance: FloatArray, prior: FloatArray) -> Iterator[str]:
    """Name the directions in which the place is known hardly better than before."""
    values, vectors = np.linalg.eigh(covariance / np.outer(prior, prior))
    for value, direction in zip(values, vectors.T, strict=True):
        if value > _UNOBSERVED_VARIANCE_SHARE:
            large = np.flatnonzero(np.abs(direction) > 0.4)
            yield " and ".join(_POSE_DIRECTIONS[k] for k in large)


def location_remarks(found: Location, touches: Touches) -> Iterator[str]:
    """Say where the frame is, how exactly, and which touches did not count."""
    shift, turn = np.linalg.norm(found.moved[:3]), np.degrees(np.linalg.norm(found.moved[3:]))
    known, before = found.placement, touches.setup.prior
    yield (
        f"{found.frame} is {1e3 * shift:.2f} mm and {turn:.3f} deg from where the scene has it, at the "
        f"middle of what was touched, known within {known.mm:.2f} mm and {known.deg:.3f} deg (one standard "
        f"deviation in the worst direction; before {before.mm:g} mm and {before.deg:g} deg)."
    )
    kept = [r for k, r in enumerate(found.residuals) if k not in found.left_out]
    size = float(np.sqrt(np.mean(np.concatenate(kept) ** 2)))
    yield (
        f"{counted(len(kept), 'touch', 'touches')} fit within {1e3 * size:.2f} mm RMS; "
        f"touch_sd_mm is {touches.setup.touch_sd_mm:g}."
    )
    for k in found.left_out:
        off = 1e3 * float(np.linalg.norm(found.residuals[k]))
        yield f"{touches.key(k)} is {off:.1f} mm from its feature, unlike the others: it does not count."
    if found.not_fixed:
        yield (
            f"Not fixed by these touches: {'; '.join(found.not_fixed)} of W; there the place is as it was "
            "thought to be."
        )


def features_to_touch(scene: Scene, number: int) -> tuple[list[Feature], FloatArray]:
    """Return features of the scene's workpieces that tell most, in W, and the covariance (6, 6) expected.

    Corners of boxes that are marked as workpieces, of the faces towards which the tool points where a stroke
    begins; those first that lower the mean variance of the place of the tool path most.

    Raises
    ------
    InputError
        When no box is marked.
    """
    corners, paths = list[FloatArray](), [stroke.path for stroke in strokes_of(scene, robot_of(scene))]
    axes = np.array([path.poses([0.0]).rotation[0, :, 2] for path in paths])
    for obstacle in scene.all_obstacles:
        if obstacle.workpiece and isinstance(obstacle.shape, Box):
            R, sides = obstacle.X_WO[:3, :3], np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3)
            # Others, such as those of its underside, no tool can touch from where it works.
            faced = (sides[:, None] * (axes @ R) < -_FACED).any(axis=(1, 2))
            corners += list((0.5 * sides[faced] * obstacle.shape.size) @ R.T + obstacle.X_WO[:3, 3])
    if not corners:
        expected = "a box with workpiece: true among the scene's obstacles, whose corners can be touched"
        raise InputError(scene.source, "obstacles", "no such box", expected)
    chosen, middle = list[FloatArray](), np.mean(corners, axis=0)

    def variance(corner: FloatArray) -> float:
        """Mean square of the displacement of all corners, m2, after one more touch."""
        after = expected_covariance([*chosen, corner], middle)
        levers = [np.hstack([np.eye(3), -pin.skew(each - middle)]) for each in corners]
        return float(sum(np.trace(lever @ after @ lever.T) for lever in levers))

    while len(chosen) < number and corners:
        best = min(range(len(corners)), key=lambda k: variance(corners[k]))
        chosen.append(corners.pop(best))
    features = [Feature(kind="point", point=corner, axis=np.zeros(3)) for corner in chosen]
    return features, expected_covariance(chosen, middle)


def expected_covariance(points: Sequence[FloatArray], about: FloatArray) -> FloatArray:
    """Return the covariance (6, 6) of a place after usual touches of `points`, about a point (3,)."""
    setup = TouchSetup()
    information = np.diag(_prior(setup) ** -2.0)
    for point in points:
        J = np.hstack([np.eye(3), -pin.skew(point - about)]) / (1e-3 * setup.touch_sd_mm)
        information += J.T @ J
    return np.asarray(np.linalg.inv(information))
