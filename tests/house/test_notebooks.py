"""The notebooks run from top to bottom, and their cells show what they say."""

import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import cmbot
from cmbot.simulation import Tracking

NOTEBOOKS = sorted((Path(__file__).resolve().parent.parent.parent / "examples" / "notebooks").glob("*.ipynb"))
# The triangle is planned and simulated in other tests: the notebooks are given what there is. The other
# scene is planned in the quickest way.
GIVEN = """import dataclasses, cmbot
_plan = cmbot.plan
_quick = lambda options: dataclasses.replace(options, knots="fixed", path_step_s=0.02)
_other = lambda scene: _plan(scene, options=_quick(scene.planner))
cmbot.plan = lambda scene: cmbot.load_plan({folder!r}) if scene.name == "triangle" else _other(scene)
cmbot.simulate = lambda plan: cmbot.load_tracking(plan, {folder!r})"""


@pytest.fixture(scope="module")
def ran(
    triangle_tracking: Tracking,
    saved_triangle: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, list[dict[str, str]]]:
    """What each notebook shows, cell by cell; all in one kernel, whose start takes longest."""
    folder = Path(shutil.copytree(saved_triangle, tmp_path_factory.mktemp("notebooks") / "plan"))
    cmbot.save_tracking(triangle_tracking, folder)
    whole, ends = nbformat.v4.new_notebook(), [1]
    whole.cells.append(nbformat.v4.new_code_cell(GIVEN.format(folder=str(folder))))
    for path in NOTEBOOKS:
        cells = nbformat.read(path, as_version=4).cells
        whole.cells += [cell for cell in cells if cell.cell_type == "code"]
        ends.append(len(whole.cells))
    NotebookClient(
        whole, timeout=300, startup_timeout=300, resources={"metadata": {"path": str(folder.parent)}}
    ).execute()
    shown = [
        {kind: text for output in cell.outputs for kind, text in output.get("data", {}).items()}
        | {"stdout": "".join(output.get("text", "") for output in cell.outputs)}
        for cell in whole.cells
    ]
    return {
        path.stem: shown[begin:end] for path, begin, end in zip(NOTEBOOKS, ends[:-1], ends[1:], strict=True)
    }


def test_they_show_cards_pages_and_words(ran: dict[str, list[dict[str, str]]]) -> None:
    first, second, third = ran.values()
    assert list(ran) == ["01_first_plan", "02_your_own_arm", "03_what_bends"]
    scene, robot, plan, said, page, checks = first
    assert "<strong>Scene triangle</strong>" in scene["text/html"]
    assert "joint_7" in robot["text/html"]
    assert "peak torque at work, Nm" in plan["text/html"]
    assert said["stdout"].startswith("The tool is within ")
    assert "The guardrail must bear 486.4 Nm" in said["stdout"]
    assert page["text/html"].startswith('<iframe srcdoc="&lt;!DOCTYPE html&gt;')
    assert "tool lag" in checks["stdout"]
    assert "on the mast" in second[2]["text/plain"]
    assert "retrun: got " in second[3]["stdout"]
    assert "<strong>Tracking</strong>" in third[0]["text/html"]
    assert "allow-scripts" in third[2]["text/html"]
    assert "image/png" in third[3]


def test_they_are_kept_without_outputs() -> None:
    for path in NOTEBOOKS:
        for cell in nbformat.read(path, as_version=4).cells:
            assert not cell.get("outputs"), path
            assert cell.get("execution_count") is None, path
