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
    (folder / "short.yaml").write_text(json.dumps(short_scene().as_data()), encoding="utf-8")
    with pytest.MonkeyPatch.context() as few:
        few.setattr(design, "_MAX_CANDIDATES", 40)
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
    # As the sheet's scene has it, they were not used.
    assert outcome.out.endswith(f"identified: {target}, with robot.joints: elastic in place of rigid\n")
    data = short_scene(robot={"joints": "elastic"}).as_data() | {"identified": target.name}
    scene = measured.with_name("known.yaml")
    scene.write_text(json.dumps(data), encoding="utf-8")
    assert cmbot.load_scene(scene).identified is not None
    again = run("identify", measured)
    assert again.status == 2
    assert "expected a new file, or --force" in again.err
    printed = run("identify", measured, "--force", "--json")
    entries = json.loads(printed.out)
    assert entries["verb"] == "identify"
    assert entries["sag_error_95"] < 0.2
    assert set(entries["factors"]) >= {"link_1", "joint_1"}


def test_a_misfit_is_refused_with_its_row_unless_it_is_accepted(sheet: Path) -> None:
    text, target = filled(sheet).read_text(encoding="utf-8"), sheet.with_name("wrong.stiffness.yaml")
    # A wrong sign of the last row's z.
    before, rest = text.rsplit("deflection_mm: [", 1)
    x, y, z = rest.split("]", 1)[0].split(",")
    wrong = sheet.with_name("wrong.yaml")
    row = f"deflection_mm: [{x},{y}, {-float(z)}]"
    wrong.write_text(f"{before}{row}{rest.split(']', 1)[1]}", encoding="utf-8")
    refused = run("identify", wrong)
    assert refused.status == 2
    assert "measurements[" in refused.err
    assert refused.err.endswith("--accept-misfit (in Python accept_misfit=True)\n")
    assert not target.exists()
    accepted = run("identify", wrong, "--accept-misfit", "--json")
    assert accepted.status == 0, accepted.err
    entries = json.loads(accepted.out)
    assert entries["fit"]["deflection_mm"]["errors_times"] > 1
    assert entries["worst_rows"][0]["standard_deviations"] > 5
    assert target.exists()


def test_more_postures_are_proposed_beside_those_measured(
    sheet: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(design, "_MAX_CANDIDATES", 40)
    monkeypatch.setattr(design, "_REFINED", ())
    measured = filled(sheet)
    outcome = run("identify", measured, "--propose", 1, "--axes", "z", "--weight", 4)
    assert outcome.status == 0, outcome.err
    second = measured.with_name("measured_2.yaml")
    assert f"then: cmbot identify {measured} {second}" in outcome.out
    assert "After 1 more posture with 4 kg, z to 0.05 mm" in outcome.out
    sheets = second.read_text(encoding="utf-8")
    assert "deflection_mm: {z: null}" in sheets
    second.write_text(re.sub("{z: null}  # about (.*)", r"{z: \1}", sheets), encoding="utf-8")
    both = run("identify", measured, second)
    assert both.status == 0, both.err
    assert "Assumes 4 kg (weight_kg)" in both.out
    assert measured.with_name("measured_2.stiffness.yaml").exists()


def test_what_it_cannot_use_is_refused(sheet: Path) -> None:
    missing = run("identify", sheet.with_name("none.yaml"))
    assert missing.status == 2
    assert "none.yaml" in missing.err
    empty = run("identify", sheet)
    assert empty.status == 2
    assert "measurements: got none, expected a measured number" in empty.err
    scene = run("identify", "triangle")
    assert scene.status == 2
    assert "triangle: got a scene, expected a file of measurements: cmbot identify triangle --propose 8" in (
        scene.err
    )
    own = run("identify", sheet.with_name("short.yaml"))
    assert "short.yaml: got a scene, expected a file of measurements" in own.err
    two = run("identify", "triangle", "line", "--propose", 2)
    assert "line: got a second file, expected one scene, or files of measurements" in two.err
    light = run("identify", "triangle", "--propose", 2, "--weight", 0, "-o", sheet.with_name("x.yaml"))
    assert light.status == 2
    assert "--weight: got 0.0, expected more than 0" in light.err


def test_a_table_of_deflections_says_what_its_sheets_do(
    sheet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of two weights, in other units, with the joints in another order, and only along two axes."""
    monkeypatch.setattr(design, "_MAX_CANDIDATES", 40)
    monkeypatch.setattr(design, "_REFINED", ())
    rows = re.findall(
        r"posture_deg: \[([^\]]*)\][^#]*deflection_mm: [^#]*# about (.*)", sheet.read_text(encoding="utf-8")
    )
    assert len(rows) == 3
    postures = [[float(x) for x in posture.split(",")] for posture, _ in rows]
    moved = [[1.2 * float(x) for x in deflection.split(",")] for _, deflection in rows]
    weights = [5.0, 5.0, 2.5]
    scene, joints = str(sheet.with_name("short.yaml")), [f"q{k}_deg" for k in range(7, 0, -1)]
    lines = [";".join(["Weight (kg)", "dz (m)", *joints, "dx (m)", "note"])]
    sheets = []
    for k, (posture, way, weight) in enumerate(zip(postures, moved, weights, strict=True)):
        cells = [weight, 1e-3 * way[2], *posture[::-1], 1e-3 * way[0], k]
        lines.append(";".join(map(repr, cells)))
    for weight in (2.5, 5.0):
        measurements = [
            {"posture_deg": posture, "deflection_mm": {"x": way[0], "z": way[2]}}
            for posture, way, own in zip(postures, moved, weights, strict=True)
            if own == weight
        ]
        content = {"format": "cmbot-measurements/1", "scene": scene, "weight_kg": weight}
        sheets.append(content | {"measurements": measurements})
    table = tmp_path / "deflections.csv"
    table.write_text("\n".join(lines), encoding="utf-8")
    outcome = run("identify", scene, "--table", table, "--json", "--accept-misfit")
    assert outcome.status == 0, outcome.err
    found, expected = json.loads(outcome.out), cmbot.identify(*sheets, accept_misfit=True)
    assert found["file"] == str(tmp_path / "deflections.stiffness.yaml")
    factors = {each.name: each.factor for each in (*expected.stiffness.links, *expected.stiffness.joints)}
    assert found["factors"] == pytest.approx(factors, rel=1e-6)
    told = run("identify", scene, "--table", table, "--gauge", 0.3, "--accept-misfit", "--force")
    assert "Assumes a gauge's error of 0.3 mm (gauge_sd_mm)" in told.out
    assert "Sag along the job" in told.out
    # More postures beside those of the table, not the first ones of the scene.
    more = run("identify", scene, "--table", table, "--propose", 1, "--accept-misfit")
    assert more.status == 0, more.err
    assert "mm RMS as 3 postures told" in more.out
    assert f"then: cmbot identify {tmp_path / 'deflections_2.yaml'} --table {table}" in more.out
    for words in ((), ("--propose", 1)):
        alone = run("identify", table, *words)
        assert f"got a table, expected cmbot identify SCENE --table {table}" in alone.err
    # Beside a sheet, whose scene it is of.
    both = run("identify", filled(sheet), "--table", table, "--accept-misfit", "--force")
    assert both.status == 0, both.err
    assert "Assumes 2.5 kg (weight_kg)" in both.out


@pytest.mark.parametrize(
    ("heading", "row", "told"),
    [
        ("q1,q2,q3,q4,q5,q6,q7,dx", "0,0,0,0,0,0,0,1", "a column weight_kg"),
        ("q1,q2,q3,q4,q5,q6,q7,kg", "0,0,0,0,0,0,0,1", "columns dx, dy, dz"),
        ("q1,q2,q3,q4,q5,q6,kg,dx", "0,0,0,0,0,0,1,1", "no column of joint"),
        ("q1,q2,q3,q4,q5,q6,q7,kg,dx", "0,0,0,0,0,0,0,0,1", "line 2, kg: got 0"),
        ("q1,q2,q3,q4,q5,q6,q7,kg,dx (furlong)", "0,0,0,0,0,0,0,1,1", "the unit furlong"),
        ("q1,q2,q3,q4,q5,q6,q7,kg,dx", "0,0,0,0,0,0,x,1,1", "line 2, q7"),
    ],
)
def test_tables_that_say_too_little(heading: str, row: str, told: str, tmp_path: Path) -> None:
    (tmp_path / "table.csv").write_text(f"{heading}\n{row}\n", encoding="utf-8")
    outcome = run("identify", "triangle", "--table", tmp_path / "table.csv")
    assert outcome.status == 2 and told in outcome.err
    assert [path.name for path in tmp_path.iterdir()] == ["table.csv"]
