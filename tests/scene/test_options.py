"""Every number in a scene, in the planner's options and in those of the simulation has sane bounds."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import pytest
from pydantic import TypeAdapter

import cmbot
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import validated
from cmbot.scene import PlannerOptions, Scene
from cmbot.simulation import SimulationOptions

LARGEST = 1e15


def unbounded(node: Any, place: str = "") -> Iterator[str]:
    """Places in a JSON Schema of numbers without bounds, text and lists without a largest size."""
    if isinstance(node, list):
        for k, item in enumerate(node):
            yield from unbounded(item, f"{place}[{k}]")
    if not isinstance(node, dict):
        return
    kind = node.get("type")
    if kind in ("number", "integer"):
        least = node.get("minimum", node.get("exclusiveMinimum", -1e300))
        most = node.get("maximum", node.get("exclusiveMaximum", 1e300))
        if not -LARGEST <= least <= most <= LARGEST:
            yield place
    if kind == "array" and "maxItems" not in node:
        yield place
    if kind == "string" and not node.keys() & {"maxLength", "pattern", "enum", "const"}:
        yield place
    for key, child in node.items():
        if key not in ("default", "enum", "const", "required"):
            yield from unbounded(child, f"{place}.{key}")


@pytest.mark.parametrize("kind", [Scene, PlannerOptions, SimulationOptions])
def test_everything_is_bounded(kind: type) -> None:
    assert list(unbounded(TypeAdapter(kind).json_schema())) == []


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("max_tool_deviation_m", 1e100),
        ("max_tool_deviation_m", 1e-9),
        ("chart_seeds", 2147483648),
        ("chart_spacing", 1e-9),
        ("path_step_s", 1e-300),
        ("safety_margin_m", 1e9),
        ("drift_gain", 1e308),
        ("max_passes", 10**9),
        ("smoothing_weight", 5e-324),
    ],
)
def test_an_option_out_of_bounds_is_named(option: str, value: float) -> None:
    with pytest.raises(InputError, match=f"^--set: {option}: got .*, expected at (least|most) "):
        validated(PlannerOptions, {option: value}, "--set", InputError)


def test_values_that_people_use_are_within_the_bounds() -> None:
    used = {
        "avoidance_distance_m": (0.01, 1.0),
        "centre_of_gravity_weight": (0.1, 10),
        "max_tool_deviation_m": (1e-6, 0.1),
        "safety_margin_m": (0, 0.5),
        "path_step_s": (0.001, 0.1),
        "other_starts": (0, 1000),
        "chart_seeds": (1, 5000),
        "smoothing_weight": (1e-6, 10),
        "max_iterations": (1, 10_000),
    }
    for option, values in used.items():
        for value in values:
            validated(PlannerOptions, {option: value}, "options", InputError)
    assert used.keys() <= {field.name for field in fields(PlannerOptions)}


def test_a_tool_path_of_days_is_refused() -> None:
    legs = [{"by": [0, 0, 1], "seconds": 30_000}, {"by": [0, 0, -1], "seconds": 7_000}]
    scene = {
        "format": "cmbot-scene/2",
        "name": "slow",
        "start": {"posture_deg": [0]},
        "tool_path": {"legs": legs},
    }
    with pytest.raises(InputError, match=r"tool_path\.legs: got 37000 s, expected legs of at most 36,000 s"):
        cmbot.load_scene(scene)
