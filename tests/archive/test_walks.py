"""Walks read back: as they were, and refused where the file contradicts itself or what is computed again."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plan_folders import seal
from scipy.spatial.transform import Rotation
from walks import COUNTERWEIGHT_DEG, one_step

from cmbot.archive import Asked, json_bytes, load_walk, verified_motions
from cmbot.common.errors import ArchiveError, LimitViolation
from cmbot.robot import Climber
from cmbot.stances import Candidate, in_world
from cmbot.stances.walking import certified_move, walk_data
from cmbot.toolpath import SpeedProfile
from cmbot.trajectory import SplineSpace

pytestmark = pytest.mark.usefixtures("judged_once")


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


def test_a_goal_that_is_there_twice(data: dict[str, Any], tmp_path: Path) -> None:
    """The last one is that of the walk; another reader would take the first."""
    path = written(data, tmp_path) / "walk.json"
    path.write_text(path.read_text(encoding="utf-8").replace("{", '{"goal": {}, ', 1), encoding="utf-8")
    with pytest.raises(ArchiveError, match="twice") as caught:
        load_walk(tmp_path)
    assert (caught.value.source, caught.value.key) == (str(path), "goal")


def moved(lift: dict[str, Any], out: float, aside: float, turn_deg: float = 0.0) -> None:
    """Turn a lift of foot 1 into another way of it: off by `out` and aside, m, and turned."""
    climber, way = Climber(), [np.array(lift["knots"]["q"][0])]
    X_12, u = climber.poses(way[0][::-1])[0], np.linspace(0.0, 1.0, 20)
    for share in SpeedProfile(kind="jerk_limited", ramp=0.5).law.share(u)[1:]:
        # Foot 1 goes in its own frame; the posture is that of foot 2 in the frame of foot 1.
        X_away = np.eye(4)
        X_away[:3, :3] = Rotation.from_euler("y", share * turn_deg, degrees=True).as_matrix()
        X_away[:3, 3] = share * aside, share * out, 0.0
        found = climber.reaching(np.linalg.inv(X_away) @ X_12)
        way.append(min((q[::-1] for q in found), key=lambda q: float(np.abs(q - way[-1]).max())))
    space = SplineSpace(6.0 * u)
    trajectory = space.trajectory(space.least_jerk(np.array(way)))
    lift["knots"] = {name: getattr(trajectory, name).tolist() for name in "tqva"}
    lift["seconds"] = trajectory.duration


def both_feet(stance: dict[str, Any], by: float) -> None:
    """Put both feet elsewhere on the rail, the climber as it is."""
    for foot in ("foot_1", "foot_2"):
        stance[foot]["along_m"] += by


def last(data: dict[str, Any], **changes: Any) -> None:
    """Let the walk end with another set of the foot, or with what this is made to be."""
    data["last"] = {**data["steps"][0]["moves"][-1], **changes}


def lamp(scene: dict[str, Any], place: Candidate) -> None:
    """Put a lamp beside foot 1."""
    X = place.root
    xyz = (X[:3, 3] + 0.08 * X[:3, 0] + 0.07 * X[:3, 1]).tolist()
    scene["obstacles"] = [{"name": "lamp", "sphere": 0.03, "xyz": xyz}]


CHANGES: list[tuple[Callable[[dict[str, Any]], object], str]] = [
    (lambda d: d.update(format="cmbot-walk/2"), "format: got"),
    (lambda d: d.update(colour="red"), "colour"),
    (lambda d: d.pop("goal"), "goal"),
    (lambda d: d["steps"][0]["before"]["foot_1"].update(along_m=4.0), "steps[0].before.climber_deg"),
    (lambda d: d["goal"].pop("climber_deg"), "goal.climber_deg: got nothing, expected five angles"),
    (lambda d: d["goal"]["foot_1"].update(member="rope"), "goal.foot_1.member: got 'rope', expected a rail"),
    (
        lambda d: d["steps"][0]["after"]["foot_2"].update(along_m=7.1),
        "steps[0].after.foot_2.along_m: got 7.1, expected at most the member's length, 7",
    ),
    (lambda d: both_feet(d["steps"][0]["after"], 0.05), "steps[0].after: got another place, expected foot 2"),
    (lambda d: last(d), "last.kind: got set, expected arm"),
    (lambda d: last(d, kind="arm"), "last.holds: got [2], expected [1, 2]"),
    (lambda d: last(d, kind="arm", holds=[1, 2]), "last.knots.q: got 5 columns, expected 7"),
    (lambda d: d["steps"][0].update(before=d["steps"][0]["after"]), "steps[0].before: got another stance"),
    (lambda d: d["steps"][0].update(after=d["steps"][0]["before"]), "steps[0].after: got another stance"),
    (lambda d: d.update(goal=d["steps"][0]["before"]), "goal: got another stance"),
    (
        lambda d: d["steps"][0]["moves"].pop(1),
        "steps[0].moves: got lift, set, expected moves of the arm, if any, then lift, swing, set",
    ),
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
    (lambda d: moved(d["steps"][0]["moves"][0], 0.0, 0.004), "moves[0].knots: got another lift"),
    (lambda d: moved(d["steps"][0]["moves"][0], 0.05, 0.004), "moves[0].knots: got another lift"),
    (lambda d: moved(d["steps"][0]["moves"][0], 0.05, 5e-4), "moves[0].knots: got another lift"),
    (
        lambda d: moved(d["steps"][0]["moves"][0], 0.05, 0.0),
        "moves[0].knots: got a lift by 50.0 mm, expected 60",
    ),
    (lambda d: moved(d["steps"][0]["moves"][0], 0.08, 0.0), "moves[0].knots: got a lift by 80.0 mm"),
    (lambda d: moved(d["steps"][0]["moves"][0], 0.05, 0.0, 4.0), "moves[0].knots: got another lift"),
    (lambda d: d["steps"][0]["moves"].pop(0), "steps[0].moves: got swing, set, expected"),
    (lambda d: d["steps"][0]["moves"].pop(), "steps[0].moves: got lift, swing, expected"),
    (lambda d: d["steps"][0]["moves"].reverse(), "steps[0].moves: got set, swing, lift, expected"),
    (lambda d: d["steps"][0].update(moves=[]), "steps[0].moves"),
    (lambda d: d.update(steps=[]), "steps"),
    (lambda d: d.update(failures=["no step"]), "words"),
    (lambda d: lamp(d["scene"], one_step().steps[0].before), "before.foot_1: got a place beside lamp"),
    (lambda d: lamp(d["scene"], one_step().steps[0].after), ".foot_1: got a place beside lamp"),
    (lambda d: d.update(effort_used=0.1), "effort_used: got 0.1"),
    (
        lambda d: d.update(
            adhesion_needed={"peak": 1.0, "mode": "pull", "tip": 1.0, "gap": 1.0, "time": 0.0, "foot": 1}
        ),
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


def test_an_arm_that_moves_at_last(tmp_path: Path) -> None:
    """It goes on from where it was, and the walk ends where it ends."""
    walk, space = one_step(), SplineSpace(np.linspace(0.0, 4.0, 5))
    arm = np.radians(COUNTERWEIGHT_DEG)
    motion = space.trajectory(space.least_jerk(arm + np.outer(np.linspace(0.0, 0.1, 5), np.eye(7)[6])))
    last = certified_move(in_world(walk.scene), walk.goal, "arm", (1, 2), arm, motion, walk.speed)
    moved = json.loads(json_bytes(walk_data(replace(walk, last=last))))
    read = load_walk(written(moved, tmp_path)).last
    assert read is not None and read.kind == "arm"
    np.testing.assert_array_equal(read.segment.trajectory.q, motion.q)
    # A stance asks for no posture of the arm; who asks for none is told where it ends.
    told = verified_motions(tmp_path).not_verified
    assert "where the arm ends (0.1 rad from where it begins)" in told
    with pytest.raises(ArchiveError, match="last: got a move of the arm, expected none after the last step"):
        verified_motions(tmp_path, Asked(goal=walk.goal.stance))
    moved["last"]["knots"]["q"] = (np.array(motion.q) + 1e-6).tolist()
    with pytest.raises(ArchiveError, match=r"last\.knots\.q: got another posture, expected that in which"):
        load_walk(written(moved, tmp_path))


def test_steps_that_were_tried_in_vain(tmp_path: Path) -> None:
    walked = replace(one_step(), failures=("it comes too near",))
    assert load_walk(written(json.loads(json_bytes(walk_data(walked))), tmp_path)).failures == walked.failures


def test_no_walk(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=r"walk\.json"):
        load_walk(tmp_path)
