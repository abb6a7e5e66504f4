"""What plan.json says of the objective: what was made small, its floor, and the choice of the start."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.validation import FileModel
from cmbot.planning import LowerBound, ObjectiveMetrics
from cmbot.planning.initial_guess import Choice

__all__ = ["ChoiceFile", "Count", "FloorFile", "NonNegative", "ObjectiveFile"]

NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]


class FloorFile(FileModel):
    """What of the objective no admissible plan can go below at rest."""

    value: NonNegative
    error: NonNegative
    """The true value lies at most so far below it."""
    via_point: Count
    """Index, from 0, of the via-point that sets it."""
    each: tuple[NonNegative, ...]
    """The smallest value at every via-point."""

    def lower_bound(self) -> LowerBound:
        """Return it as the planner has it."""
        return LowerBound(
            value=self.value, error=self.error, via_point=self.via_point, each=np.array(self.each)
        )


class ObjectiveFile(FileModel):
    """What was made small, and how small."""

    name: Annotated[str, Field(min_length=1)]
    unit: str
    """Empty: nobody said."""
    own: bool
    """A function of someone's own in Python: its figures cannot be checked again."""
    moment_about: Literal["foot", "base"] | None
    axis_weights: tuple[NonNegative, NonNegative, NonNegative] | None
    baseline_peak: NonNegative
    planned_peak: NonNegative
    floor: NonNegative | None
    gap: float | None
    """How far the planned peak lies above the floor, as a share of it."""

    def figures(self) -> ObjectiveMetrics:
        """Return it as the planner has it."""
        return ObjectiveMetrics(**self.model_dump(exclude={"gap"}))


class ChoiceFile(FileModel):
    """Peak of the objective at rest, by the global stage, for each choice of the start; null: no way."""

    free: NonNegative | None
    pinned: NonNegative | None

    def choice(self) -> Choice:
        """Return it as the planner has it."""
        return Choice(free=self.free, pinned=self.pinned)
