"""`cmbot locate`: a sheet of corners, and a workpiece from touched points."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from cmbot.common.errors import SceneError
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.scene import load_scene


def test_a_sheet_of_corners_and_what_it_will_tell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = run("locate", "triangle", "--propose", "4", "--json")
    assert outcome.status == 0, outcome.err
    told = json.loads(outcome.out)
    sheet = read_yaml(tmp_path / "triangle.touches.yaml", SceneError)
    assert told["touches"] == [touch["point"] for touch in sheet["touches"]]
    assert 0 < told["shift_mm"] < 1
    outcome = run("locate", "triangle", "--propose", "4")
    assert outcome.status == 2
    assert "--force" in outcome.err
    outcome = run("locate", "triangle", "--propose", "4", "-o", "touches.csv")
    assert outcome.status == 2
    assert "touches.csv: --output: got no name of a YAML file, expected one that ends in .yaml" in outcome.err


def test_touched_corners_move_the_workpiece(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A tracker saw every corner 12 mm further along y."""
    monkeypatch.chdir(tmp_path)
    assert run("locate", "triangle", "--propose", "5", "-q").status == 0
    sheet = read_yaml(tmp_path / "triangle.touches.yaml", SceneError)
    places = np.add([touch["point"] for touch in sheet["touches"]], [0, 0.012, 0])
    lines = ["x,y,z,px,py,pz"]
    for place, touch in zip(places.tolist(), sheet["touches"], strict=True):
        lines.append(",".join(map(str, [*place, *touch["point"]])))
    Path("points.csv").write_text("\n".join(lines), encoding="utf-8")
    outcome = run("locate", "points.csv", "--scene", "triangle")
    assert outcome.status == 0, outcome.err
    assert outcome.out.startswith("world is 12.00 mm and 0.000 deg from where the scene has it, at ")
    blocks = read_yaml(tmp_path / "points.location.yaml", SceneError)
    np.testing.assert_allclose(blocks["frames"]["workpiece"]["xyz"], [0, 0.012, 0], atol=1e-5)
    # They are a block of a scene; what nothing follows makes nothing more exact.
    scene = read_yaml(Path(load_scene("triangle").source), SceneError)
    assert load_scene(scene | blocks).frame_poses.keys() == {"workpiece"}
    assert "uncertainty" not in blocks
    assert "from and legs' to: {frame: workpiece, ...}" in outcome.out


def test_a_frame_of_the_scene_is_located_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sheet's points are in the frame; a tracker sees them 7 mm away."""
    monkeypatch.chdir(tmp_path)
    assert run("locate", "gusset_plate", "--propose", "4", "-q").status == 0
    sheet = read_yaml(tmp_path / "gusset_plate.touches.yaml", SceneError)
    X = load_scene("gusset_plate").frame_poses[sheet["locates"]]
    for touch in sheet["touches"]:
        del touch["posture_deg"]
        touch["place"] = (X[:3, :3] @ touch["point"] + X[:3, 3] + [0.007, 0, 0]).tolist()
    Path("touched.yaml").write_text(json.dumps(sheet), encoding="utf-8")
    outcome = run("locate", "touched.yaml")
    assert outcome.status == 0, outcome.err
    assert " is 7.00 mm and 0.000 deg from " in outcome.out
    blocks = read_yaml(tmp_path / "touched.location.yaml", SceneError)
    assert 0 < blocks["uncertainty"]["workpiece"]["mm"] < 1
    assert f"uncertainty: {{workpiece: {{mm: {blocks['uncertainty']['workpiece']['mm']}, deg: " in outcome.out
    # Points in W, taken for points in the frame, are far away.
    for touch in sheet["touches"]:
        touch["point"] = touch["place"]
    Path("mistaken.yaml").write_text(json.dumps(sheet), encoding="utf-8")
    outcome = run("locate", "mistaken.yaml")
    assert outcome.status == 2
    assert "look at the units and the frame" in outcome.err


def test_a_sheet_that_is_not_filled_in_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert run("locate", "triangle", "--propose", "3", "-q").status == 0
    outcome = run("locate", "triangle.touches.yaml")
    assert outcome.status == 2
    assert "touches[0]: got none, expected exactly one of posture_deg, posture, place" in outcome.err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nofile.yaml",), "no such file"),
        (("points.csv",), "--scene SCENE"),
        (("points.csv", "--propose", "3"), "a scene, whose corners can be touched"),
    ],
)
def test_what_is_missing_is_said(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("points.csv").write_text("x,y,z,px,py,pz\n0,0,0,0,0,0\n", encoding="utf-8")
    outcome = run("locate", *words)
    assert outcome.status == 2
    assert said in outcome.err
    assert outcome.err.count("\n") == 1
