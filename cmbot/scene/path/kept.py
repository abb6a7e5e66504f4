"""What a tool path prescribes of the tool: its pose, its axis, its position, or a cone for its axis."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, GetPydanticSchema, PlainSerializer, WrapValidator

from cmbot.common.validation import FileModel, hint, refusal, shown

__all__ = ["AxisCone", "Keep"]

_NAMES = ("pose", "axis", "position")


class AxisCone(FileModel):
    """The tool point, and a cone about the path's axis that the tool's axis stays in."""

    axis_within_deg: Annotated[float, Field(ge=0.1, le=90)]
    """Largest angle between the tool's axis and that of the path."""

    @property
    def angle(self) -> float:
        """That angle, rad."""
        return math.radians(self.axis_within_deg)

    def __str__(self) -> str:
        return f"axis within {self.axis_within_deg:g} deg"


def _name_or_cone(value: Any, cone: Any) -> Any:
    """One of the names, or what `cone` makes of a mapping: one error, where a union would have several."""
    if value in _NAMES:
        return value
    if isinstance(value, dict | AxisCone):
        return cone(value)
    expected = f"a known value{hint(value, _NAMES)}"
    raise refusal(expected, got=shown(value), choices=(*_NAMES, "{axis_within_deg: 10}"))


def _as_data(kept: Any) -> Any:
    return kept if isinstance(kept, str) else kept.model_dump()


def _json_schema(schema: Any, handler: Any) -> dict[str, Any]:
    # The mapping first: messages name its keys.
    return {"anyOf": [handler(schema), {"enum": list(_NAMES), "type": "string"}]}


Keep = Annotated[
    Literal["pose", "axis", "position"] | AxisCone,
    GetPydanticSchema(
        lambda _, handler: handler(
            Annotated[AxisCone, WrapValidator(_name_or_cone), PlainSerializer(_as_data)]
        ),
        _json_schema,
    ),
]
