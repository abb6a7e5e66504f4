"""plan.json: the dataclasses of planning themselves, and what they have beside their fields.

Classes of this module stand where an entry has other keys than the dataclass: a `Segment` has its trajectory
in ``job.npz`` and its figures among its own keys, a `Certificate` has figures that the motion has, a `Start`
is in degrees unless joints slide, and `PathNotFound` is an exception.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from pydantic import (
    ConfigDict,
    Field,
    GetCoreSchemaHandler,
    PlainSerializer,
    TypeAdapter,
    model_serializer,
    model_validator,
)
from pydantic_core import CoreSchema, core_schema

from cmbot.accuracy import Accuracy, Quietness
from cmbot.common.errors import PathNotFound
from cmbot.common.file_types import Count, NonNegative, OrInfinite, Share
from cmbot.common.validation import FileModel, refusal
from cmbot.hold import Foot
from cmbot.planning import (
    Certificate,
    Check,
    Choice,
    Compensation,
    ExchangeReport,
    LowerBound,
    MotionMetrics,
    ObjectiveMetrics,
    Plan,
    Seconds,
    Segment,
    Start,
    StrokeBaseline,
    StrokePlan,
    VibrationSuppression,
)
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.version import versions

T = TypeVar("T")
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Name = Annotated[str, Field(min_length=1, max_length=100)]


class _Beside:
    """Properties that an entry has beside the fields of its dataclass; reading passes over them."""

    def __init__(self, *names: str) -> None:
        self._names = names

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        resolved: Any = handler.resolve_ref_schema(schema)
        arguments = resolved["schema"] | {"extra_behavior": "ignore"}
        write = core_schema.wrap_serializer_function_ser_schema(
            lambda entry, fields_of: fields_of(entry) | {name: getattr(entry, name) for name in self._names},
            schema=schema,
        )
        own: Any = {**resolved, "schema": arguments, "serialization": write}
        own.pop("ref", None)
        entry: CoreSchema = own
        return entry


@dataclass(frozen=True, kw_only=True)
class CertificateFile:
    """`Certificate` without the figures, which the motion has."""

    clearance_bound: OrInfinite
    guardrail_torque_bound: OrInfinite
    adhesion_bound: OrInfinite
    checks: Annotated[tuple[Annotated[Check, _Beside("holds")], ...], Field(min_length=1)]

    @classmethod
    def of(cls, certificate: Certificate) -> Self:
        """Return it of a certificate."""
        return made(cls, certificate)

    def made(self, figures: MotionMetrics) -> Certificate:
        """Return it as the planner has it."""
        return made(Certificate, self, figures=figures)


@dataclass(frozen=True, kw_only=True)
class MotionFile(MotionMetrics):
    """Figures of the strokes, of the free moves, and of the whole job."""

    free: MotionMetrics | None
    job: MotionMetrics


@dataclass(frozen=True, kw_only=True)
class BaselineFile(MotionMetrics):
    """`StrokeBaseline`: its figures, and what it has beside them."""

    drift: NonNegative
    """Of its tool point, m."""
    smallest_singular_value: NonNegative

    @classmethod
    def of(cls, baseline: StrokeBaseline, **own: object) -> Self:
        """Return it of a baseline, with the fields of a class below."""
        names = ("drift", "smallest_singular_value")
        return made(cls, baseline.figures, **({name: getattr(baseline, name) for name in names} | own))


@dataclass(frozen=True, kw_only=True)
class StrokeBaselineFile(BaselineFile):
    """Of one of several strokes."""

    begin: NonNegative
    """In ``baseline.csv``, s."""


@dataclass(frozen=True, kw_only=True)
class JobBaselineFile(BaselineFile, MotionFile):
    """`Baseline`: figures of the strokes, of the free moves, and of the whole job."""


@dataclass(frozen=True, kw_only=True)
class SegmentFile(MotionMetrics):
    """Figures, times in s and certificate of a `Segment`."""

    name: Name
    kind: Literal["stroke", "free"]
    begin: NonNegative
    """On the job's clock."""
    seconds: Annotated[float, Field(gt=0)]
    along_self_motion: bool
    certificate: CertificateFile

    @classmethod
    def of(cls, segment: Segment) -> Self:
        """Return it of a segment."""
        certificate = CertificateFile.of(segment.certificate)
        names = ("name", "kind", "begin", "along_self_motion")
        own = {name: getattr(segment, name) for name in names}
        return made(cls, segment.figures, **own, seconds=segment.duration, certificate=certificate)


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
    def _without_other(self, handler: Any) -> dict[str, Any]:
        other = "posture_deg" if self.posture_deg is None else "posture"
        return {key: value for key, value in handler(self).items() if key != other}

    @classmethod
    def of(cls, start: Start, robot: Robot) -> StartFile:
        """Return it of a start."""
        slides = bool(robot.limits.prismatic.any())
        failures = [
            FailureFile(**{name: getattr(each, name) for name in FailureFile.model_fields})
            for each in start.failures
        ]
        return cls(
            posture=tuple(start.posture.tolist()) if slides else None,
            posture_deg=None if slides else tuple(np.degrees(start.posture).tolist()),
            moved_deg=float(np.degrees(start.moved)),
            failures=tuple(failures),
        )

    def made(self) -> Start:
        """Return it as the planner has it."""
        return Start(
            posture=np.radians(self.posture_deg) if self.posture_deg else np.array(self.posture, dtype=float),
            moved=math.radians(self.moved_deg),
            failures=tuple(PathNotFound(**dict(failure)) for failure in self.failures),
        )


@dataclass(frozen=True, kw_only=True)
class StrokeEntries:
    """What is planned of a stroke, or of all of them."""

    baseline: BaselineFile | None
    """null: none is asked for."""
    suppression: Annotated[VibrationSuppression, _Beside("share")] | None
    """null: the vibration was not suppressed."""
    compensation: Compensation | None
    """null: the sag was not compensated."""
    objective: Annotated[ObjectiveMetrics, _Beside("gap")]
    floor: LowerBound | None
    choice: Choice | None
    start: StartFile
    passes: tuple[ExchangeReport, ...]
    runs: Count
    """Of optimise-and-certify that it took."""

    @classmethod
    def of(cls, stroke: StrokePlan, robot: Robot, **own: object) -> Self:
        """Return it of what is planned of a stroke, with the fields of a class below."""
        start = StartFile.of(stroke.start, robot)
        return made(cls, stroke, **({"floor": stroke.lower_bound, "start": start} | own))


@dataclass(frozen=True, kw_only=True)
class StrokeFile(StrokeEntries):
    """`StrokePlan`, one of several."""

    name: Name
    baseline: StrokeBaselineFile | None


@dataclass(frozen=True, kw_only=True)
class ContactFile:
    """The flat contact of a foot."""

    area_cm2: NonNegative
    outline_m: tuple[tuple[tuple[float, float], ...], ...]
    """Its parts, along and across the member from its centroid."""


@dataclass(frozen=True, kw_only=True)
class HoldingJointFile:
    """A locked joint between a foot and the arm's base."""

    peak_nm: NonNegative
    """Largest torque that it holds over the whole job."""
    limit_nm: OrInfinite
    """What it holds, by the limits file or the URDF; null where neither says it."""


@dataclass(frozen=True, kw_only=True)
class HashesFile:
    """SHA-256 of the inputs."""

    robot: Sha256
    """`Robot.content_hash`."""
    scene: Sha256
    """`Scene.content_hash`."""


@dataclass(frozen=True, kw_only=True)
class PlanFile(StrokeEntries):
    """All of a plan but its arrays, and but the hashes of the other files and of this one."""

    __pydantic_config__: ClassVar[ConfigDict] = FileModel.model_config

    format: Literal["cmbot-plan/2"] = "cmbot-plan/2"
    status: Literal["certified"] = "certified"
    baseline: JobBaselineFile | None
    planned: MotionFile
    segments: Annotated[tuple[SegmentFile, ...], Field(min_length=1, max_length=10_000)]
    """Of the job, in the order of time."""
    strokes: Annotated[tuple[StrokeFile, ...], Field(max_length=200)]
    """Empty where there is one: the plan's entries are its own."""
    torque_floor: NonNegative | None
    """Of the torque on the guardrail, Nm; null with fixed knots or another objective."""
    torque_floor_kind: Literal["proven", "estimated"] | None
    """null without a bound."""
    torque_floor_error: NonNegative | None
    """How far the true value may lie below the bound, Nm; null without one."""
    gap_to_floor: float | None
    """Planned peak less its lower bound, as a share of the bound."""
    accuracy: Accuracy | None
    sway: Quietness | None
    """Where the tool is beside its path; null where nothing bends."""
    contact: tuple[ContactFile | None, ...]
    """Of each foot; null on a round bar."""
    holding_joints: dict[str, HoldingJointFile]
    """By their names; empty where nothing is locked there."""
    missing: tuple[str, ...]
    """Strokes of what was asked that could not be planned; empty unless that was allowed."""
    fallbacks: tuple[str, ...]
    stopped: Literal["time"] | None
    """``time``: planning was stopped by its time limit; null: the plan is the same on every machine."""
    seconds: Seconds
    certificate: CertificateFile
    options: PlannerOptions
    scene: Annotated[Scene, PlainSerializer(Scene.as_data)]
    versions: dict[str, str]
    hashes: HashesFile

    @classmethod
    def of_plan(cls, plan: Plan, hashes: HashesFile) -> PlanFile:
        """Return it of a plan."""
        planned = made(MotionFile, plan.figures, free=plan.job.free_figures, job=plan.job.figures)
        return cls.of(
            plan,
            plan.robot,
            format="cmbot-plan/2",
            status="certified" if plan.job.certificate.holds else "a promise is broken",
            baseline=_job_baseline(plan),
            planned=planned,
            contact=tuple(map(_contact, plan.robot.feet)),
            holding_joints=_holding_joints(plan),
            segments=tuple(map(SegmentFile.of, plan.job.segments)),
            strokes=tuple(
                StrokeFile.of(stroke, plan.robot, name=stroke.name, baseline=baseline)
                for stroke, baseline in zip(plan.several, _stroke_baselines(plan), strict=True)
            ),
            certificate=CertificateFile.of(plan.certificate),
            scene=plan.scene,
            versions=versions(),
            hashes=hashes,
        )

    def as_data(self) -> dict[str, Any]:
        """Return it ready for JSON; what is looked for comes first."""
        data: dict[str, Any] = TypeAdapter(PlanFile).dump_python(self, mode="json")
        first = {name: data[name] for name in ("format", "status", "baseline", "planned")}
        return first | data


def _contact(foot: Foot) -> ContactFile | None:
    """The contact of a foot."""
    if foot.contact is None:
        return None
    return ContactFile(area_cm2=round(1e4 * foot.contact.area, 6), outline_m=foot.contact.outline)


def _holding_joints(plan: Plan) -> dict[str, HoldingJointFile]:
    """What locked joints hold over the job."""
    joints, peaks = plan.robot.holding_joints, plan.holding_torque.tolist()
    return {
        joint.name: HoldingJointFile(peak_nm=peak, limit_nm=joint.limit)
        for joint, peak in zip(joints, peaks, strict=True)
    }


def _job_baseline(plan: Plan) -> JobBaselineFile | None:
    """The baseline of a plan."""
    if (baseline := plan.baseline) is None:
        return None
    return JobBaselineFile.of(baseline, free=baseline.free_figures, job=baseline.job_figures)


def _stroke_baselines(plan: Plan) -> Iterator[StrokeBaselineFile | None]:
    """The baseline of each of several strokes."""
    for number, stroke in enumerate(plan.several):
        if plan.baseline is None or stroke.baseline is None:
            yield None
        else:
            strokes = plan.baseline.strokes
            begin = strokes[number].begin - strokes[0].begin
            yield StrokeBaselineFile.of(stroke.baseline, begin=begin)


def made(kind: type[T], source: object, /, **changes: object) -> T:
    """Return the dataclass whose fields are attributes of `source`, some of them changed or added."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    return kind(**{name: changes[name] if name in changes else getattr(source, name) for name in names})


def hashes_of(plan: Plan) -> HashesFile:
    """Return the hashes of what a plan was made from.

    Raises
    ------
    SceneError
        When a file that its scene names is missing.
    """
    scene = plan.scene
    Scene.of(scene.as_data(), scene.source, Path.cwd())  # what could not be read back is not written
    return HashesFile(robot=plan.robot.content_hash, scene=scene.content_hash)
