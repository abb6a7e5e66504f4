"""Where a workpiece is, from places that the tool touched on it: a pose with its covariance.

Unknown is the displacement xi of the workpiece from where it was thought to be: a shift, m, and a turn, rad,
about the middle of the touched features. The estimate is the maximum a posteriori of

    sum |r_i(xi)|^2 / s^2 + xi' P^-1 xi,

with the residuals r_i of the touched features and the prior's covariance P; its covariance is
``(J' J / s^2 + P^-1)^-1``. Touches that do not fit the others are left out one by one, by their studentised
residuals (Baarda, 1968), as long as at most a third of them goes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares
from scipy.special import chdtrc

from cmbot.collision import Box
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import counted
from cmbot.common.representation import ShortRepr
from cmbot.identification.touches import Feature, Touches, TouchSetup, read_touches
from cmbot.scene import Placement, Scene

# Probability by chance of the residual of a touch that is left out, and the share that may go.
_CHANCE, _MOST_LEFT_OUT = 1e-3, 1 / 3
# A place further from the prior's, in its standard deviations, is a mistake.
_MAX_PRIOR_SIGMAS = 6.0
# A direction whose variance is more than this share of the prior's is not fixed by the touches.
_UNOBSERVED_VARIANCE_SHARE = 0.8
# Residual, in standard deviations, beyond which the first estimate counts touches linearly.
_HUBER_SIGMAS = 2.0
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
    counted_in = list(range(len(touches.features)))
    most = int(_MOST_LEFT_OUT * len(counted_in))
    problem = _Problem(touches)
    xi = problem.solved(np.zeros(6), counted_in, robust=True).x
    while True:
        estimate = problem.solved(xi, counted_in)
        xi, covariance = estimate.x, np.linalg.inv(estimate.jac.T @ estimate.jac)
        worst = problem.worst(estimate, covariance, counted_in)
        if worst is None:
            break
        counted_in.remove(worst)
        if len(touches.features) - len(counted_in) > most:
            off = 1e3 * float(np.linalg.norm(problem.residuals(xi, [worst])[0]))
            expected = "touches that fit each other: more than a third does not; look at features and units"
            raise InputError(touches.source, f"touches[{worst}]", f"{off:.1f} mm from its feature", expected)
    if (off := float(np.abs(xi / problem.prior).max())) > _MAX_PRIOR_SIGMAS:
        shift, turned = 1e3 * np.linalg.norm(xi[:3]), np.degrees(np.linalg.norm(xi[3:]))
        prior, frame = touches.setup.prior, touches.frame
        raise InputError(
            touches.source,
            "prior",
            f"{frame} {shift:.0f} mm and {turned:.1f} deg from where the scene has it, {off:.0f} deviations",
            f"a place within {_MAX_PRIOR_SIGMAS:g} of prior: {{mm: {prior.mm:g}, deg: {prior.deg:g}}}; "
            "look at the units and the frame that the points are given in (locates), or widen prior",
        )
    X, turn = touches.X_WF.copy(), pin.exp3(xi[3:])
    X[:3, 3] = problem.middle + xi[:3] + turn @ (X[:3, 3] - problem.middle)
    X[:3, :3] = turn @ X[:3, :3]
    return Location(
        frame=touches.frame,
        X_WF=X,
        moved=xi,
        covariance=covariance,
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
        self.middle = np.mean([self._in_world(feature.point) for feature in touches.features], axis=0)

    def _in_world(self, point: FloatArray) -> FloatArray:
        """Where a point of the frame was thought to be."""
        return np.asarray(self._X[:3, :3] @ point + self._X[:3, 3])

    def residuals(self, xi: FloatArray, numbers: Sequence[int]) -> list[FloatArray]:
        """How far touched places are from their features, m, the workpiece displaced by `xi` (6,)."""
        back = self.middle + (self._places - self.middle - xi[:3]) @ pin.exp3(xi[3:])
        touched = (back - self._X[:3, 3]) @ self._X[:3, :3]
        return [self._features[k].residual(touched[k], self._tip) for k in numbers]

    def stacked(self, xi: FloatArray, numbers: Sequence[int]) -> FloatArray:
        """Whitened residuals of touches, and of the prior."""
        return np.append(np.concatenate(self.residuals(xi, numbers)) / self._deviation, xi / self.prior)

    def solved(self, start: FloatArray, numbers: Sequence[int], *, robust: bool = False) -> Any:
        """SciPy's result for those touches, its `x` the estimate (6,); with `robust`, far ones count less."""
        return least_squares(
            self.stacked,
            start,
            args=(numbers,),
            jac="3-point",
            x_scale=self.prior,
            loss="soft_l1" if robust else "linear",
            f_scale=_HUBER_SIGMAS,
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )

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
    exactness = f"{known.mm:.2f} mm and {known.deg:.3f} deg"
    yield (
        f"{found.frame} is {1e3 * shift:.2f} mm and {turn:.3f} deg from where the scene has it, at the "
        f"middle of what was touched, known within {exactness} (one standard deviation in the worst "
        f"direction; before {before.mm:g} mm and {before.deg:g} deg)."
    )
    kept = [r for k, r in enumerate(found.residuals) if k not in found.left_out]
    size = float(np.sqrt(np.mean(np.concatenate(kept) ** 2)))
    yield (
        f"{counted(len(kept), 'touch', 'touches')} fit within {1e3 * size:.2f} mm RMS; "
        f"touch_sd_mm is {touches.setup.touch_sd_mm:g}."
    )
    for k in found.left_out:
        off = 1e3 * float(np.linalg.norm(found.residuals[k]))
        yield f"touches[{k}] is {off:.1f} mm from its feature, unlike the others: it does not count."
    if found.not_fixed:
        yield (
            f"Not fixed by these touches: {'; '.join(found.not_fixed)} of W; there the place is as it was "
            "thought to be."
        )


def features_to_touch(scene: Scene, number: int) -> tuple[list[Feature], FloatArray]:
    """Return features of the scene's workpieces that tell most, in W, and the covariance (6, 6) expected.

    Corners of boxes that are marked as workpieces, those first that lower the mean variance of the place of
    the tool path most.

    Raises
    ------
    InputError
        When no box is marked.
    """
    corners = list[FloatArray]()
    for obstacle in scene.all_obstacles:
        if obstacle.workpiece and isinstance(obstacle.shape, Box):
            half = 0.5 * np.array(obstacle.shape.size)
            signs = np.stack(np.meshgrid(*[(-1, 1)] * 3), axis=-1).reshape(-1, 3)
            corners += list((signs * half) @ obstacle.X_WO[:3, :3].T + obstacle.X_WO[:3, 3])
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


def expected_covariance(
    points: Sequence[FloatArray], about: FloatArray, setup: TouchSetup | None = None
) -> FloatArray:
    """Return the covariance (6, 6) of a place after touches of `points`, about a point (3,)."""
    setup = setup or TouchSetup()
    information = np.diag(_prior(setup) ** -2.0)
    for point in points:
        J = np.hstack([np.eye(3), -pin.skew(point - about)]) / (1e-3 * setup.touch_sd_mm)
        information += J.T @ J
    return np.asarray(np.linalg.inv(information))
