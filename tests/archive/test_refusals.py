"""What is refused of a plan directory as a whole: missing, damaged, of another version, of another plan."""

import re

import numpy as np
import pytest
from plan_folders import FILES, edit, npz, refused, rewrite

from cmbot.archive import load_plan
from cmbot.common.errors import ArchiveError


@pytest.mark.parametrize("name", sorted(FILES))
def test_missing_files(triangle_folder, name):
    (triangle_folder / name).unlink()
    assert "no such file" in str(refused(triangle_folder, name, ""))


def test_a_plan_directory_nearby_is_asked_for(triangle_folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ArchiveError, match=r"; did you mean plan\?$") as caught:
        load_plan(".")
    assert (caught.value.source, caught.value.got) == ("plan.json", "no such file")
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
    for number in range(3):
        (tmp_path / "out" / f"a{number}").mkdir()
        (tmp_path / "out" / f"a{number}" / "plan.json").touch()
    with pytest.raises(ArchiveError, match=r"mean out/a0 or out/a1 or out/a2 or another one there\?$"):
        load_plan("out")


def test_a_file_is_no_folder(triangle_folder):
    with pytest.raises(
        ArchiveError, match=r"plan\.json: got a file, not a folder, expected a plan directory"
    ):
        load_plan(triangle_folder / "plan.json")


@pytest.mark.parametrize("name", sorted(FILES))
def test_folders_in_place_of_files(triangle_folder, name):
    (triangle_folder / name).unlink()
    (triangle_folder / name).mkdir()
    refused(triangle_folder, name, "")


@pytest.mark.parametrize("name", sorted(FILES - {"plan.json"}))
def test_files_of_another_plan(triangle_folder, name):
    """Valid by itself, but not what the figures are of."""
    content = (triangle_folder / name).read_bytes()
    if name.endswith("npz"):
        with np.load(triangle_folder / name) as knots:
            content = npz(**{**knots, "q": knots["q"] + 1e-6})
    elif name.endswith("csv"):
        header, first, *rest = content.decode().splitlines()
        content = "\n".join([header, first, *rest[:-1], rest[-1].replace("9", "8", 1), ""]).encode()
    else:
        content += b" "
    (triangle_folder / name).write_bytes(content)
    with pytest.raises(ArchiveError) as caught:
        load_plan(triangle_folder)
    assert caught.value.source == str(triangle_folder / name)


def test_no_folder(tmp_path):
    with pytest.raises(ArchiveError, match="no such folder"):
        load_plan(tmp_path / "nowhere")
    with pytest.raises(ArchiveError):
        load_plan("pl\0an")


@pytest.mark.parametrize("version", ["cmbot-plan/2", "cmbot-scene/1", 1, None])
def test_other_versions(triangle_folder, version):
    edit(triangle_folder, lambda data: (data.update(format=version), data.pop("seconds")))
    error = refused(triangle_folder, "plan.json", "format")
    assert error.expected == "'cmbot-plan/1'"


def with_number(number, name="drift"):
    return lambda text: re.sub(rf'"{name}": [^,]+', f'"{name}": {number}', text, count=1)


@pytest.mark.parametrize(
    ("change", "key", "got"),
    [
        (lambda text: text[: len(text) // 2], "", "breaks off"),
        (lambda text: "", "", "breaks off"),
        (lambda text: "[1]", "", "[1]"),
        (lambda text: "[" * 100_000, "", "recursion"),
        (lambda text: text.replace('"drift"', '"status"', 1), "'status'", "the same key again"),
        (with_number("NaN"), "", "NaN"),
        (with_number("-Infinity"), "", "-Infinity"),
        (with_number("9" * 5000), "", "integer"),
    ],
)
def test_damaged_json(triangle_folder, change, key, got):
    path = triangle_folder / "plan.json"
    path.write_text(change(path.read_text()))
    assert got in str(refused(triangle_folder, "plan.json", key))


def test_json_in_another_encoding(triangle_folder):
    path = triangle_folder / "plan.json"
    path.write_bytes(path.read_bytes().replace(b"clearance", b"\xff", 1))
    assert "UTF-8" in str(refused(triangle_folder, "plan.json", ""))


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda data: data.pop("drift"), "drift"),
        (lambda data: data.update(colour="red"), "colour"),
        (lambda data: data.update(status="hoped for"), "status"),
        (lambda data: data.update(torque_floor=1.0), "torque_floor"),
        (lambda data: data["planned"].update(peak_guardrail_torque="486"), "planned.peak_guardrail_torque"),
        (lambda data: data["planned"]["limit_use"].pop("jerk"), "planned.limit_use.jerk"),
        (lambda data: data["planned"]["limit_use"].update(jerk=-0.1), "planned.limit_use.jerk"),
        (lambda data: data["seconds"].update(total=-1.0), "seconds.total"),
        (lambda data: data["passes"][0].update(iterations=-1), "passes[0].iterations"),
        (lambda data: data["passes"][0]["worst"].update(colour="red"), "passes[0].worst.colour"),
        (lambda data: data["scene"]["tool_path"].update(legs=[]), "scene.tool_path.legs"),
        (lambda data: data["options"].update(damping_max=-1), "options.damping_max"),
        (lambda data: data["hashes"].update(robot="0"), "hashes.robot"),
        (lambda data: data["hashes"].update(robot="0" * 64), "hashes.robot"),
        (lambda data: data["scene"].update(name="other"), "hashes.resolved_scene"),
        (lambda data: data["certificate"].update(checks=[]), "certificate.checks"),
        (lambda data: data["certificate"]["checks"][3].update(holds=False), "certificate.checks[3]"),
        (lambda data: data["certificate"]["checks"][7].update(value=0.0), "certificate.checks[7]"),
        (lambda data: data["start"].update(posture_deg=[1.0, 2.0]), "start.posture_deg"),
        (lambda data: data["start"].update(posture_deg=[]), "start.posture_deg"),
        (lambda data: data["start"]["posture_deg"].__setitem__(2, 1.0), "start.posture_deg"),
    ],
)
def test_wrong_content_is_named_by_its_key(triangle_folder, change, key):
    edit(triangle_folder, change)
    refused(triangle_folder, "plan.json", key)


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("drift", "drift"),
        ("velocity", "baseline.limit_use.velocity"),
        ("min_clearance", "baseline.min_clearance"),
    ],
)
def test_a_number_too_large_for_a_float(triangle_folder, name, key):
    path = triangle_folder / "plan.json"
    path.write_text(with_number("1e999", name)(path.read_text()))
    refused(triangle_folder, "plan.json", key)


def test_a_baseline_that_ends_too_early(triangle_folder):
    lines = (triangle_folder / "baseline.csv").read_text().splitlines()
    rewrite(triangle_folder, "baseline.csv", "\n".join(lines[:-1]).encode())
    refused(triangle_folder, "baseline.csv", "t")
