"""``cmbot excite``: what it adds, prints and refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import output, refusal
from plan_folders import names

import cmbot
from cmbot.archive import excitation_json, save_excitation
from cmbot.common.errors import ArchiveError, InputError
from cmbot.planning import Plan

ADDED = {"excitation.json", "excitation.html", "report.html"}


@pytest.fixture(scope="module")
def excited(saved_short: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    folder = Path(shutil.copytree(saved_short, tmp_path_factory.mktemp("excited") / "plan"))
    return folder, output("excite", folder, "--json")


def test_it_adds_figures_and_a_page(excited: tuple[Path, str], saved_short: Path) -> None:
    folder, text = excited
    assert names(folder) - names(saved_short) == ADDED
    told, written = json.loads(text), json.loads((folder / "excitation.json").read_text())
    assert told["verb"] == "excite"
    assert told["rms_mm"] == written["rms_mm"] > 1
    assert written["damping"] == 0.01
    assert written["kind"] == "reference"
    # The plan counts them in, and is read with them.
    record = json.loads((folder / "plan.json").read_text())
    assert record["files"].keys() >= ADDED
    cmbot.load_plan(folder)
    read = cmbot.load_excitation(folder)
    assert read is not None
    assert json.loads(json.dumps(excitation_json(read))) == written
    assert cmbot.load_excitation(saved_short) is None
    for _ in range(2):
        assert "What shakes it" in (folder / "report.html").read_text()
        output("report", folder)
    page = (folder / "excitation.html").read_text()
    assert "<svg" in page
    assert "http" not in page.split("</head>")[1].replace("http://www.w3.org", "")


def test_it_prints_a_table(excited: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> None:
    folder, _ = excited
    known = cmbot.load_excitation(folder)
    monkeypatch.setattr(cmbot, "excite", lambda *_, **__: known)
    text = output("excite", folder, "--force")
    assert "slowest mode, Hz" in text
    assert "The scene has no excitation" in text
    assert output("excite", folder, "--force", "--quiet") == ""


def test_a_simulation_says_that_nothing_shakes_it(short_plan: Plan, tmp_path: Path) -> None:
    """The motion alone is simulated, without the scene's damper."""
    scene = cmbot.load_scene(short_plan.scene.as_data() | {"damper": {"mass_kg": 1.0}})
    cmbot.save(replace(short_plan, scene=scene), tmp_path)
    assert any(
        "damper are left out" in said
        for said in json.loads(output("simulate", tmp_path, "--json"))["remarks"]
    )


def test_what_is_there_is_kept(excited: tuple[Path, str], tmp_path: Path, short_plan: Plan) -> None:
    folder, _ = excited
    excitation = cmbot.load_excitation(folder)
    assert excitation is not None
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert "--force" in refusal("excite", folder)
    with pytest.raises(ArchiveError, match=r"got excitation\.json"):
        save_excitation(excitation, folder)
    with pytest.raises(ArchiveError):
        save_excitation(excitation, tmp_path / "none")
    with pytest.raises(ArchiveError, match="page or a plot"):
        save_excitation(excitation, folder, force=True, added={"other.html": ""})
    with pytest.raises(InputError, match="an Excitation"):
        save_excitation(short_plan, folder)  # type: ignore[arg-type]
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert excitation_json(excitation)["format"] == "cmbot-excitation/1"
