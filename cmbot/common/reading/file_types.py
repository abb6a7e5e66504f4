"""How the fields of dataclasses stand in files: plain annotations, of which pydantic alone makes something.

A dataclass that is written to a file has them on its fields, so that it needs no second class for the file.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from cmbot.common.arrays import FloatArray

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler
    from pydantic_core import CoreSchema

# Larger numbers could not be printed in other units.
_MAX_NUMBER = 1e12


class _NullIfInfinite:
    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        return core_schema.no_info_wrap_validator_function(
            lambda value, check: math.inf if value is None else check(value),
            handler(source),
            serialization=core_schema.plain_serializer_function_ser_schema(
                lambda value: None if value == math.inf else value
            ),
        )


class _Listed:
    def __init__(self, lists: Any) -> None:
        self._lists = lists

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(
            np.array,
            handler.generate_schema(self._lists),
            serialization=core_schema.plain_serializer_function_ser_schema(lambda array: array.tolist()),
        )


NonNegative = Annotated[float, Ge(0), Le(_MAX_NUMBER)]
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(0)]
OrInfinite = Annotated[float, _NullIfInfinite()]
"""null: infinite."""
ModerateOrInfinite = Annotated[float, Ge(-_MAX_NUMBER), Le(_MAX_NUMBER), _NullIfInfinite()]
Row = Annotated[FloatArray, _Listed(tuple[float, ...])]
"""An array (n,), as a list."""
Rows = Annotated[FloatArray, _Listed(tuple[tuple[float, ...], ...])]
"""An array (m, n), as a list of lists."""
Matrices = Annotated[FloatArray, _Listed(tuple[tuple[tuple[float, ...], ...], ...])]
"""An array (k, m, n), as lists of lists of lists."""
