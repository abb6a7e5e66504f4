"""What is not known of an arm, its base and its work, and the tolerance that is asked for."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field, WrapValidator

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.reading.fields import read_as
from cmbot.common.reading.validation import FileModel

Millimetres = Annotated[float, Field(ge=0, le=1000)]
Degrees = Annotated[float, Field(ge=0, le=90)]


class Placement(FileModel):
    """How exactly a place is known: standard deviations along and about each axis."""

    mm: Millimetres = 0.0
    deg: Degrees = 0.0


class JointUncertainty(FileModel):
    """Of every joint that turns."""

    calibration_deg: Degrees = 0.02
    """Standard deviation of its zero, the same all along a job."""
    backlash_arcmin: Annotated[float, Field(ge=0, le=600)] = 1.0
    """Play from end to end; where in it the joint is, is not known."""
    friction_share: Annotated[float, Field(ge=0, le=1)] = 0.1
    """Of its torque, by which the torque in an elastic drive may be more or less."""


class Uncertainty(FileModel):
    """What is not known. Every default is an assumption of ours, see docs/accuracy.md."""

    stiffness_share: Annotated[float, Field(ge=0, le=0.9)] = 0.3
    """By which all stiffness may be more or less, where none is identified."""
    payload_kg: Annotated[float, Field(ge=0, le=1e3)] = 1.0
    """Up to which there may be more at the tool: a hose, a nozzle."""
    foot: Placement = Placement(mm=2.0, deg=0.2)
    """Of what the robot stands on."""
    workpiece: Placement = Placement()
    """Of the tool path, about its middle."""
    joints: JointUncertainty = JointUncertainty()
    temperature_k: Annotated[float, Field(ge=0, le=100)] = 5.0
    """Difference across a link's tube, as the sun makes it."""

    @classmethod
    def none(cls) -> Uncertainty:
        """Return that of a world in which everything is as modelled."""
        joints = JointUncertainty(calibration_deg=0.0, backlash_arcmin=0.0, friction_share=0.0)
        return cls(stiffness_share=0.0, payload_kg=0.0, foot=Placement(), joints=joints, temperature_k=0.0)


def _none_or(value: Any, block: Any) -> Uncertainty:
    """What the word stands for, or what `block` makes of a mapping: one error, not those of a union."""
    checked: Uncertainty = Uncertainty.none() if value == "none" else block(value)
    return checked


UncertaintyOrNone = Annotated[
    Uncertainty, read_as(Annotated[Uncertainty, WrapValidator(_none_or)], ("none",))
]
"""What is not known; ``none``: nothing."""


class Tolerance(FileModel):
    """How far the tool may be from its path."""

    across_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Across the path and the tool's axis; left out: any distance."""
    along_axis_mm: Annotated[float, Field(gt=0, le=1000)] | None = None
    """Along the tool's axis, such as the stand-off; left out: any distance."""
    probability: Annotated[float, Field(ge=0.5, le=0.999)] = 0.95
    """With which both are kept all along the work."""

    def keeps(self, across: FloatArray, along: FloatArray) -> BoolArray:
        """Return whether distances across path and axis, and with a sign along it, m, are within it."""
        most = (np.inf if mm is None else mm / 1e3 for mm in (self.across_mm, self.along_axis_mm))
        return np.logical_and(
            *(np.abs(off) <= bound for off, bound in zip((across, along), most, strict=True))
        )
