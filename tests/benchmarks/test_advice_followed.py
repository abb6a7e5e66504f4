"""The benchmark of advice changes a scene as a refusal says, and nothing else."""

from __future__ import annotations

from typing import Any

import pytest
from advice import followed

SCENE: dict[str, Any] = {
    "tool_path": {"legs": [{"by": [0, 1, 0], "seconds": 2.0}, {"by": [0, 0, 1], "speed_m_s": 0.1}]},
}


@pytest.mark.parametrize(
    ("words", "legs", "others"),
    [
        ("tool_path.legs[0].seconds 3.1 instead of 2 would do", [3.1, 0.1], {}),
        (
            "tool_path.legs[0].seconds 3 instead of 2 and "
            "tool_path.legs[1].speed_m_s 0.05 instead of 0.1 would do",
            [3.0, 0.05],
            {},
        ),
        (
            "planner.safety_margin_m 0.014 instead of 0.02 would do",
            [2.0, 0.1],
            {"planner": {"safety_margin_m": 0.014}},
        ),
        ("tool_path.keep axis instead of pose would do", [2.0, 0.1], {"tool_path": {"keep": "axis"}}),
    ],
)
def test_values_take_the_place_of_those_before(words: str, legs: list[float], others: dict[str, Any]) -> None:
    changed = followed(SCENE, words)
    first, second = changed["tool_path"].pop("legs")
    assert [first["seconds"], second["speed_m_s"]] == legs
    assert changed == {"tool_path": {}} | others


def test_the_shortest_time_is_asked_for_once() -> None:
    words = (
        "seconds: auto on the legs of tool_path, with speed_profile: {kind: shortest, ramp: 0.2}, would do"
    )
    assert followed(SCENE, words) == {
        "tool_path": {
            "seconds": "auto",
            "speed_profile": {"kind": "shortest", "ramp": 0.2},
            "legs": [{"by": [0, 1, 0]}, {"by": [0, 0, 1]}],
        }
    }


def test_an_advice_of_another_form_is_an_error() -> None:
    with pytest.raises(ValueError, match="another form"):
        followed(SCENE, "something else would do")
