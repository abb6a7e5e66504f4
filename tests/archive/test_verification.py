"""`cmbot verify`: folders of plans, walks and tours, forged and not, with and without the second engine."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import output, refusal
from forgeries import FORGERIES, Forgery, forge
from plan_folders import edit
from small_scenes import panda_scene
from walks import one_step

from cmbot import load_plan, plan
from cmbot.archive import WALK_FILE, save, write_results
from cmbot.collision import Clearances
from cmbot.planning.verification import engine, second_opinion
from cmbot.robot import Dynamics, Kinematics
from cmbot.stances.walking import walk_data


@pytest.fixture
def walked(tmp_path: Path) -> Path:
    write_results(tmp_path, WALK_FILE, walk_data(one_step()), {})
    return tmp_path


@pytest.mark.usefixtures("judged_once")
@pytest.mark.parametrize("kind", ["short_folder", "walked"])
def test_what_was_written_holds(kind: str, request: pytest.FixtureRequest) -> None:
    folder = request.getfixturevalue(kind)
    data = json.loads(output("verify", folder, "--json"))
    assert (data["verb"], data["engine"]) == ("verify", "mujoco")
    assert {each["part"] for each in data["motions"]} == {""}
    for motion in data["motions"]:
        names = [check["quantity"] for check in motion["checks"]]
        for what in ("guardrail torque", "joint torque", "tool point", "clearance"):
            assert f"difference of the {what} from a second computation" in names
    told = output("verify", folder, "--engine", "mujoco")
    assert "The second engine, mujoco, was asked." in told
    assert output("verify", folder, "--quiet") == ""


def test_a_stroke_follows_on_a_pause_without_a_jump(tmp_path: Path) -> None:
    """Whose end, put onto the path anew, is a few digits off: a file has one knot there."""
    down: dict[str, Any] = {"keep": "axis", "via_points": 12}
    begin = {"xyz": [0.5, -0.1, 0.4], "rpy_deg": [180, 0, 0]}
    first = {
        **down,
        "name": "first",
        "from": begin,
        "legs": [{"by": [0, 0.1, 0], "seconds": 2}, {"pause": 1}],
    }
    then = {**down, "name": "then", "legs": [{"by": [0.08, 0, 0], "seconds": 2}]}
    asked = {"planner": {"baseline": "none"}, "tool": {"process_force_n": [0, 0, -20]}}
    made = plan(panda_scene({"strokes": [first, then]}, **asked), progress=False)
    one, other = (segment.trajectory for segment in made.job.strokes)
    np.testing.assert_array_equal(other.q[0], one.q[-1])
    load_plan(save(made, tmp_path / "plan"), verify=True, scene=made.scene)


@pytest.mark.parametrize("forgery", FORGERIES, ids=str)
def test_forgeries_end_in_one_line(forgery: Forgery, short_folder: Path) -> None:
    forge(short_folder, forgery)
    assert refusal("verify", short_folder).startswith(f"error: {short_folder}")


@pytest.mark.parametrize("kind", ["short_folder", "walked"])
@pytest.mark.parametrize(
    ("part", "name", "mistake", "quantity"),
    [
        (Dynamics, "efforts", lambda x: replace(x, joint_torque=0.9 * x.joint_torque), "joint torque"),
        (
            Dynamics,
            "efforts",
            lambda x: replace(x, guardrail_force=0.9 * x.guardrail_force),
            "guardrail force",
        ),
        (Kinematics, "tool_poses", lambda x: (x[0] + [0, 0, 1e-6], x[1]), "tool point"),
        (Clearances, "query", lambda x: x._replace(distance=x.distance + 1e-3), "clearance"),
    ],
)
def test_mistakes_of_the_package_are_found(
    kind: str,
    part: type,
    name: str,
    mistake: Any,
    quantity: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    folder = request.getfixturevalue(kind)

    class Wrong(part):  # type: ignore[misc]
        """As the second opinion meets it; the certificate does not."""

    right = getattr(part, name)
    setattr(Wrong, name, lambda self, *given: mistake(right(self, *given)))
    monkeypatch.setattr(second_opinion, part.__name__, Wrong)
    assert f"difference of the {quantity} from a second computation: got " in refusal("verify", folder)


def test_without_the_second_engine(short_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = importlib.util.find_spec
    monkeypatch.setattr(engine, "find_spec", lambda name: None if name == "mujoco" else known(name))
    told = output("verify", short_folder)
    assert "The second engine was not asked: mujoco is not installed; run: pip install" in told
    data = json.loads(output("verify", short_folder, "--json"))
    names = {check["quantity"] for motion in data["motions"] for check in motion["checks"]}
    assert data["engine"] is None
    assert "difference of the clearance from a second computation" in names
    assert "difference of the timed tool path from a second computation" in names
    assert "difference of the joint torque from a second computation" not in names
    error = refusal("verify", short_folder, "--engine", "mujoco", status=1)
    assert error.startswith("error: mujoco is not installed; run: pip install")
    assert error.endswith("[verify]'") or error.endswith("[verify]")


def test_an_engine_that_is_none(short_folder: Path) -> None:
    error = "error: --engine: got bullet, expected a known value (one of: mujoco)"
    assert refusal("verify", short_folder, "--engine", "bullet").startswith(error)


def test_a_walk_that_breaks_a_promise(walked: Path) -> None:
    edit(walked, lambda data: data.update(max_foot_speed=data["max_foot_speed"] / 2), "walk.json")
    assert "tool speed: got " in refusal("verify", walked)


def test_no_folder(tmp_path: Path) -> None:
    assert "expected a plan directory" in refusal("verify", tmp_path)
