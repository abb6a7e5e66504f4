"""Waypoints: the poses through which a path leads the tool."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from cmbot.common.reading.fields import Coordinate
from cmbot.common.reading.validation import refusal

# A unit quaternion up to what files round.
_QUATERNION_TOLERANCE = 1e-3


def _unit_quaternion(row: tuple[float, ...]) -> tuple[float, ...]:
    if abs(float(np.linalg.norm(row[3:])) - 1.0) > _QUATERNION_TOLERANCE:
        raise refusal("x, y, z and a unit quaternion qw, qx, qy, qz", got=row)
    return row


Waypoint = Annotated[
    tuple[Coordinate, ...], Field(min_length=7, max_length=7), AfterValidator(_unit_quaternion)
]
"""Point, m, and unit quaternion (w, x, y, z) of the tool in W."""
