"""``cmbot identify``: what it writes, prints and refuses."""

import json
import re
from pathlib import Path

import pytest
from command_line import run
from small_scenes import short_scene

import cmbot
from cmbot.identification import design


@pytest.fixture(scope="module")
def sheet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sheet that ``cmbot identify --propose`` wrote."""
    folder = tmp_path_factory.mktemp("identify")
    (folder / "short.yaml").write_text(json.dumps(short_scene().file.as_data()), encoding="utf-8")
    with pytest.MonkeyPatch.context() as few:
        few.setattr(design, "_CANDIDATES", 40)
        few.setattr(design, "_REFINED", ())
        words = ("--propose", 3, "-o", folder / "sheet.yaml", "--gauge", 0.05)
        outcome = run("identify", folder / "short.yaml", *words)
    assert outcome.status == 0, outcome.err
    assert "After 3 postures with 5 kg, xyz to 0.05 mm: it is known within" in outcome.out
    return folder / "sheet.yaml"


def filled(sheet: Path) -> Path:
    """What would be measured of an arm a fifth softer."""

    def softer(row: re.Match[str]) -> str:
        return f"deflection_mm: {[1.2 * float(x) for x in row[1].split(',')]}"

    text, count = re.subn(r"deflection_mm: .*# about (.*)", softer, sheet.read_text(encoding="utf-8"))
    assert count == 3
    path = sheet.with_name("measured.yaml")
    path.write_text(text, encoding="utf-8")
    return path


def test_from_a_sheet_to_a_scene_that_knows_its_stiffness(sheet: Path) -> None:
    measured = filled(sheet)
    outcome = run("identify", measured)
    assert outcome.status == 0, outcome.err
    assert "Sag along the job" in outcome.out
    assert "joint_2" in outcome.out
    target = measured.with_name("measured.stiffness.yaml")
    assert f"Written to {target}" in outcome.out
    data = short_scene().file.as_data() | {"format": "cmbot-scene/2", "identified": target.name}
    scene = measured.with_name("known.yaml")
    scene.write_text(json.dumps(data), encoding="utf-8")
    assert cmbot.load_scene(scene).file.identified is not None
    again = run("identify", measured)
    assert again.status == 2
    assert "expected a new file, or --force" in again.err
    printed = run("identify", measured, "--force", "--json")
    entries = json.loads(printed.out)
    assert entries["verb"] == "identify"
    assert entries["sag_error_95"] < 0.2
    assert set(entries["factors"]) >= {"link_1", "joint_1"}


def test_what_it_cannot_use_is_refused(sheet: Path) -> None:
    missing = run("identify", sheet.with_name("none.yaml"))
    assert missing.status == 2
    assert "none.yaml" in missing.err
    empty = run("identify", sheet)
    assert empty.status == 2
    assert "measurements: got none, expected a measured number" in empty.err
    light = run("identify", "triangle", "--propose", 2, "--weight", 0, "-o", sheet.with_name("x.yaml"))
    assert light.status == 2
    assert "--weight: got 0.0, expected more than 0" in light.err
