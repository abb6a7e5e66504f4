"""plan.json as pydantic models.

A dataclass whose fields are the entry's keys is read directly. The other entries have keys that are computed
from the fields, numbers in degrees, or null for an infinite number: `made` makes their dataclasses.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from typing import Annotated, Any, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    Field,
    PlainSerializer,
    ValidationInfo,
    WrapValidator,
    model_serializer,
    model_validator,
)

from cmbot.common.errors import PathNotFound
from cmbot.common.validation import FileModel, refusal
from cmbot.hold import AdhesionPeak
from cmbot.planning import (
    APPROACH,
    Choice,
    Compensation,
    ExchangeReport,
    LimitUse,
    LowerBound,
    Seconds,
    Start,
    VibrationSuppression,
)
from cmbot.scene import WORK, PlannerOptions, SceneFile

__all__ = [
    "CertificateFile",
    "EarlierPlanFile",
    "MetricsFile",
    "MotionFile",
    "PlanFile",
    "SegmentFile",
    "StrokeEntries",
    "made",
]

T = TypeVar("T")


def _at_least_zero(*names: str) -> AfterValidator:
    """Check that fields of a dataclass, by default all, are not negative; None is allowed."""

    def check(entry: Any) -> Any:
        for name in names or [field.name for field in fields(entry)]:
            if (value := getattr(entry, name)) is not None and value < 0:
                raise refusal("at least 0", got=value, key=(name,))
        return entry

    return AfterValidator(check)


def _or_infinite(value: object, handler: Callable[[object], float], info: ValidationInfo) -> float:
    infinite = value is None or (info.mode == "python" and value == math.inf)
    return math.inf if infinite else handler(value)


# Larger numbers could not be printed in other units.
_LARGEST = 1e12
NonNegative = Annotated[float, Field(ge=0, le=_LARGEST)]
Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
NullIfInfinite = PlainSerializer(lambda value: None if value == math.inf else value)
OrInfinite = Annotated[float, WrapValidator(_or_infinite), NullIfInfinite]
"""null: infinite."""
Truth = Annotated[bool, BeforeValidator(lambda value: bool(value) if isinstance(value, np.bool_) else value)]


def _moderate(value: float) -> float:
    if math.isfinite(value) and abs(value) > _LARGEST:
        raise refusal(f"null, or at most {_LARGEST:g}", got=value)
    return value


class MetricsFile(FileModel):
    """`MotionMetrics` of one motion, in SI units."""

    peak_guardrail_torque: NonNegative
    mean_guardrail_torque: NonNegative
    rms_guardrail_torque: NonNegative | None = None
    """None in older files."""
    peak_static_guardrail_torque: NonNegative
    min_clearance: Annotated[OrInfinite, AfterValidator(_moderate)]
    max_tool_deviation: NonNegative
    max_tool_rotation: NonNegative
    max_tool_lag: NonNegative | None = None
    """None in older files."""
    limit_use: Annotated[LimitUse, _at_least_zero()]
    adhesion_needed: Annotated[AdhesionPeak, _at_least_zero("peak", "time", "foot")] | None = None
    """null where no foot has a flat contact, and in older files."""
    duration: NonNegative | None = None
    """None in older files."""
    guardrail_torque_integral: NonNegative | None = None
    """None in older files."""


class CheckFile(FileModel):
    """`Check`, and whether it holds."""

    quantity: str
    time: float
    value: OrInfinite
    bound: OrInfinite
    unit: str
    at_least: bool
    holds: Truth


class CertificateFile(FileModel):
    """`Certificate` without the metrics, which the motion has."""

    clearance_bound: OrInfinite
    guardrail_torque_bound: OrInfinite = math.inf
    """Unknown in older files."""
    adhesion_bound: OrInfinite = math.inf
    """null where no foot has a flat contact, and in older files."""
    checks: Annotated[tuple[CheckFile, ...], Field(min_length=1)]


class MotionFile(MetricsFile):
    """Metrics of the strokes, of the free moves, and of the whole job."""

    free: MetricsFile | None = None
    """null without free moves, and in older files."""
    job: MetricsFile | None = None
    """null in older files."""


class SegmentFile(MetricsFile):
    """Metrics, times in s and certificate of a `Segment`."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    kind: Literal["stroke", "free"]
    begin: NonNegative
    """On the job's clock."""
    seconds: Annotated[float, Field(gt=0)]
    along_self_motion: bool
    certificate: CertificateFile


class _ApproachFile(MetricsFile):
    seconds: Annotated[float, Field(gt=0)]
    along_self_motion: bool
    certificate: CertificateFile


class SuppressionFile(FileModel):
    """`VibrationSuppression`, and the mean of its shares."""

    modes: Count
    shares: tuple[Share, ...] = ()
    """Empty in files that have only the mean."""
    before: NonNegative
    after: NonNegative
    share: Share
    stiffness: tuple[NonNegative, ...] = ()
    """Empty, as all that follows, in files of before it was simulated."""
    load_kg: tuple[float, ...] = ()
    swing_without: tuple[NonNegative, ...] = ()
    swing_with: tuple[NonNegative, ...] = ()

    def made(self) -> VibrationSuppression:
        """Return it as the planner has it."""
        return made(VibrationSuppression, self, shares=self.shares or (self.share,))


class ObjectiveFile(FileModel):
    """`ObjectiveMetrics`, and the gap to the lower bound."""

    name: Annotated[str, Field(min_length=1)]
    unit: str
    own: bool
    moment_about: Literal["foot", "base"] | None
    axis_weights: tuple[NonNegative, NonNegative, NonNegative] | None
    baseline_peak: NonNegative
    planned_peak: NonNegative
    floor: NonNegative | None
    gap: float | None


class LowerBoundFile(FileModel):
    """`LowerBound`, its array as a list."""

    value: NonNegative
    error: NonNegative
    via_point: Count
    each: tuple[NonNegative, ...]
    kind: Literal["proven", "estimated"] = "estimated"
    """Plans of earlier versions had no proof."""
    missed: Share | None = None
    """Of the postures, at most, with 95 % confidence; null where proven or not known."""

    def made(self) -> LowerBound:
        """Return it as the planner has it."""
        return made(LowerBound, self, each=np.array(self.each))


class FailureFile(FileModel):
    """`PathNotFound`, from one start."""

    reason: str
    time: float
    progress: Share
    smallest_singular_value: float
    pair: tuple[str, str] | None


class StartFile(FileModel):
    """`Start`, in degrees; the posture of an arm with joints that slide in rad and m."""

    posture_deg: Annotated[tuple[float, ...], Field(min_length=1)] | None = None
    posture: Annotated[tuple[float, ...], Field(min_length=1)] | None = None
    moved_deg: NonNegative
    failures: tuple[FailureFile, ...]

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.posture_deg is None) == (self.posture is None):
            both = "none" if self.posture is None else "posture_deg and posture"
            raise refusal("exactly one of these keys", got=both, choices=("posture_deg", "posture"))
        return self

    @model_serializer(mode="wrap")
    def _without_other(self, handler: Callable[[StartFile], dict[str, Any]]) -> dict[str, Any]:
        other = "posture_deg" if self.posture_deg is None else "posture"
        return {key: value for key, value in handler(self).items() if key != other}

    def made(self) -> Start:
        """Return it as the planner has it."""
        return Start(
            posture=np.radians(self.posture_deg) if self.posture_deg else np.array(self.posture, dtype=float),
            moved=math.radians(self.moved_deg),
            failures=tuple(PathNotFound(**dict(failure)) for failure in self.failures),
        )


class HashesFile(FileModel):
    """SHA-256 of the inputs."""

    robot: Sha256
    """`Robot.content_hash`."""
    scene: Sha256
    """`Scene.content_hash` of the scene as it was read."""
    resolved_scene: Sha256
    """The same of the scene in this file, whose paths are absolute."""


class StrokeEntries(FileModel):
    """What is planned of a stroke, or of all of them."""

    baseline: MetricsFile
    suppression: Annotated[
        SuppressionFile | None, Field(validation_alias=AliasChoices("suppression", "quieting"))
    ] = None
    """null: the vibration was not suppressed. Plan directories of earlier versions call it quieting."""
    compensation: Annotated[Compensation, _at_least_zero()] | None = None
    """null: the sag was not compensated."""
    objective: ObjectiveFile
    floor: LowerBoundFile | None
    choice: Annotated[Choice, _at_least_zero()] | None
    start: StartFile
    drift: NonNegative
    """Of the baseline's tool point, m."""
    smallest_singular_value: NonNegative
    """Along the baseline."""
    passes: tuple[Annotated[ExchangeReport, _at_least_zero("number", "iterations", "constraints")], ...]


class StrokePlanFile(StrokeEntries):
    """`StrokePlan`, one of several."""

    name: Annotated[str, Field(min_length=1, max_length=100)]
    baseline_begin: NonNegative
    """When the baseline's stroke begins in ``baseline.csv``, s."""


class _PlanEntries(StrokeEntries):
    """What every version has of a plan but its arrays."""

    format: str
    status: Literal["certified"]
    planned: MetricsFile
    torque_floor: NonNegative | None
    """Of the torque on the guardrail, Nm; null with fixed knots or another objective."""
    torque_floor_kind: Literal["proven", "estimated"] | None = None
    """null without a bound, and in plans of earlier versions, which are estimated."""
    torque_floor_error: NonNegative | None = None
    """How far the true value may lie below the bound, Nm; null where the kind is."""
    gap_to_floor: float | None
    """Planned peak less its lower bound, as a share of the bound."""
    fallbacks: tuple[str, ...] = ()
    seconds: Annotated[Seconds, _at_least_zero()]
    certificate: CertificateFile
    options: PlannerOptions
    scene: Annotated[SceneFile, PlainSerializer(SceneFile.as_data)]
    versions: dict[str, str]
    hashes: HashesFile
    files: dict[str, Sha256]
    """SHA-256 of the files beside this one."""


class PlanFile(_PlanEntries):
    """All of a plan but its arrays."""

    format: Literal["cmbot-plan/1", "cmbot-plan/2"]
    """The first where it is an `EarlierPlanFile`, upgraded."""
    baseline: MotionFile
    planned: MotionFile
    segments: Annotated[tuple[SegmentFile, ...], Field(min_length=1, max_length=10_000)]
    """Of the job, in the order of time."""
    strokes: Annotated[tuple[StrokePlanFile, ...], Field(max_length=200)] = ()
    """Empty where there is one: the plan's entries are its own."""


class EarlierPlanFile(_PlanEntries):
    """A plan of the version before: work and approach, each with files of its own."""

    format: Literal["cmbot-plan/1"]
    approach: _ApproachFile | None
    """null: the work starts in the scene's posture, or the knots are fixed."""

    def upgraded(self, seconds: float) -> PlanFile:
        """Return the plan as this version has it; `seconds` is the duration of the work."""
        before, segments = self.approach, list[SegmentFile]()
        if before is not None:
            segments.append(SegmentFile(name=APPROACH, kind="free", begin=0.0, **dict(before)))
        segments.append(
            SegmentFile(
                name=WORK,
                kind="stroke",
                begin=0.0 if before is None else before.seconds,
                seconds=seconds,
                along_self_motion=False,
                certificate=self.certificate,
                **dict(self.planned),
            )
        )
        motions = {name: MotionFile(**dict(getattr(self, name))) for name in ("baseline", "planned")}
        same = {name: value for name, value in self if name != "approach"}
        return PlanFile(**{**same, **motions, "segments": tuple(segments)})


def made(kind: type[T], entry: FileModel, **changes: object) -> T:
    """Return the dataclass whose fields an entry has among its keys, some of them changed or added."""
    values = dict(entry) | changes
    return kind(**{field.name: values[field.name] for field in fields(kind)})  # type: ignore[arg-type]
