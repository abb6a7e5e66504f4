"""Guardrails as a scene file would describe them, without the rest of the scene."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cmbot.elastic import Guardrail
from cmbot.scene import GuardrailFile, elastic_guardrail

FloatArray = NDArray[np.float64]


def guardrail(**keys: Any) -> Guardrail:
    """The default guardrail with some keys of its block changed."""
    return elastic_guardrail(GuardrailFile(**keys))


def relative_difference(got: FloatArray, expected: FloatArray) -> float:
    """Largest difference of two 6 x 6 matrices, relative to sqrt(A_ii A_jj)."""
    scale = np.sqrt(np.diag(expected))
    return float(np.abs((got - expected) / scale / scale[:, None]).max())
