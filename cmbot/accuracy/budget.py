"""The accuracy budget: within how much of its path the tool stays, and with which probability.

Biases add. What is not known is drawn: a Latin hypercube for what is one number over the job, normal numbers
at each posture for what changes. The largest distance over the job of each draw gives the quantile that
is told, and the share of draws within a tolerance (`Part`, `Sway`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from cmbot.accuracy.parts import Part, parts_of
from cmbot.accuracy.sway import Sway, ramped, sway_along
from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.reading.file_types import NonNegative, Share
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.sag import Sag
from cmbot.scene import Placement, Tolerance, Uncertainty

# Draws; postures of a stroke at most, and the time between them, s.
_MONTE_CARLO_DRAWS, _MAX_STROKE_POSTURES, _POSTURE_INTERVAL_S = 2048, 80, 0.25
_DRAW_SEED = 0
# What remedies promise: stiffness identified within this share, places located by touched points.
_IDENTIFIED, _LOCATED = 0.03, Placement(mm=0.3, deg=0.03)
# A remedy that leaves more than this share is none.
_MAX_REMEDY_SHARE = 0.99
# Half the speed takes a quarter of the acceleration.
_HALF_SPEED_SHARE = 0.25


@dataclass(frozen=True, kw_only=True)
class AccuracyPart:
    """One part of the budget, its largest values over the work.

    Attributes
    ----------
    name : str
    bias_mm : float
        Across the path.
    sigma_mm : float
        Standard deviation of the distance from the path: the root of the trace of its covariance across it.
    """

    name: str
    bias_mm: NonNegative
    sigma_mm: NonNegative

    @property
    def rms_mm(self) -> float:
        """Root of the mean square of the distance that it alone makes."""
        return float(np.hypot(self.bias_mm, self.sigma_mm))


@dataclass(frozen=True, kw_only=True)
class Remedy:
    """What would help, within how much of its path the tool would be, and which part is the largest then."""

    name: str
    within_mm: NonNegative
    largest: str


@dataclass(frozen=True, kw_only=True)
class Accuracy:
    """Where the tool is beside its path, all along the work.

    Attributes
    ----------
    within_mm : float
        The distance that it keeps with the probability.
    probability : float
    tolerance_kept : bool or None
        Whether the tolerance is kept with that probability; None where none is asked for.
    tolerance_share : float or None
        Probability that it is kept.
    parts : tuple of AccuracyPart
        The largest first.
    remedies : tuple of Remedy
        The most helpful first.
    """

    within_mm: NonNegative
    probability: Share
    tolerance_kept: bool | None
    tolerance_share: Share | None
    parts: tuple[AccuracyPart, ...]
    remedies: tuple[Remedy, ...]

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of each part in the sum of their mean squares, 0 to 1."""
        squares = [part.rms_mm**2 for part in self.parts]
        return tuple(square / sum(squares) for square in squares)

    def __repr__(self) -> str:
        return f"<Accuracy: within {self.within_mm:.3g} mm with {100 * self.probability:g} %>"


class WorkPath(Protocol):
    """Where the tool is to be: a `ToolPath`, or what stands for one."""

    @property
    def duration(self) -> float:
        """Time along it, s."""

    def leg_directions(self, times: FloatArray) -> FloatArray:
        """Return unit vectors (N, 3) along it at `times` (N,); zero where a leg has no length."""

    def leg_offset(self, times: FloatArray, p: FloatArray) -> FloatArray:
        """Return the vectors (N, 3), m, to points `p` (N, 3) from it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shaking:
    """How what shakes the base moves the tool, in R records of it, of which draws take each in turn.

    Attributes
    ----------
    t : (S,), s
        From the begin of the stroke.
    tool : (S, R, 3), m
        Displacements in W.
    """

    t: FloatArray
    tool: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Work:
    """A stroke, and how it is moved along.

    Attributes
    ----------
    path : WorkPath
    motion : callable
        From times (N,), s, and an order of derivative to joint positions and their derivatives (N, n).
    commanded : callable
        From times to the places (N, 3), m, where the rigid arm's tool is.
    rotation : callable
        From times to the orientations (N, 3, 3) of the rigid arm's tool.
    shaking : Shaking or None
        Of all strokes or of none, with as many records each.
    sway : Sway or None
        `stroke_sway` with the share of the stiffness that is uncertain; None: it is integrated.
    """

    path: WorkPath
    motion: Callable[[FloatArray, int], FloatArray]
    commanded: Callable[[FloatArray], FloatArray]
    rotation: Callable[[FloatArray], FloatArray]
    shaking: Shaking | None = None
    sway: Sway | None = None


def accuracy_of(
    arm: ElasticArm,
    strokes: Sequence[Work],
    uncertainty: Uncertainty,
    tolerance: Tolerance | None = None,
    *,
    compensated: bool,
    covariance: FloatArray | None = None,
) -> Accuracy:
    """Return the accuracy budget of a work.

    Parameters
    ----------
    arm : ElasticArm
    strokes : sequence of Work
    uncertainty : Uncertainty
    tolerance : Tolerance, optional
        Left out: none is asked for, and the distance is told that is kept with 95 %.
    compensated : bool
        Whether the joints aim beside the path by the predicted sag.
    covariance : (p, p), optional
        Of an identified stiffness.

    Raises
    ------
    InputError
        When the arm is too soft to carry itself in a posture.
    """
    share = 0.0 if covariance is not None else uncertainty.stiffness_share
    budget = _Budget.of(arm, strokes, uncertainty, compensated=compensated, covariance=covariance)
    asked = tolerance or Tolerance()
    distances = budget.distances()
    within = _within(distances, asked.probability)
    kept = None
    if tolerance is not None and (tolerance.across_mm or tolerance.along_axis_mm):
        kept = float(budget.keeps(tolerance).mean())
    return Accuracy(
        within_mm=within,
        probability=asked.probability,
        tolerance_kept=None if kept is None else kept >= asked.probability,
        tolerance_share=kept,
        parts=budget.told,
        remedies=_remedies(
            arm,
            strokes,
            budget,
            uncertainty,
            within,
            asked.probability,
            compensated=compensated,
            share=share,
        ),
    )


def _within(distances: FloatArray, probability: float) -> float:
    """The distance, mm, that is kept with a probability, of draws (D,), m."""
    return 1e3 * float(np.quantile(distances, probability))


def _remedies(
    arm: ElasticArm,
    strokes: Sequence[Work],
    budget: _Budget,
    uncertainty: Uncertainty,
    within: float,
    probability: float,
    *,
    compensated: bool,
    share: float,
) -> tuple[Remedy, ...]:
    """What would help, each computed as the budget without what it takes away, and all of it together."""
    tried = list[tuple[str, Callable[[_Budget], _Budget]]]()
    if not compensated:
        tried.append(("compensate: true", lambda other: other.scaled({"sag": 0.0})))
    if share > _IDENTIFIED:
        tried.append(("cmbot identify", lambda other: other.scaled({"stiffness": _IDENTIFIED / share})))
    if arm.robot.fixed_tool is None and (
        uncertainty.foot.mm > _LOCATED.mm or uncertainty.foot.deg > _LOCATED.deg
    ):
        tried.append(("cmbot locate", lambda other: other.located(uncertainty.foot)))
    # A slower tool is moved as far by a force that sets in at once.
    if not arm.robot.pushed_at_once:
        tried.append(("half the speed", lambda other: other.scaled({"sway": _HALF_SPEED_SHARE})))
    elif 1e3 * np.linalg.norm(budget.sway, axis=2).max() > (1 - _MAX_REMEDY_SHARE) * within:
        slowly = ramped(arm, strokes[0].motion(np.zeros(1), 0)[0])
        name = f"tool.process_ramp_s: {slowly.robot.tool_ramp:g}"
        tried.append((name, partial(_Budget.swayed, arm=slowly, strokes=strokes)))
    if budget.shaking is not None:
        tried.append(("work while the base is still", lambda other: replace(other, shaking=None)))
    found, all_together = list[Remedy](), budget
    for name, remedy in tried:
        helped = remedy(budget).remedied(name, probability)
        if helped.within_mm < _MAX_REMEDY_SHARE * within:
            found.append(helped)
            all_together = remedy(all_together)
    if len(found) > 1:
        *others, last = (remedy.name for remedy in found)
        found.append(all_together.remedied(f"{', '.join(others)} and {last}", probability))
    return tuple(sorted(found, key=lambda remedy: remedy.within_mm))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Budget:
    """Errors of the tool at the N postures of a work, by what is drawn."""

    parts: tuple[Part, ...]
    planned: FloatArray  # (N, 3), m: of the rigid arm's tool, or of the bent one's where sag is compensated
    sway: FloatArray  # (3, N, 3), m: with the least stiffness, the stated one and the largest
    along: FloatArray  # (N, 3), unit vectors along the path, or zero where it is a point
    axis: FloatArray  # (N, 3), of the tool
    share: float  # of the stiffness
    shaking: FloatArray | None  # (R, N, 3), m

    @classmethod
    def of(
        cls,
        arm: ElasticArm,
        strokes: Sequence[Work],
        uncertainty: Uncertainty,
        *,
        compensated: bool,
        covariance: FloatArray | None,
    ) -> _Budget:
        share = uncertainty.stiffness_share
        each = [_sampled(arm, work, share, compensated=compensated) for work in strokes]
        q, planned, along, axis = (np.concatenate([one[k] for one in each]) for k in range(4))
        sway = np.concatenate([one[4] for one in each], axis=1)
        shaken = [one[5] for one in each if one[5] is not None]
        return cls(
            parts=tuple(parts_of(arm, q, uncertainty, compensated=compensated, covariance=covariance)),
            planned=planned,
            sway=sway,
            along=along,
            axis=axis,
            share=share,
            shaking=np.concatenate(shaken, axis=1) if shaken else None,
        )

    def scaled(self, factors: dict[str, float]) -> _Budget:
        """Return the budget with the parts of these names multiplied."""
        parts = tuple(
            replace(part, bias=factors[part.name] * part.bias, maps=factors[part.name] * part.maps)
            if part.name in factors
            else part
            for part in self.parts
        )
        share = factors.get("stiffness", 1.0) * self.share
        return replace(self, parts=parts, sway=factors.get("sway", 1.0) * self.sway, share=share)

    def swayed(self, arm: ElasticArm, strokes: Sequence[Work]) -> _Budget:
        """Return the budget with the sway of another arm along its strokes."""
        each = [_integrated(arm, replace(work, sway=None), self.share) for work in strokes]
        return replace(self, sway=np.concatenate(each, axis=1))

    def located(self, before: Placement) -> _Budget:
        """Return the budget with the foot as exact as touched points make it, where that is better."""

        def ratio(now: float, was: float) -> float:
            return min(now / was, 1.0) if was > 0 else 1.0

        by = np.repeat([ratio(_LOCATED.mm, before.mm), ratio(_LOCATED.deg, before.deg)], 3)
        parts = (
            replace(part, maps=part.maps * by) if part.name == "placement of the base" else part
            for part in self.parts
        )
        return replace(self, parts=tuple(parts))

    @property
    def told(self) -> tuple[AccuracyPart, ...]:
        """What each part is at most, the largest first."""
        found = [self._told(part.name, part.bias, part.maps) for part in self.parts]
        found.append(self._told("planned deviation", self.planned, np.zeros((len(self.along), 3, 0))))
        size = max(float(np.linalg.norm(self._across(sway), axis=1).max()) for sway in self.sway)
        found.append(AccuracyPart(name="sway", bias_mm=1e3 * size, sigma_mm=0.0))
        if self.shaking is not None:
            squares = (self._across(self.shaking) ** 2).sum(axis=2)
            size = 1e3 * float(np.sqrt(squares.mean(axis=0).max()))
            known = len(squares) == 1
            found.append(
                AccuracyPart(
                    name="shaking of the base",
                    bias_mm=size if known else 0.0,
                    sigma_mm=0.0 if known else size,
                )
            )
        return tuple(sorted((part for part in found if part.rms_mm), key=lambda part: -part.rms_mm))

    def remedied(self, name: str, probability: float) -> Remedy:
        """What a remedy of that name leaves, which led to these errors."""
        largest = next((part.name for part in self.told), "")
        return Remedy(name=name, within_mm=_within(self.distances(), probability), largest=largest)

    def _told(self, name: str, bias: FloatArray, maps: FloatArray) -> AccuracyPart:
        sizes = np.linalg.norm(self._across(bias), axis=1)
        across = maps - self.along[:, :, None] * np.einsum("ni,nik->nk", self.along, maps)[:, None]
        return AccuracyPart(
            name=name,
            bias_mm=1e3 * float(sizes.max()),
            sigma_mm=1e3 * float(np.sqrt((across**2).sum(axis=(1, 2))).max()),
        )

    def _across(self, vectors: FloatArray) -> FloatArray:
        """What of vectors (..., N, 3) is across the path."""
        along = self.along.astype(vectors.dtype)
        return np.asarray(vectors - np.einsum("...ni,ni->...n", vectors, along)[..., None] * along)

    @cached_property
    def off_path(self) -> FloatArray:
        """Errors (D, N, 3), m, across the path, of D draws, in single precision."""
        once = [part for part in self.parts if not part.changes]
        uniform = _stratified(sum(part.maps.shape[2] for part in once))
        columns, sway, at = list[FloatArray](), self.sway[1], 0
        for part in once:
            unit = uniform[:, at : at + part.maps.shape[2]]
            at += part.maps.shape[2]
            if part.name == "stiffness" and part.is_uniform:
                sway = self._swaying(2 * unit[:, 0] - 1)
                unit = 0.5 + 0.5 * self._more_compliant(2 * unit - 1)
            columns.append(np.sqrt(12) * (unit - 0.5) if part.is_uniform else ndtri(unit))
        draws = np.concatenate(columns, axis=1).astype(np.float32)
        maps = np.concatenate([part.maps for part in once], axis=2).astype(np.float32)
        known = self.planned + sum((part.bias for part in self.parts), np.zeros_like(self.planned))
        drawn = (draws @ maps.reshape(-1, maps.shape[2]).T).reshape(len(draws), *known.shape)
        errors = drawn + (known + sway).astype(np.float32) + self._changing()
        if self.shaking is not None:
            errors += self.shaking[np.arange(len(errors)) % len(self.shaking)].astype(np.float32)
        return self._across(errors)

    def _changing(self) -> FloatArray:
        """What changes from posture to posture (D, N, 3): the sum of many small parts, taken to be normal."""
        maps = [part.maps for part in self.parts if part.changes]
        if not maps:
            return np.zeros(1, dtype=np.float32)
        joined = np.concatenate(maps, axis=2)
        values, vectors = np.linalg.eigh(joined @ joined.transpose(0, 2, 1))
        roots = (vectors * np.sqrt(np.maximum(values, 0.0))[:, None]).astype(np.float32)
        return np.asarray(np.einsum("nik,dnk->dni", roots, _normal(len(roots)), optimize=True))

    def _more_compliant(self, share: FloatArray) -> FloatArray:
        """Return what the stiffness' part takes for a share: the sag goes with 1 / (1 + s), not 1 - s."""
        return share / (1 + self.share * share)

    def _swaying(self, share: FloatArray) -> FloatArray:
        """Sway (D, N, 3) of stiffness between the least (-1) and the largest (1), interpolated."""
        low, stated, high = self.sway.astype(np.float32)
        soft, stiff = np.maximum(-share, 0.0), np.maximum(share, 0.0)
        weights = np.stack([soft, 1 - soft - stiff, stiff], axis=1).astype(np.float32)
        return np.asarray(np.einsum("ds,sni->dni", weights, np.stack([low, stated, high])))

    def distances(self) -> FloatArray:
        """Largest distance (D,), m, from the path over the work, of each draw."""
        squares = np.einsum("dni,dni->dn", self.off_path, self.off_path)
        return np.asarray(np.sqrt(squares.max(axis=1)))

    def keeps(self, tolerance: Tolerance) -> BoolArray:
        """Whether each draw (D,) keeps a tolerance all along the work."""
        across = self.off_path
        on_axis = (across * self.axis).sum(axis=2)
        aside = np.sqrt(((across - on_axis[:, :, None] * self.axis) ** 2).sum(axis=2))
        return np.asarray(tolerance.keeps(aside, on_axis).all(axis=1))


def _sampled(
    arm: ElasticArm, work: Work, share: float, *, compensated: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray | None]:
    """Postures, planned errors, directions along the path, tool axes, sway and shaking, of a stroke."""
    t = _times(work)
    q, along = work.motion(t, 0), work.path.leg_directions(t)
    # Where the sag is compensated the bent tool is to be on the path; else its sag is a part of its own.
    sag = Sag(arm).following(q) if compensated else 0.0
    offset = work.path.leg_offset(t, work.commanded(t) + sag)
    leading = np.flatnonzero(along.any(axis=1))
    if len(leading):
        # In a pause the tool is on the leg before it.
        along = along[leading[np.maximum(np.searchsorted(leading, np.arange(len(t)), side="right") - 1, 0)]]
    axis = np.broadcast_to(work.rotation(t)[:, :, 2], along.shape)
    shaking = work.shaking
    return (
        *(q, offset, along, axis, _integrated(arm, work, share)),
        None if shaking is None else _largest(t, shaking.t, shaking.tool),
    )


def _times(work: Work) -> FloatArray:
    """Times (N,) at which the postures of a stroke are taken, s."""
    count = int(np.clip(np.ceil(work.path.duration / _POSTURE_INTERVAL_S), 8, _MAX_STROKE_POSTURES))
    return np.linspace(0.0, work.path.duration, count + 1)


def _integrated(arm: ElasticArm, work: Work, share: float) -> FloatArray:
    """Sway (3, N, 3), m, with the least stiffness, the stated one and the largest."""
    factors, damping = (1 - share, 1.0, 1 + share), arm.robot.damping_ratio
    sway = work.sway or sway_along(arm, work.motion, work.path.duration, damping, factors, sets_in=True)
    return _largest(_times(work), sway.t, sway.tool.transpose(1, 0, 2))


def _largest(t: FloatArray, times: FloatArray, tool: FloatArray) -> FloatArray:
    """Largest (R, N, 3) of displacements (S, R, 3) at `times` (S,), from each of `t` (N,) to the next."""
    cell = np.searchsorted(t, times, side="right") - 1
    cell[times > t[-1]] = len(t)
    largest = np.zeros((tool.shape[1], len(t), 3))
    for k in range(len(t)):
        inside = tool[cell == k]
        if len(inside):
            at = (inside**2).sum(axis=2).argmax(axis=0)
            largest[:, k] = inside[at, np.arange(len(at))]
    return largest


@lru_cache(maxsize=4)
def _stratified(dimension: int) -> FloatArray:
    """Numbers (D, dimension) within 0 and 1: a Latin hypercube (McKay et al., 1979)."""
    rng = np.random.default_rng(_DRAW_SEED)
    strata = np.repeat(np.arange(_MONTE_CARLO_DRAWS)[:, None], dimension, axis=1)
    return np.asarray((rng.permuted(strata, axis=0) + 0.5) / _MONTE_CARLO_DRAWS)


@lru_cache(maxsize=4)
def _normal(postures: int) -> NDArray[np.float32]:
    """Normal numbers (D, postures, 3)."""
    return np.random.default_rng(_DRAW_SEED).standard_normal(
        (_MONTE_CARLO_DRAWS, postures, 3), dtype=np.float32
    )
