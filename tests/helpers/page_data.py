"""What stands in a page for its scripts, read back."""

import base64
import json
import re
from typing import Any

import numpy as np


def floats(packed: str, *shape: int) -> np.ndarray:
    """An array of the page; `shape` is that of a row."""
    return np.frombuffer(base64.b64decode(packed), "<f4").astype(float).reshape(-1, *shape)


def data_of(text: str) -> dict[str, Any]:
    """The data of a page."""
    found = re.search(r'<script type="application/json" id="replay-data">(.*?)</script>', text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data
