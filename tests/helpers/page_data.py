"""Pages for tests: plans to make them of, and the data for their scripts, read back."""

import base64
import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from obstacle_entries import renamed

from cmbot.planning import Plan


def floats(packed: str, *shape: int) -> np.ndarray:
    """An array of the page; `shape` is that of a row."""
    return np.frombuffer(base64.b64decode(packed), "<f4").astype(float).reshape(-1, *shape)


def data_of(text: str) -> dict[str, Any]:

    pattern = r'<script type="application/json" id="(?:replay-)?data">(.*?)</script>'
    found = re.search(pattern, text, re.DOTALL)
    assert found
    data: dict[str, Any] = json.loads(found[1])
    return data


def without_shapes(plan: Plan) -> Plan:
    """The plan of a robot without visual meshes: a browser opens its pages quickly."""
    return replace(plan, robot=replace(plan.robot, read_visual_model=pin.GeometryModel))


def hostile(plan: Plan, name: str) -> Plan:
    """The plan with this name for its scene, its robot and, numbered, its obstacles."""
    valid = name.encode("utf-8", "ignore").decode()  # pinocchio requires UTF-8
    scene = renamed(plan.scene, name, (f"{valid}{k}" for k in range(len(plan.scene.obstacles))))
    return replace(plan, scene=scene, robot=replace(plan.robot, name=name))
