"""Walks read back: as they were, and refused where the file contradicts itself or what is computed again."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plan_folders import seal
from walks import one_step

from cmbot.archive import json_bytes, load_walk
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.robot import Climber
from cmbot.stances.walking import walk_data
from cmbot.toolpath import SpeedProfile
from cmbot.trajectory import SplineSpace


@pytest.fixture(scope="module")
def data() -> dict[str, Any]:
    return json.loads(json_bytes(walk_data(one_step())))


def written(data: dict[str, Any], folder: Path) -> Path:
    (folder / "walk.json").write_bytes(seal({**data, "files": {}}))
    return folder


def test_a_walk_is_read_as_it_was_written(data: dict[str, Any], tmp_path: Path) -> None:
    again = json.loads(json_bytes(walk_data(load_walk(written(data, tmp_path)))))
    assert again["words"] == data["words"]
    (step,), (other,) = data["steps"], again["steps"]
    assert (other["from"], other["to"], other["foot"]) == (step["from"], step["to"], step["foot"])
    for one, two in zip(step["moves"], other["moves"], strict=True):
        assert all(one[name] == two[name] for name in ("kind", "holds", "joints", "arm", "knots", "begin"))


def dragged(lift: dict[str, Any]) -> None:
    """Turn a lift into a way beside the rail: foot 1 goes 4 mm aside and comes off no more than by that."""
    angles, climber = np.array(lift["knots"]["q"][0]), Climber()
    X = climber.poses(angles[::-1])[0].copy()
    X[:3, 3] += 0.004 * X[:3, 0]
    aside = min(climber.reaching(X), key=lambda found: float(np.abs(found - angles[::-1]).max()))[::-1]
    u = np.linspace(0.0, 1.0, 20)
    space = SplineSpace(3.0 * u)
    share = SpeedProfile(kind="jerk_limited", ramp=0.5).share(u)[:, None]
    trajectory = space.trajectory(space.least_jerk(angles + share * (aside - angles)))
    lift["knots"] = {name: getattr(trajectory, name).tolist() for name in "tqva"}
    lift["seconds"] = trajectory.duration


CHANGES: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda d: d.update(format="cmbot-walk/2"), "format: got"),
    (lambda d: d.update(colour="red"), "colour"),
    (lambda d: d.pop("goal"), "goal"),
    (lambda d: d["steps"][0]["before"]["foot_1"].update(along_m=4.0), "steps[0].before.climber_deg"),
    (lambda d: d["steps"][0].update(before=d["steps"][0]["after"]), "steps[0].before: got another stance"),
    (lambda d: d["steps"][0].update(after=d["steps"][0]["before"]), "steps[0].after: got another stance"),
    (lambda d: d.update(goal=d["steps"][0]["before"]), "goal: got another stance"),
    (lambda d: d["steps"][0]["moves"].pop(1), "steps[0].moves: got lift, set, expected the arm, then a lift"),
    (lambda d: d["steps"][0]["moves"][1].update(begin=9.0), "steps[0].moves[1].begin"),
    (lambda d: d["steps"][0]["moves"][0].update(holds=[1]), "steps[0].moves[0].holds: got [1]"),
    (lambda d: d["steps"][0]["moves"][0]["arm"].__setitem__(0, 0.0), "steps[0].moves[0].arm"),
    (lambda d: d["steps"][0]["moves"][0].update(arm=[0.0]), "steps[0].moves[0].arm"),
    (lambda d: d["steps"][0]["moves"][0]["joints"].reverse(), "steps[0].moves[0].joints"),
    (lambda d: d["steps"][0]["moves"][0]["knots"]["t"].reverse(), "steps[0].moves[0].knots"),
    (lambda d: d["steps"][0]["moves"][0]["checks"].pop(), "steps[0].moves[0].checks"),
    (lambda d: d["steps"][0]["moves"][0]["checks"][0].update(value=0.5), "moves[0].checks[0].value: got 0.5"),
    (lambda d: d["steps"][0]["moves"][0].update(kind="swing"), "steps[0].moves: got swing, swing, set"),
    (
        lambda d: d["steps"][0]["moves"].insert(1, {**d["steps"][0]["moves"][0], "kind": "arm"}),
        "got lift, arm",
    ),
    (lambda d: d["steps"][0].update(moves=d["steps"][0]["moves"][:1]), "steps[0].moves: got lift, expected"),
    (lambda d: dragged(d["steps"][0]["moves"][0]), "steps[0].moves[0].knots: got a lift of the foot along"),
    (lambda d: d.update(effort_used=0.1), "effort_used: got 0.1"),
    (
        lambda d: d.update(adhesion_needed={"peak": 1.0, "mode": "pull", "time": 0.0, "foot": 1}),
        "adhesion_needed: got {",
    ),
]


@pytest.mark.parametrize(("change", "says"), CHANGES)
def test_what_contradicts_is_refused(
    data: dict[str, Any], tmp_path: Path, change: Callable[[dict[str, Any]], object], says: str
) -> None:
    forged = json.loads(json.dumps(data))
    change(forged)
    with pytest.raises(ArchiveError, match=re.escape(says)):
        load_walk(written(forged, tmp_path))


def test_a_motion_that_breaks_a_promise_is_refused(data: dict[str, Any], tmp_path: Path) -> None:
    forged = json.loads(json.dumps(data))
    knots = forged["steps"][0]["moves"][1]["knots"]
    knots["q"] = (np.array(knots["q"]) + 0.3 * (np.arange(len(knots["t"])) == 1)[:, None]).tolist()
    with pytest.raises((LimitViolation, ArchiveError)):
        load_walk(written(forged, tmp_path))


def test_no_walk(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=r"walk\.json"):
        load_walk(tmp_path)
