"""Plan directories that the tests share, changing them, and what is refused of them."""

import hashlib
import io
import json
import math
import pickle
import shutil
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kept import Kept
from shared_plans import planned
from small_scenes import short_scene

from cmbot.archive import load_plan, reading, save, walks
from cmbot.archive.verification import folders
from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError
from cmbot.planning import Job, Plan, QuinticTrajectory, Samples
from cmbot.scene import Scene
from cmbot.simulation import SimulationOptions, Tracking, simulate
from cmbot.stances.walking import Move

FILES = {"plan.json", "job.csv", "job.npz", "baseline.csv"}
"""All files of a plan."""


@pytest.fixture(scope="session")
def saved_triangle(triangle_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan directory that no test changes."""
    return save(triangle_plan, tmp_path_factory.mktemp("archive") / "triangle")


@pytest.fixture
def triangle_folder(saved_triangle: Path, tmp_path: Path) -> Path:
    """A plan directory to be changed."""
    return Path(shutil.copytree(saved_triangle, tmp_path / "plan"))


@pytest.fixture(scope="session")
def thin_plan(triangle_plan: Plan) -> Plan:
    """The triangle with few samples of the baseline, quick to save."""
    samples = triangle_plan.baseline.samples
    whole = {field.name: getattr(samples, field.name) for field in fields(samples)}
    few = {name: None if value is None else value[::100] for name, value in whole.items()}
    return with_baseline(triangle_plan, samples=Samples(**few))


@pytest.fixture(scope="session")
def short_plan() -> Plan:
    """A small plan whose knots are fixed: no floor, no choice, no approach."""
    return planned(short_scene())


@pytest.fixture(scope="session")
def saved_short(short_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan directory of the small plan that no test changes."""
    return save(short_plan, tmp_path_factory.mktemp("short") / "plan")


@pytest.fixture
def short_folder(saved_short: Path, tmp_path: Path) -> Path:
    """A plan directory of the small plan, to be changed."""
    return Path(shutil.copytree(saved_short, tmp_path / "plan"))


@pytest.fixture(scope="session")
def short_tracking(short_plan: Plan) -> Tracking:
    """As ``cmbot simulate`` has it, at the ends of the plan's interval of stiffness, too."""
    return simulate(short_plan, SimulationOptions(stiffness_share=0.3))


_JUDGED = Kept[Any](1000)


@pytest.fixture
def judged_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Certificates and second opinions of one motion in one scene of the shipped robot are made once.

    For tests of what else a folder says, none of which changes how motions are judged.
    """

    def of_job(plan: Plan, number: int, clearances: Clearances) -> list[Any]:
        del clearances  # those of the scene
        job = [(one.kind, one.name, one.task, knots_of(one.trajectory)) for one in plan.job.segments]
        return [plan.scene, plan.options, number, job]

    def of_move(scene: Scene, node: Any, kind: str, holds: Any, arm: FloatArray, *motion: Any) -> list[Any]:
        trajectory, speed = motion
        place = (node.stance, node.root, node.climber)
        return [scene, place, kind, holds, arm, knots_of(trajectory), speed]

    def of_made(move: Move, scene: Scene) -> list[Any]:
        return of_move(scene, move.node, move.kind, move.holds, move.arm, move.segment.trajectory, None)

    def once(judge: Callable[..., Any], told: Callable[..., list[Any]]) -> Callable[..., Any]:
        def judged(*given: Any) -> Any:
            scene, *others = told(*given)
            if scene.robot.model != "cmbot":  # but files that a test may change
                return judge(*given)
            asked = pickle.dumps([judge.__name__, scene.as_data(), others])
            return _JUDGED(asked, lambda: judge(*given))

        return judged

    for module, name, told in (
        (reading, "_certified", of_job),
        (walks, "certified_move", of_move),
        (folders, "second_opinion_of", of_made),
    ):
        monkeypatch.setattr(module, name, once(getattr(module, name), told))


_PROMISED = {
    "safety_margin_m": ("clearance", 1.0),
    "max_tool_deviation_m": ("tool deviation", 1.0),
    "max_tool_rotation_deg": ("tool rotation", math.radians(1)),
    "max_tool_lag_m": ("tool lag", 1.0),
}


def promise(folder: Path, option: str, value: float) -> None:
    """Change what a plan directory promises, in its options and in its certificates."""
    limit, unit = _PROMISED[option]

    def change(data: dict[str, Any]) -> None:
        data["options"][option] = value
        for of in (data, *data["segments"]):
            for check in of["certificate"]["checks"]:
                if check["limit"] == limit:
                    check["bound"] = value * unit

    edit(folder, change)


def changed(planned: Plan, segment: str, **changes: Any) -> Plan:
    """The plan with other fields of a segment of its job."""
    return replace(planned, job=planned.job.changed(segment, **changes))


def with_baseline(planned: Plan, **changes: Any) -> Plan:
    """The plan beside a baseline with other fields."""
    return replace(planned, baseline=replace(planned.baseline, **changes))


def without_approach(planned: Plan) -> Plan:
    """The plan as if the arm stood where the work starts."""
    return replace(planned, job=Job(segments=(replace(planned.job.strokes[0], begin=0.0),)))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def seal(data: dict[str, Any]) -> bytes:
    """A record with the hash of its own content, made right."""
    data = {key: value for key, value in data.items() if key != "content"}
    data["content"] = hashlib.sha256(json.dumps(data).encode("ascii")).hexdigest()
    return json.dumps(data).encode("ascii")


def edit(folder: Path, change: Callable[[dict[str, Any]], object], name: str = "plan.json") -> None:
    """Change the content of a record as a program would that also keeps its hash right."""
    path = folder / name
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_bytes(seal(data))


def rewrite(folder: Path, name: str, content: bytes, listed_in: str = "plan.json") -> None:
    """Replace a file as a program would that also keeps the hashes right."""
    (folder / name).write_bytes(content)
    hashes = {name: hashlib.sha256(content).hexdigest()}
    edit(folder, lambda data: data["files"].update(hashes), listed_in)


def npz(**arrays: Any) -> bytes:

    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def knots_of(trajectory: QuinticTrajectory) -> list[FloatArray]:
    return [getattr(trajectory, name) for name in "tqva"]


def knots(trajectory: QuinticTrajectory) -> bytes:
    return npz(**dict(zip("tqva", knots_of(trajectory), strict=True)))


def refused(folder: Path, file: str, key: str, load: Callable[[Path], object] = load_plan) -> ArchiveError:
    """Return the error for which a plan directory is not read; it names that file and key."""
    with pytest.raises(ArchiveError) as caught:
        load(folder)
    assert (caught.value.source, caught.value.key) == (str(folder / file), key)
    return caught.value


def same_arrays(left: Any, right: Any) -> None:
    """Require two dataclasses to hold the same arrays, those of their parts as well."""
    assert type(left) is type(right)
    if is_dataclass(left):
        for field in fields(left):
            same_arrays(getattr(left, field.name), getattr(right, field.name))
    elif isinstance(left, tuple):
        for one, other in zip(left, right, strict=True):
            same_arrays(one, other)
    else:
        np.testing.assert_array_equal(left, right)
