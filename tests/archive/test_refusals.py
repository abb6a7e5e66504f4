"""What is refused of a plan directory as a whole: missing, damaged, of another version, of another plan."""

import json
import os
import re

import pytest
from plan_folders import FILES, edit, refused, rewrite, seal

from cmbot.archive import add_file, load_plan
from cmbot.common.errors import ArchiveError


@pytest.mark.parametrize("name", sorted(FILES))
def test_missing_files_and_folders_in_place_of_them(triangle_folder, name):
    (triangle_folder / name).unlink()
    assert "no such file" in str(refused(triangle_folder, name, ""))
    (triangle_folder / name).mkdir()
    refused(triangle_folder, name, "")


def test_a_plan_directory_nearby_is_asked_for(triangle_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArchiveError, match=r"; did you mean plan\?$") as caught:
        load_plan(".")
    assert (caught.value.source, caught.value.got) == ("./plan.json", "no such file")
    triangle_folder.parent.joinpath("out").mkdir()
    triangle_folder.rename(tmp_path / "out" / "line")
    with pytest.raises(ArchiveError, match=r"line: no such folder, .*; did you mean out/line\?$"):
        load_plan("line")
    with pytest.raises(ArchiveError, match=r"plan\.json: no such file, .*; did you mean out/line\?$"):
        load_plan("out")
    for slip in ("out/lien", "lien"):
        with pytest.raises(ArchiveError, match=r"lien: no such folder, .*; did you mean out/line\?$"):
            load_plan(slip)
    with pytest.raises(ArchiveError, match=r"^elsewhere: no such folder, .*cmbot plan writes it$"):
        load_plan("elsewhere")
    (tmp_path / "bare").mkdir()
    with pytest.raises(ArchiveError, match=r"^bare/plan\.json: no such file, expected a plan directory, as"):
        load_plan("bare")
    campaign = tmp_path / "out" / "bridge"
    for number in range(5):
        place = campaign / "plans" / f"{number}f" / f"bay_{number}"
        place.mkdir(parents=True)
        (place / "plan.json").touch()
    meant = r"did you mean \S*/0f/bay_0 or \S*/1f/bay_1 or \S*/2f/bay_2 or another one there\?$"
    for name in ("bridge", "out/bridge"):
        with pytest.raises(ArchiveError, match=meant):
            load_plan(name)
    (tmp_path / "bare" / "walk.json").touch()
    with pytest.raises(ArchiveError, match=r"; this folder is a walk's, which cmbot replay shows$"):
        load_plan("bare")
    for number in range(3):
        (tmp_path / "out" / f"a{number}").mkdir()
        (tmp_path / "out" / f"a{number}" / "plan.json").touch()
    with pytest.raises(ArchiveError, match=r"mean out/a0 or out/a1 or out/a2 or another one there\?$"):
        load_plan("out")


def test_no_folder(triangle_folder):
    with pytest.raises(ArchiveError, match="no such folder"):
        load_plan(triangle_folder / "nowhere")
    with pytest.raises(ArchiveError):
        load_plan("pl\0an")
    words = r"plan\.json: got a file, not a folder, expected a plan directory, .*; did you mean \S*/plan\?$"
    with pytest.raises(ArchiveError, match=words):
        load_plan(triangle_folder / "plan.json")


def test_paths_that_are_too_long(tmp_path, monkeypatch):
    """No folder has such a name; of a path that just fits no plan is sought nearby."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArchiveError, match="expected a plan directory"):
        load_plan("a" * 300)
    most = os.pathconf("/", "PC_PATH_MAX")
    with pytest.raises(ArchiveError, match=r": no such folder, expected a plan directory, .* writes it$"):
        load_plan(("a/" * most)[: most - 3] + "a")


@pytest.mark.parametrize("version", ["cmbot-plan/1", "cmbot-plan/3", "cmbot-scene/2", 1, None])
def test_other_versions(triangle_folder, version):
    edit(triangle_folder, lambda data: (data.update(format=version), data.pop("seconds")))
    error = refused(triangle_folder, "plan.json", "format")
    why = ": written by a development version; cmbot plan SCENE makes it anew"
    assert error.expected == "'cmbot-plan/2'" + why * str(version).startswith("cmbot-plan")


def test_a_plan_of_a_version_with_other_keys(triangle_folder):
    """Of the same format: what is missing is named, and what to do."""
    edit(triangle_folder, lambda data: data["baseline"].pop("drift"))
    error = refused(triangle_folder, "plan.json", "baseline.drift")
    assert "; the file was changed, or is of another version: cmbot plan SCENE makes it anew" in str(error)
    assert len(str(error)) <= 400


def test_pages_may_be_missing_and_a_changed_one_is_named_by_verify(triangle_folder):
    for name in ("report.html", "replay.html", "notes.txt"):
        add_file(triangle_folder, name, "page")
    (triangle_folder / "replay.html").unlink()
    load_plan(triangle_folder, verify=True)
    (triangle_folder / "report.html").write_text("edited")
    load_plan(triangle_folder)
    with pytest.raises(ArchiveError, match="other content") as caught:
        load_plan(triangle_folder, verify=True)
    assert caught.value.source == str(triangle_folder / "report.html")


def test_an_edited_plan_is_refused(triangle_folder):
    path = triangle_folder / "plan.json"
    path.write_text(path.read_text().replace('"drift": ', '"drift": 1', 1))
    assert "unchanged" in refused(triangle_folder, "plan.json", "content").expected


def with_number(number, name="drift"):
    return lambda text: re.sub(rf'"{name}": [^,]+', f'"{name}": {number}', text, count=1)


@pytest.mark.parametrize(
    ("change", "key", "got"),
    [
        (lambda text: text[: len(text) // 2], "", "no JSON (EOF"),
        (lambda text: "", "", "no JSON (EOF"),
        (lambda text: "[1]", "", "[1]"),
        (lambda text: "[" * 100_000, "", "recursion limit"),
        (lambda text: text.replace('"passes"', '"passed"', 1), "content", "another hash"),
        (lambda text: text.replace("clearance", "\udcff", 1), "", "UTF-8"),
        (with_number("NaN"), "", "NaN or Infinity at line"),
        (with_number("-Infinity"), "", "NaN or Infinity at line"),
        # Readers differ in which of two they take: at first, and within.
        (lambda text: text.replace("{", '{"planned": {}, ', 1), "planned", "there twice"),
        (lambda text: text.replace('"drift"', '"drift": 0, "drift"', 1), "drift", "there twice"),
        (with_number("9" * 5000), "", "number out of range"),
        # Too large for a float.
    ],
)
def test_damaged_json(triangle_folder, change, key, got):
    path = triangle_folder / "plan.json"
    path.write_bytes(change(path.read_text()).encode(errors="surrogateescape"))
    assert got in str(refused(triangle_folder, "plan.json", key))


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("drift", "baseline.drift"),
        ("velocity", "baseline.limit_use.velocity"),
        ("min_clearance", "baseline.min_clearance"),
    ],
)
def test_numbers_too_large_for_a_float(triangle_folder, name, key):
    path = triangle_folder / "plan.json"
    text = with_number("1e999", name)(path.read_text())
    sealed = seal(json.loads(text)).replace(b"Infinity", b"1e999")
    path.write_bytes(sealed)
    refused(triangle_folder, "plan.json", key)


def test_a_baseline_that_ends_too_early(triangle_folder):
    lines = (triangle_folder / "baseline.csv").read_text().splitlines()
    rewrite(triangle_folder, "baseline.csv", "\n".join(lines[:-1]).encode())
    refused(triangle_folder, "baseline.csv", "t")
