"""Plans whose robot and meshes are files elsewhere: found again, and any change of them noticed."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from plan_folders import refused, same_arrays

from cmbot.archive import load_plan, save
from cmbot.archive.verification.asked import require_asked
from cmbot.collision import Mesh
from cmbot.common.errors import ArchiveError, SceneError
from cmbot.common.installation import model_folder
from cmbot.planning import Plan, robot_of
from cmbot.scene import load_scene

# A closed tetrahedron far from the arm.
TETRAHEDRON = "\n".join(
    ["v 9 9 9", "v 10 9 9", "v 9 10 9", "v 9 9 10", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"]
)


@pytest.fixture(scope="module")
def foreign_files(tmp_path_factory: pytest.TempPathFactory, bare_urdf: str) -> Path:
    files = tmp_path_factory.mktemp("foreign")
    (files / "cmbot.urdf").write_text(bare_urdf, encoding="utf-8")
    for name in ("cmbot.srdf", "joint_limits.yaml"):
        shutil.copy(model_folder() / "urdf" / name, files)
    shutil.copy(model_folder() / "urdf" / "cmbot.elasticity.yaml", files / "tubes.yaml")
    (files / "rock.obj").write_text(TETRAHEDRON)
    return files


@pytest.fixture(scope="module")
def foreign_plan(thin_plan: Plan, foreign_files: Path) -> Plan:
    """The same motion in a scene whose robot and mesh are files with relative paths."""
    robot = thin_plan.robot
    X_WB = robot.model.frames[robot.model.getFrameId(robot.base_frame)].placement
    data = load_scene("triangle").as_data()
    data["robot"] = {
        "model": "cmbot.urdf",
        "base_frame": robot.base_frame,
        "tool_frame": robot.tool_frame,
        "limits": "joint_limits.yaml",
        "elasticity": "tubes.yaml",
        "mount": {
            "xyz": X_WB.translation.tolist(),
            "rpy_deg": np.degrees(pin.rpy.matrixToRpy(X_WB.rotation)).tolist(),
        },
    }
    # With the laws of the motion.
    data["tool_path"] = thin_plan.scene.as_data()["tool_path"]
    data["obstacles"].append({"name": "rock", "mesh": "rock.obj", "xyz": [0, 0, 0]})
    (foreign_files / "scene.yaml").write_text(json.dumps(data))
    scene = load_scene(foreign_files / "scene.yaml")
    # It bends otherwise than the shipped robot: what was compensated is not its sag.
    options = replace(thin_plan.options, compensate=False)
    return replace(thin_plan, scene=scene, robot=robot_of(scene), options=options, sag=None)


@pytest.fixture(scope="module")
def foreign_saved(foreign_plan: Plan, foreign_files: Path) -> Path:
    return save(foreign_plan, foreign_files / "plan")


@contextmanager
def other_content(path: Path, content: str | None) -> Iterator[None]:
    """Change a file, or take it away, for a while."""
    before = path.read_bytes()
    path.unlink()
    if content is not None:
        path.write_text(content)
    yield
    path.write_bytes(before)


def test_paths_become_absolute(foreign_plan, foreign_saved, foreign_files, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    plan = load_plan(shutil.copytree(foreign_saved, tmp_path / "elsewhere"))
    assert plan.robot.urdf == foreign_plan.robot.urdf
    assert plan.scene.robot == foreign_plan.scene.robot
    assert plan.scene.content_hash == foreign_plan.scene.content_hash
    meshes = [o.shape for o in plan.scene.all_obstacles if isinstance(o.shape, Mesh)]
    assert meshes == [Mesh(path=(foreign_files / "rock.obj").resolve())]
    same_arrays(plan.samples, foreign_plan.samples)
    # Saved once more it keeps the identity of the scene it came from.
    save(plan, tmp_path / "again")
    hashes = [
        json.loads((path / "plan.json").read_text())["hashes"] for path in (foreign_saved, tmp_path / "again")
    ]
    assert hashes[0] == hashes[1]


def test_changed_robot_files_are_noticed(foreign_plan, foreign_saved, foreign_files):
    limits = foreign_files / "joint_limits.yaml"
    with other_content(limits, limits.read_text() + "\n# a remark\n"):
        error = refused(foreign_saved, "plan.json", "hashes.robot")
        assert robot_of(foreign_plan.scene).content_hash[:16] in error.got
    assert "the robot's files have changed since" in error.expected
    assert foreign_plan.robot.content_hash[:16] in error.expected


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("joint_limits.yaml", "scene.robot.limits"),
        ("tubes.yaml", "scene.robot.elasticity"),
        ("rock.obj", "scene.obstacles[4].mesh"),
        ("cmbot.urdf", "scene.robot.model"),
        # Which neither scene names: an SRDF beside the URDF, and a mesh in it.
        ("cmbot.srdf", "scene.robot.model"),
        ("shell.obj", "scene.robot.model"),
    ],
)
@pytest.mark.usefixtures("foreign_plan")
def test_the_same_files_elsewhere(foreign_files: Path, tmp_path: Path, name: str, key: str) -> None:
    """What is asked counts, not where it lies: files of the same content may be anywhere, others nowhere."""
    shell = '<collision><geometry><mesh filename="shell.obj"/></geometry></collision></link>'
    for folder in ("here", "there"):
        shutil.copytree(foreign_files, tmp_path / folder, ignore=shutil.ignore_patterns("plan"))
        (tmp_path / folder / "shell.obj").write_text(TETRAHEDRON)
        urdf = tmp_path / folder / "cmbot.urdf"
        urdf.write_text(urdf.read_text(encoding="utf-8").replace("</link>", shell, 1), encoding="utf-8")
    scene, asked = (load_scene(tmp_path / folder / "scene.yaml") for folder in ("here", "there"))
    require_asked(scene, asked, "plan.json")
    with (tmp_path / "there" / name).open("a", encoding="utf-8") as file:
        file.write("\n")
    with pytest.raises(ArchiveError) as caught:
        require_asked(scene, load_scene(tmp_path / "there" / "scene.yaml"), "plan.json")
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("name", "content", "key"),
    [
        ("rock.obj", TETRAHEDRON.replace("v 10 9 9", "v 11 9 9"), "hashes.scene"),
        ("rock.obj", None, "scene.obstacles[4].mesh"),
        ("cmbot.urdf", None, "scene.robot.model"),
        ("joint_limits.yaml", None, "scene.robot.limits"),
        ("tubes.yaml", None, "scene.robot.elasticity"),
    ],
)
def test_changed_meshes_and_missing_scene_files_are_named(foreign_saved, foreign_files, name, content, key):
    with other_content(foreign_files / name, content):
        refused(foreign_saved, "plan.json", key)


def test_a_broken_robot_file_is_named_and_a_scene_without_its_files_not_written(
    foreign_plan, foreign_saved, foreign_files, tmp_path
):
    with other_content(foreign_files / "cmbot.urdf", "<robot"), pytest.raises(ArchiveError) as caught:
        load_plan(foreign_saved)
    assert caught.value.source == str(foreign_files / "cmbot.urdf")
    with other_content(foreign_files / "rock.obj", None), pytest.raises(SceneError):
        save(foreign_plan, tmp_path / "plan")
    assert not list(tmp_path.iterdir())
