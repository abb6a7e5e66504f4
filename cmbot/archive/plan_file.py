"""plan.json: what a plan is read from, checked by type, and the record of a plan, which has all that follows.

The classes of this module are what is read. Other entries follow from these: they are only written, and when
a plan is read the record of it has to be the one in the file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import ConfigDict, Field

from cmbot.accuracy import Accuracy, Quietness
from cmbot.archive.records import FORMATS, PLAN_FILE
from cmbot.common.errors import PathNotFound
from cmbot.common.reading.file_types import Count, NonNegative, OrInfinite, Share
from cmbot.common.reading.validation import FileModel, adapter
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
    StrokeBaseline,
    StrokePlan,
)
from cmbot.robot import Robot
from cmbot.scene import PlannerOptions, Scene
from cmbot.version import versions

T = TypeVar("T")
Name = Annotated[str, Field(min_length=1, max_length=100)]


@dataclass(frozen=True, kw_only=True)
class CertificateFile:
    """`Certificate` without the figures, which the motion has."""

    clearance_bound: OrInfinite
    guardrail_torque_bound: OrInfinite
    adhesion_bound: OrInfinite
    checks: Annotated[tuple[Check, ...], Field(min_length=1)]


@dataclass(frozen=True, kw_only=True)
class BaselineFile(MotionMetrics):
    """`StrokeBaseline`: its figures, and what it has beside them."""

    drift: NonNegative
    smallest_singular_value: NonNegative
    begin: NonNegative = 0.0
    """In ``baseline.csv``, s, of one of several strokes."""


@dataclass(frozen=True, kw_only=True)
class SegmentFile(MotionMetrics):
    """Figures, duration and certificate of a `Segment`."""

    name: Name
    kind: Literal["stroke", "free"]
    seconds: Annotated[float, Field(gt=0)]
    along_self_motion: bool
    certificate: CertificateFile


@dataclass(frozen=True, kw_only=True)
class FailureFile:
    """`PathNotFound`, from one start."""

    reason: str
    time: float
    progress: Share
    smallest_singular_value: float
    pair: tuple[str, str] | None

    def made(self) -> PathNotFound:
        """Return it as the planner has it."""
        return PathNotFound(**vars(self))


@dataclass(frozen=True, kw_only=True)
class StartFile:
    """`Start`, whose posture is that of the first knot."""

    failures: tuple[FailureFile, ...]


@dataclass(frozen=True, kw_only=True)
class StrokeEntries:
    """What is planned of a stroke, or of all of them."""

    baseline: BaselineFile | None
    compensation: Compensation | None
    objective: ObjectiveMetrics
    floor: LowerBound | None
    choice: Choice | None
    start: StartFile
    passes: tuple[ExchangeReport, ...]
    runs: Count


@dataclass(frozen=True, kw_only=True)
class StrokeFile(StrokeEntries):
    """`StrokePlan`, one of several."""

    name: Name


@dataclass(frozen=True, kw_only=True)
class HashesFile:
    """SHA-256 of the inputs: `Robot.content_hash` and `Scene.content_hash`."""

    robot: str
    scene: str


@dataclass(frozen=True, kw_only=True)
class PlanFile(StrokeEntries):
    """What a plan is read from, but for its arrays."""

    __pydantic_config__: ClassVar[ConfigDict] = FileModel.model_config | ConfigDict(extra="ignore")

    status: Literal["certified"]
    segments: Annotated[tuple[SegmentFile, ...], Field(min_length=1, max_length=10_000)]
    strokes: Annotated[tuple[StrokeFile, ...], Field(max_length=200)]
    """Empty where there is one: the plan's entries are its own."""
    accuracy: Accuracy | None
    sway: Quietness | None
    missing: tuple[str, ...]
    fallbacks: tuple[str, ...]
    stopped: Literal["time"] | None
    seconds: Seconds
    options: PlannerOptions
    scene: Scene
    hashes: HashesFile


def made(kind: type[T], source: object, /, **changes: object) -> T:
    """Return the dataclass whose fields are attributes of `source`, some of them changed or added."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    return kind(**{name: changes[name] if name in changes else getattr(source, name) for name in names})


def plan_record(plan: Plan, hashes: HashesFile) -> dict[str, Any]:
    """Return what plan.json says of a plan but for the hashes of files; what is looked for comes first."""
    data: dict[str, Any] = {"format": FORMATS[PLAN_FILE]}
    data["status"] = "certified" if plan.job.certificate.holds else "a promise is broken"
    data["baseline"] = _baseline(plan.baseline)
    if plan.baseline is not None:
        free, job = plan.baseline.free_figures, plan.baseline.job_figures
        data["baseline"] |= {"free": _data(free), "job": _data(job)}
    free, job = plan.job.free_figures, plan.job.figures
    data["planned"] = {**_data(plan.figures), "free": _data(free), "job": _data(job)}
    data |= _stroke(plan, plan.robot)
    data["segments"] = [_segment(segment) for segment in plan.job.segments]
    data["strokes"] = [
        {"name": stroke.name, "baseline": _baseline(stroke.baseline), **_stroke(stroke, plan.robot)}
        for stroke in plan.several
    ]
    if plan.baseline is not None:
        for entry, segment in zip(data["strokes"], plan.baseline.strokes, strict=False):
            entry["baseline"]["begin"] = segment.begin - plan.baseline.strokes[0].begin
    data["certificate"] = _certificate(plan.certificate)
    for name in ("torque_floor", "torque_floor_kind", "torque_floor_error", "gap_to_floor", "stopped"):
        data[name] = getattr(plan, name)
    data |= {name: _data(getattr(plan, name)) for name in ("accuracy", "sway", "seconds", "options")}
    data |= {"missing": list(plan.missing), "fallbacks": list(plan.fallbacks)}
    feet, joints, peaks = plan.robot.feet, plan.robot.holding_joints, plan.holding_torque
    data["contact"] = [
        foot.contact and {"area_cm2": round(1e4 * foot.contact.area, 6), "outline_m": foot.contact.outline}
        for foot in feet
    ]
    data["holding_joints"] = {
        joint.name: {"peak_nm": float(peak), "limit_nm": joint.limit if math.isfinite(joint.limit) else None}
        for joint, peak in zip(joints, peaks, strict=True)
    }
    return data | {"scene": plan.scene.as_data(), "versions": versions(), "hashes": _data(hashes)}


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


def _data(value: object) -> Any:
    """A dataclass as its types say that files have it."""
    kind: Any = type(value)
    return None if value is None else adapter(kind).dump_python(value, mode="json")


def _stroke(stroke: StrokePlan, robot: Robot) -> dict[str, Any]:
    """What is planned of a stroke, or of all of them, beside its motion and the baseline's."""
    start, data = stroke.start, {"compensation": _data(stroke.compensation)}
    data["objective"] = {**_data(stroke.objective), "gap": stroke.objective.gap}
    data |= {"floor": _data(stroke.lower_bound), "choice": _data(stroke.choice)}
    slides = bool(robot.limits.prismatic.any())
    data["start"] = {
        "posture" if slides else "posture_deg": (
            start.posture if slides else np.degrees(start.posture)
        ).tolist(),
        "moved_deg": math.degrees(start.moved),
        "failures": [_data(made(FailureFile, failure)) for failure in start.failures],
    }
    dumped = adapter(ExchangeReport).dump_python
    # Files say what is violated, not when.
    passes = [dumped(report, mode="json", exclude={"worst": {"time"}}) for report in stroke.passes]
    return data | {"passes": passes, "runs": stroke.runs}


def _baseline(baseline: StrokeBaseline | None) -> dict[str, Any] | None:
    if baseline is None:
        return None
    beside = {name: getattr(baseline, name) for name in ("drift", "smallest_singular_value")}
    return {**_data(baseline.figures), **beside}


def _segment(segment: Segment) -> dict[str, Any]:
    own = {name: getattr(segment, name) for name in ("name", "kind", "begin", "along_self_motion")}
    own |= {"seconds": segment.duration, "certificate": _certificate(segment.certificate)}
    return {**_data(segment.figures), **own}


def _certificate(certificate: Certificate) -> dict[str, Any]:
    data: dict[str, Any] = _data(made(CertificateFile, certificate))
    for entry, check in zip(data["checks"], certificate.checks, strict=True):
        entry["holds"] = check.holds
    return data
