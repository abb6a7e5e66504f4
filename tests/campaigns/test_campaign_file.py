"""What a campaign file, its table or a folder of scenes asks for, and how each mistake is named."""

from copy import deepcopy
from pathlib import Path

import pytest
from ruamel.yaml import YAML
from small_scenes import SHORT

from cmbot.campaigns import Entry, read_campaign
from cmbot.common.errors import InputError, SceneError

LEGS = ", ".join(["{by: [0, -0.1, 0], seconds: 2}"] * 9)
HEAD = "format: cmbot-campaign/1\nscene: short.yaml\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    with (tmp_path / "short.yaml").open("w", encoding="utf-8") as file:
        YAML().dump(deepcopy(SHORT), file)
    return tmp_path


def entries(folder: Path, text: str, **others: str) -> tuple[Entry, ...]:
    for name, content in others.items():
        (folder / f"{name}.csv").write_text(content, encoding="utf-8")
    (folder / "all.yaml").write_text(text, encoding="utf-8")
    return tuple(read_campaign(folder / "all.yaml")[1])


def test_jobs_are_variants_of_a_scene(folder: Path) -> None:
    text = f"""{HEAD}set: {{robot.payload_kg: 1, planner.samples_per_segment: 20}}
jobs:
  - {{name: a, at_m: 2.5}}
  - {{name: b, set: {{robot.payload_kg: 2, "tool_path.legs[0].by[1]": -0.2}}}}
  - {{name: c, scene: triangle}}
table: more.csv
"""
    table = "name,at_m,robot.payload_kg,tool_path.legs[0].seconds\nd,4,3.5,\n\ne,,, 5\n"
    a, b, c, d, e = entries(folder, text, more=table)
    assert [each.name for each in (a, b, c, d, e)] == [each.scene.name for each in (a, b, c, d, e)]
    assert [each.scene.robot.payload_kg for each in (a, b, c, d, e)] == [1, 2, 1, 3.5, 1]
    assert [each.at_m for each in (a, b, c, d, e)] == [2.5, None, None, 4, None]
    assert a.scene.strokes[0].legs[0].by == (0, -0.3, 0)
    assert b.scene.strokes[0].legs[0].by == (0, -0.2, 0)
    assert len(c.scene.strokes[0].legs) == 3
    # An empty cell leaves what the scene has.
    assert [d.scene.strokes[0].legs[0].seconds, e.scene.strokes[0].legs[0].seconds] == [4, 5]
    assert all(each.scene.planner.samples_per_segment == 20 for each in (a, b, c, d, e))
    assert len({each.scene.content_hash for each in (a, b, c, d, e)}) == 5


def test_a_folder_and_a_table_alone_are_campaigns(folder: Path) -> None:
    file, (only,) = read_campaign(folder)
    assert (file.name, only.name) == (folder.name, "short")
    (folder / "jobs.csv").write_text("name,scene\none,short.yaml\ntwo,line\n", encoding="utf-8")
    file, found = read_campaign(folder / "jobs.csv")
    assert (file.name, [each.name for each in found]) == ("jobs", ["one", "two"])


WRONG = {
    "jobs: [{name: a, set: {robot.payload_kg: -1}}]": (
        r"all.yaml:3: jobs\[0\].set.robot.payload_kg: got -1, expected .*0"
    ),
    "jobs: [{name: a}, {name: a}]": r"all.yaml:3: jobs\[1\].name: got 'a', expected a name that no other",
    "jobs: [{name: a/b}]": r"jobs\[0\].name: got 'a/b', expected 1 to 100 letters",
    "jobs: [{name: a, set: {robot.payload: 1}}]": r"jobs\[0\].set.robot.payload: .*payload_kg",
    "jobs: [{name: a, set: {'tool_path.legs[1].seconds': 1}}]": r"got item 1 of a list of 1",
    "jobs: [{name: a, set: {'tool_path.via_points.x': 1}}]": r"got a key x of no block",
    "jobs: [{name: a, set: {'tool_path..x': 1}}]": r"got no key, expected a key of the scene file",
    "jobs: [{name: a, set: {name: b}}]": r"got no key, expected a key of the scene file",
    "jobs: [{name: a, scene: lime}]": (
        r"all.yaml:3: jobs\[0\].scene: no such file 'lime', expected .* beside .*all.yaml.*mean line\?"
    ),
    "set: {tool_path.via_points: x}\njobs: [{name: a}]": r"all.yaml:3: set.tool_path.via_points: got 'x'",
    f"jobs: [{{name: a, set: {{tool_path.legs: [{LEGS}]}}}}]": (
        r"all.yaml:3: jobs\[0\].scene: tool_path.via_points: got 8, expected more than the 9 legs"
    ),
    "jobs: []": r"got none of them, expected one of jobs, table and folder",
    "job: [{name: a}]": r"job: .*jobs",
    "folder: nowhere": r"folder: no such folder 'nowhere'",
    "table: nowhere.csv": r"all.yaml:3: table: no such file 'nowhere.csv', expected",
    "table: t.csv\n# 1\n": r"t.csv:1: got 'naam,at_m', expected a line of different columns with commas",
    "table: t.csv\n# 2\n": r"t.csv:3: got 1 cell, expected 2 as in line 1",
    "table: t.csv\n# 3\n": r"t.csv:2: robot.payload_kg: got 'much', expected a number",
    "table: t.csv\n# 5\n": r"t.csv:3: scene: no such file 'b.yaml', expected a scene file beside .*all.yaml",
    "table: t.csv\n# 4\n": r"t.csv:2: at_m: got 'near', expected a number",
}
TABLES = {
    "1": "naam,at_m\n",
    "2": "name,at_m\na,1\nb\n",
    "3": "name,robot.payload_kg\na,much\n",
    "4": "name,at_m\na,near\n",
    "5": "name,scene\na,\nb,b.yaml\n",
}


@pytest.mark.parametrize("text", WRONG)
def test_what_is_wrong_is_named_by_its_place(folder: Path, text: str) -> None:
    number = text.partition("# ")[2].strip()
    with pytest.raises(InputError, match=WRONG[text]) as caught:
        entries(folder, f"{HEAD}{text}\n", **({"t": TABLES[number]} if number else {}))
    assert "\n" not in str(caught.value)


def test_a_template_that_is_wrong_is_not_the_jobs_fault(folder: Path) -> None:
    with (folder / "short.yaml").open("a", encoding="utf-8") as file:
        file.write("more: 1\n")
    lines = (folder / "short.yaml").read_text(encoding="utf-8").count("\n")
    with pytest.raises(SceneError, match=rf"short.yaml:{lines}: more: got an unknown key"):
        entries(folder, f"{HEAD}jobs: [{{name: a}}]\n")
    with pytest.raises(SceneError, match=rf"short.yaml:{lines}: more: got an unknown key"):
        (folder / "all.yaml").unlink()
        tuple(read_campaign(folder)[1])
    with pytest.raises(SceneError, match=r"all.yaml:2: scene: no such file 'gone.yaml'"):
        entries(folder, f"{HEAD.replace('short', 'gone')}jobs: [{{name: a}}]\n")
    (folder / "jobs.csv").write_text("name\nx\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"jobs.csv:1: got no column scene"):
        tuple(read_campaign(folder / "jobs.csv")[1])


def test_names_that_no_file_can_have_are_named(folder: Path) -> None:
    long = "a" * 300
    for text in (f"scene: {long}", f"scene: line\nfolder: {long}", f"scene: line\ntable: {long}"):
        with pytest.raises(InputError, match=r"no such f\w+ 'a+"):
            entries(folder, f"format: cmbot-campaign/1\n{text}\njobs: [{{name: a}}]\n")
    with pytest.raises(InputError, match=r"got a file that cannot be read \(File name too long\)"):
        read_campaign(long)


def test_files_are_named_as_they_were_given(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    (folder / "jobs.csv").write_text("name,scene,at_m\nx,line,near\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"^jobs.csv:2: at_m: got 'near'"):
        tuple(read_campaign("jobs.csv")[1])
    (folder / "span").mkdir()
    (folder / "span" / "a.yaml").write_text("format: cmbot-scene/2\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"^span/a.yaml: "):
        tuple(read_campaign("span")[1])
