"""How deep the calls are from `cmbot.plan` to the inverse dynamics: a stack is to be read at a glance."""

import sys
from pathlib import Path
from typing import Any

import pytest
from small_scenes import short_scene

import cmbot
from cmbot.robot import Dynamics

MOST_FRAMES = 23
PACKAGE = Path(cmbot.__file__).parent


def test_few_frames_lead_to_the_inverse_dynamics(monkeypatch: pytest.MonkeyPatch) -> None:
    efforts, deepest = Dynamics.efforts, list[str]()

    def measured(self: Dynamics, *states: Any) -> Any:
        nonlocal deepest
        frame, names = sys._getframe(1), ["efforts"]
        while frame is not None and names[-1] != "plan":
            if PACKAGE in Path(frame.f_code.co_filename).parents:
                names.append(frame.f_code.co_name)
            frame = frame.f_back
        deepest = max(deepest, names, key=len)
        return efforts(self, *states)

    monkeypatch.setattr(Dynamics, "efforts", measured)
    cmbot.plan(short_scene(), progress=False)
    assert deepest[-1] == "plan"
    assert len(deepest) <= MOST_FRAMES, " <- ".join(deepest)
