"""The tool while it is on: the force of the process, and how fast the tool may move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from cmbot.common.reading.fields import no_thousands
from cmbot.common.reading.validation import CheckedFields
from cmbot.scene.robot_entry import MountFile
from cmbot.scene.uncertainty import Tolerance

SPEED_TOLERANCE = 0.05
"""By what share the arm's tool may exceed the largest speed of the tool path between via-points."""

# The bound, 10 kN, catches millinewtons given for newtons.
Force = Annotated[float, Field(ge=-1e4, le=1e4)]


@dataclass(frozen=True, kw_only=True)
class Tool(CheckedFields):
    """The process force and the largest speed while the tool is on: along the tool path, not on free moves.

    Attributes
    ----------
    process_force_n : three floats
        Force that acts on the tool, at the tool point, along the tool's axes, N. The recoil of a nozzle and
        the steel against which a tool is pressed act along the negative z axis: ``[0, 0, -20]``.
    process_ramp_s : float
        Time in which it sets in before a stroke, and ends after it, s, while the arm stands. 0: at once. Two
        periods of the slowest mode leave hardly any sway.
    max_speed_m_s : float or None
        Largest speed of the tool point, m/s. The tool path keeps it exactly; the arm's tool may exceed it by
        5 % between via-points. Left out: any speed.
    tolerance : Tolerance or None
        How far the tool may be from its path, for the accuracy budget; the planner's options bound the
        motion.
    contact_mm : float
        Length of the tip, along z up to the tool point, that may touch workpieces, mm; where that point
        touches, more than ``planner.safety_margin_m``. At most 10 mm may be in one. On free moves only as
        much of it as touches at their ends, within 2 mm. The rest keeps the margin.
    fixed : MountFile or None
        Pose in W of a tool that stands, such as a grinder, to which the arm holds the part. The path is then
        in the part's frame, the robot's tool frame, for which ``world`` stands. Where its obstacle is a
        workpiece `contact_mm` is of its tip. It has no process force.

    Raises
    ------
    InputError
        When a field is out of its bounds.
    """

    process_force_n: tuple[Force, Force, Force] = (0.0, 0.0, 0.0)
    process_ramp_s: Annotated[float, Field(ge=0, le=6e4), no_thousands(60, "at most 60 s: ms")] = 0.0
    max_speed_m_s: Annotated[float, Field(ge=1e-4, le=100)] | None = None
    tolerance: Tolerance | None = None
    contact_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    fixed: MountFile | None = None
