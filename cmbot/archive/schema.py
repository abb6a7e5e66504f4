"""plan.json as pydantic models, each with the way back to what it was made from."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.archive.goal_schema import ChoiceFile, Count, FloorFile, NonNegative, ObjectiveFile
from cmbot.common.errors import PathNotFound
from cmbot.common.validation import FileModel
from cmbot.optimization.constraint_set import Violation
from cmbot.planning import (
    Certificate,
    Check,
    ExchangeReport,
    LimitUse,
    MotionMetrics,
    Seconds,
    Start,
)
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.planning.flexibility.vibration_suppression import VibrationSuppression
from cmbot.scene import PlannerOptions, SceneFile

__all__ = [
    "ApproachFile",
    "CertificateFile",
    "CheckFile",
    "FailureFile",
    "FiguresFile",
    "HashesFile",
    "LimitUseFile",
    "PassFile",
    "PlanFile",
    "SecondsFile",
    "StartFile",
    "ViolationFile",
    "or_null",
]

Share = Annotated[float, Field(ge=0, le=1)]
Sha256 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


def or_null(value: float) -> float | None:
    """Return a number as JSON can hold it: nothing for plus infinity."""
    return None if value == math.inf else value


def _or_infinite(value: float | None) -> float:
    return math.inf if value is None else value


class LimitUseFile(FileModel):
    """Largest share of each bound that is used; 1 is at the bound."""

    velocity: NonNegative
    acceleration: NonNegative
    jerk: NonNegative
    torque: NonNegative


class FiguresFile(FileModel):
    """The figures of one motion, in SI units."""

    peak_guardrail_torque: NonNegative
    mean_guardrail_torque: NonNegative
    min_clearance: float | None
    """null: there is nothing to be hit."""
    peak_static_guardrail_torque: NonNegative
    max_tool_deviation: NonNegative
    max_tool_rotation: NonNegative
    limit_use: LimitUseFile

    def figures(self) -> MotionMetrics:
        """Return them as the planner has them."""
        use = self.limit_use
        return MotionMetrics(
            peak_guardrail_torque=self.peak_guardrail_torque,
            mean_guardrail_torque=self.mean_guardrail_torque,
            peak_static_guardrail_torque=self.peak_static_guardrail_torque,
            min_clearance=_or_infinite(self.min_clearance),
            max_tool_deviation=self.max_tool_deviation,
            max_tool_rotation=self.max_tool_rotation,
            limit_use=LimitUse(
                velocity=use.velocity, acceleration=use.acceleration, jerk=use.jerk, torque=use.torque
            ),
        )


class SecondsFile(FileModel):
    """Wall time of each stage, s."""

    path: NonNegative
    optimise: NonNegative
    certify: NonNegative
    total: NonNegative

    def seconds(self) -> Seconds:
        """Return them as the planner has them."""
        return Seconds(path=self.path, optimise=self.optimise, certify=self.certify, total=self.total)


class CheckFile(FileModel):
    """One promise of a plan: the worst value found, when, and its bound."""

    quantity: str
    time: float
    value: float | None
    """null: infinite."""
    bound: float | None
    """null: none."""
    unit: str
    at_least: bool
    """The bound is a lower one."""
    holds: bool

    def check(self) -> Check:
        """Return it as the certificate has it."""
        return Check(
            quantity=self.quantity,
            time=self.time,
            value=_or_infinite(self.value),
            bound=_or_infinite(self.bound),
            unit=self.unit,
            at_least=self.at_least,
        )


class CertificateFile(FileModel):
    """What a trajectory was found to do."""

    clearance_bound: float | None
    """No distance is smaller at any time, m; null: there is nothing to be hit."""
    checks: Annotated[tuple[CheckFile, ...], Field(min_length=1)]

    def certificate(self, figures: FiguresFile) -> Certificate:
        """Return it, with its motion's `figures`, as the planner has it."""
        return Certificate(
            checks=tuple(entry.check() for entry in self.checks),
            figures=figures.figures(),
            clearance_bound=_or_infinite(self.clearance_bound),
        )


class ApproachFile(FiguresFile):
    """How the arm gets from the scene's posture to where the work starts: its figures, and more."""

    seconds: Annotated[float, Field(gt=0)]
    """How long it takes, s."""
    along_self_motion: bool
    """The tool stays about where it is."""
    certificate: CertificateFile


class CompensationFile(FileModel):
    """How the predicted sag was compensated."""

    rounds: Count
    largest_shift: NonNegative
    """Of a commanded tool point from where the path has it, m."""
    last_change: NonNegative
    """How far the last round moved any of them still, m."""

    def compensation(self) -> Compensation:
        """Return it as the planner has it."""
        return Compensation(**self.model_dump())


class QuietingFile(FileModel):
    """What was done about the vibration."""

    modes: Count
    share: Share
    """Mean over the legs of how much of it was taken away."""
    shares: tuple[Share, ...] = ()
    """That of each leg; empty in files that do not tell them apart."""
    before: NonNegative
    """Amplitude of the tool that these modes leave at the end, as predicted, m: without the change."""
    after: NonNegative
    """With it."""

    def quieting(self) -> VibrationSuppression:
        """Return it as the planner has it."""
        shares = self.shares or (self.share,)
        return VibrationSuppression(modes=self.modes, shares=shares, before=self.before, after=self.after)


class FailureFile(FileModel):
    """Why no path led on from a starting posture."""

    reason: str
    time: float
    progress: Share
    smallest_singular_value: float
    pair: tuple[str, str] | None

    def failure(self) -> PathNotFound:
        """Return it as it was raised."""
        return PathNotFound(
            self.reason,
            time=self.time,
            progress=self.progress,
            smallest_singular_value=self.smallest_singular_value,
            pair=self.pair,
        )


class StartFile(FileModel):
    """Where the motion starts, and why not elsewhere."""

    posture_deg: Annotated[tuple[float, ...], Field(min_length=1)]
    moved_deg: NonNegative
    """Largest difference of a joint from the scene's posture."""
    failures: tuple[FailureFile, ...]

    def start(self) -> Start:
        """Return it as the planner has it."""
        return Start(
            posture=np.radians(self.posture_deg),
            moved=math.radians(self.moved_deg),
            failures=tuple(failure.failure() for failure in self.failures),
        )


class ViolationFile(FileModel):
    """The constraint that is violated most, as a share of its bound."""

    name: str
    value: float


class PassFile(FileModel):
    """A pass of the optimiser."""

    stage: str
    number: Count
    iterations: Count
    constraints: Count
    peak_torque: float
    worst: ViolationFile

    def report(self) -> ExchangeReport:
        """Return it as the optimiser has it."""
        return ExchangeReport(
            stage=self.stage,
            number=self.number,
            iterations=self.iterations,
            constraints=self.constraints,
            peak_torque=self.peak_torque,
            worst=Violation(name=self.worst.name, value=self.worst.value),
        )


class HashesFile(FileModel):
    """SHA-256 of what went in; whether it is still the same is seen by them."""

    robot: Sha256
    """`Robot.content_hash`."""
    scene: Sha256
    """`Scene.content_hash` of the scene as it was read."""
    resolved_scene: Sha256
    """The same of the scene as it stands here, its paths made absolute."""


class PlanFile(FileModel):
    """All of a plan but its arrays."""

    format: Literal["cmbot-plan/1"]
    status: Literal["certified"]
    baseline: FiguresFile
    planned: FiguresFile
    approach: ApproachFile | None
    """null: the work starts in the scene's posture, or the knots are fixed."""
    torque_floor: NonNegative | None
    """Of the torque on the guardrail, Nm; null with fixed knots, and when something else was made small."""
    gap_to_floor: float | None
    """How far the planned peak lies above it, as a share of it."""
    objective: ObjectiveFile
    floor: FloorFile | None
    choice: ChoiceFile | None
    compensation: CompensationFile | None = None
    """null: the sag was not compensated."""
    quieting: QuietingFile | None = None
    """null: nothing was done about the vibration."""
    fallbacks: tuple[str, ...] = ()
    """What did not work, and was done in another way."""
    seconds: SecondsFile
    certificate: CertificateFile
    start: StartFile
    drift: NonNegative
    """Of the baseline's tool point, m."""
    smallest_singular_value: NonNegative
    """Along the baseline."""
    options: PlannerOptions
    scene: SceneFile
    versions: dict[str, str]
    hashes: HashesFile
    files: dict[str, Sha256]
    """SHA-256 of the files beside this one."""
    passes: tuple[PassFile, ...]
