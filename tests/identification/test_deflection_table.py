"""Tables of measurements say what sheets do: weights, gauges and records row by row."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from command_line import run
from scipy.optimize import least_squares
from small_scenes import short_scene
from test_records import oscillations, write

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import elastic_arm
from cmbot.elastic.modes import arm_modes
from cmbot.identification import (
    Measurements,
    MeasuringSetup,
    Part,
    estimate,
    identify,
    measured_arm,
    problem,
    read_deflections,
    read_measurements,
    remarks,
    require_fit,
)
from cmbot.identification.model import DeflectionModel

POSTURE = np.array(short_scene().posture)
JOINTS = ",".join(f"q{k}_deg" for k in range(1, 8))


def row(*cells: object, turned: float = 0.0) -> str:
    return ",".join(map(str, [*np.degrees(POSTURE + turned).tolist(), *cells]))


def table(folder: Path, heading: str, *rows: str) -> Path:
    path = folder / "t.csv"
    path.write_text("\n".join([heading, *rows]), encoding="utf-8")
    return path


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.yaml").write_text(json.dumps(short_scene().as_data()), encoding="utf-8")
    return "short.yaml"


def same(one: Measurements, other: Measurements) -> None:
    np.testing.assert_allclose(one.q, other.q, atol=1e-12)
    np.testing.assert_array_equal(one.deflection, other.deflection)
    for key in ("weight_kg", "gauge_sd_mm", "record_axes"):
        assert getattr(one.setup, key) == getattr(other.setup, key)
    for ours, theirs in zip(one.modes, other.modes, strict=True):
        np.testing.assert_array_equal(ours.frequencies, theirs.frequencies)
        np.testing.assert_array_equal(ours.directions, theirs.directions)


def test_weights_gauges_and_records_row_by_row(scene: str, tmp_path: Path, rng: np.random.Generator) -> None:
    folder = tmp_path / "measured"
    folder.mkdir()
    write(folder / "tap.csv", oscillations([(6.0, 0.02, [1.0, 0.2, 0.1])], 0.01, rng))
    heading = f"{JOINTS},weight_kg,dx_mm,dz/mm,gauge_mm,record,record_axes,note"
    path = table(
        folder,
        heading,
        row(5, 0.4, -3.9, 0.05, "", "", "first"),
        row(2.5, "", -1.9, "", "", "", "", turned=0.1),
        row("", "", "", "", "tap.csv", "tool", "only a tap"),
        row(5, 0.5, -4.1, 0.05, "", "", "", turned=0.2),
    )
    postures = [POSTURE + turned for turned in (0.0, 0.1, 0.0, 0.2)]
    each = [
        ({"weight_kg": 5.0, "gauge_sd_mm": 0.05}, {0: {"x": 0.4, "z": -3.9}, 3: {"x": 0.5, "z": -4.1}}),
        ({"weight_kg": 2.5, "gauge_sd_mm": 0.2}, {1: {"z": -1.9}}),
        ({"gauge_sd_mm": 0.2, "record_axes": "tool"}, {2: None}),
    ]
    found = read_deflections(path, scene, gauge_sd_mm=0.2)
    assert [sheet.rows for sheet in found] == [("line 2", "line 5"), ("line 3",), ("line 4",)]
    for sheet, (setup, rows) in zip(found, each, strict=True):
        measurements = [
            {"posture": postures[k].tolist()}
            | ({"record": str(folder / "tap.csv")} if moved is None else {"deflection_mm": moved})
            for k, moved in rows.items()
        ]
        content = {"format": "cmbot-measurements/1", "scene": scene, "measurements": measurements}
        same(sheet, read_measurements(content | setup))


def test_frequencies_and_the_modes_they_were_given_to_are_printed(
    scene: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    slowest = float(arm_modes(measured_arm(short_scene()), POSTURE).frequencies[0])
    write(tmp_path / "tap.csv", oscillations([(slowest, 0.02, [1.0, 0.2, 0.1])], 0.01, rng))
    outcome = run("identify", scene, "--table", table(tmp_path, f"{JOINTS},record", row("tap.csv")))
    assert outcome.status == 0, outcome.err
    (told,) = (line.split() for line in outcome.out.splitlines() if line.startswith("tap.csv (line 2)  "))
    frequency, damping, deviation = map(float, told[3:6])
    assert frequency == pytest.approx(slowest, rel=5e-3)
    assert 0 < deviation < 0.1
    assert abs(damping - 2) < 3 * deviation
    assert told[6] == "1"
    assert "Damping of the modes in the records: " in outcome.out
    assert "standard deviation 0.0 %" not in outcome.out
    assert "% from mode to mode" in outcome.out


@pytest.mark.parametrize(
    ("axes", "posture", "order", "size", "told"),
    [
        ("tool", 0.0, [0, 1, 2], 9.81, ""),
        ("tool", 0.0, [0, 1, 2], 9807.0, ""),
        ("W", 0.0, [0, 1, 2], 9.81, "deg away from gravity in this posture along its record_axes, expected"),
        ("W", 0.0, [0, 1, 2], 9.81, "less than 15: with record_axes: tool it fits"),
        ("tool", 0.4, [0, 1, 2], 1.0, "line 3, record: got a mean"),
        ("tool", 0.4, [0, 1, 2], 9807.0, "it fits the posture of line 2"),
        ("tool", 0.0, [1, 2, 0], 9.81, "with the sensor's z, x, y in place of x, y, z it fits"),
        # A horizontal axis may point either way: not the mirror y, x, z, which no mounting is.
        ("tool", 0.0, [1, 0, 2], 9.81, "with the sensor's y, -x, z in place of x, y, z it fits"),
        ("tool", 0.0, [1, 0, 2], 0.05, ""),
    ],
)
def test_a_records_rest_is_gravity_in_its_posture_and_axes(
    axes: str,
    posture: float,
    order: list[int],
    size: float,
    told: str,
    scene: str,
    tmp_path: Path,
    rng: np.random.Generator,
) -> None:
    """The sensor is along the tool, in the posture of line 2; rows name other axes or postures, too."""
    arm = measured_arm(short_scene())
    model, data = arm.robot.model, arm.robot.model.createData()
    pin.framesForwardKinematics(model, data, POSTURE)
    up = data.oMf[arm.robot.tool_frame_id].rotation.T @ [0.0, 0.0, 1.0]
    slowest = float(arm_modes(arm, POSTURE).frequencies[0])
    tap = oscillations([(slowest, 0.02, (0.1 * size * up).tolist())], 1e-3 * size, rng)
    write(tmp_path / "tap.csv", (tap + size * up)[:, order])
    rows = [row("tap.csv", axes, turned=posture)] + [row("", axes)] * (posture > 0)
    path = table(tmp_path, f"{JOINTS},record,record_axes", *rows[::-1])
    outcome = run("identify", scene, "--table", path)
    assert outcome.status == (2 if told else 0), outcome.err
    assert told in outcome.err
    assert ("Without gravity along x, y and z in it" in outcome.out) == (size < 0.5)
    accepted = run("identify", scene, "--table", path, "--accept-misfit", "--force")
    assert accepted.status == 0, accepted.err
    assert ("deg away from gravity along its record_axes; " in accepted.out) == bool(told)


def test_a_frequency_of_no_mode_alone_tells_nothing(
    scene: str, tmp_path: Path, rng: np.random.Generator
) -> None:
    """Nothing is left that was measured, and the stiffness stays as modelled."""
    slowest = float(arm_modes(measured_arm(short_scene()), POSTURE).frequencies[0])
    write(tmp_path / "tap.csv", oscillations([(0.5 * slowest, 0.02, [1.0, 0.2, 0.1])], 0.01, rng))
    outcome = run("identify", scene, "--table", table(tmp_path, f"{JOINTS},record", row("tap.csv")))
    assert outcome.status == 0, outcome.err
    assert "is left out, as no mode of the arm is within 30 % of it" in outcome.out


@pytest.mark.parametrize(
    ("heading", "cells", "told"),
    [
        (f"{JOINTS},kg,dz,recrod", (5, -3, "x"), "line 1, recrod: got an unknown column"),
        (f"{JOINTS},kg,dz,recrod", (5, -3, "x"), "did you mean record?"),
        (f"{JOINTS},kg,dz,colour", (5, -3, "red"), "weight_kg, dx, dy, dz, record"),
        (f"{JOINTS},kg,dz", ("", -3), "line 2, kg: got nothing, expected the weight that was hung on"),
        (f"{JOINTS},kg,dz", (0, -3), "line 2, kg: got 0, expected the weight that was hung on"),
        (f"{JOINTS},kg,dz", (5, -3000), "line 2, deflection_mm[2]: got -3000.0, expected at least -1000"),
        (f"{JOINTS},kg,dz,gauge_mm", (5, -3, 0), "line 2, gauge_sd_mm: got 0.0, expected at least"),
        (f"{JOINTS},record", ("none.csv",), "line 2, record: got none.csv, expected a file that exists"),
        (f"{JOINTS},kg,dz,record_axes", (5, -3, "gripper"), "line 2, record_axes: got"),
        (JOINTS.replace("q2_deg", "q2") + ",kg,dz", (5, -3), "line 2, posture: got joint_2 at -90 rad"),
        (JOINTS.replace("q2_deg", "q2") + ",kg,dz", (5, -3), "in a table joint_2_deg or q2_deg"),
    ],
)
def test_messages_name_the_line_and_what_to_do(
    heading: str, cells: tuple[object, ...], told: str, scene: str, tmp_path: Path
) -> None:
    path = table(tmp_path, heading, ",".join(map(str, [0, -90, 90, 0, 10, 50, 0, *cells])))
    with pytest.raises(InputError) as refused:
        read_deflections(path, scene)
    assert told in str(refused.value)
    assert str(path) in str(refused.value)
    assert len(str(refused.value)) <= 400


@pytest.mark.parametrize(
    ("factors", "told", "recorded"),
    [
        ((1e-3, 1e-3, 1e-3), "expected deflections in mm: times 1000 these fit, as if in m;", False),
        ((100.0, 100.0, 100.0), "times 0.01 these fit, as if in hundredths of a millimetre;", True),
        ((0.1, 0.1, 0.1), "times 10 these fit, as if in cm;", False),
        ((-1.0, -1.0, -1.0), "the other sign of x, y, z fits", False),
        ((1.0, 1.0, -1.0), "the other sign of z fits", False),
        (None, "line 4, deflection_mm: got", False),
        (None, "columns along x, y, z of W: with x and y exchanged it fits", False),
    ],
)
def test_units_signs_and_exchanged_columns_are_recognised(
    factors: tuple[float, float, float] | None,
    told: str,
    recorded: bool,
    scene: str,
    tmp_path: Path,
    rng: np.random.Generator,
) -> None:
    q = POSTURE + np.random.default_rng(5).uniform(-0.4, 0.4, (4, 7))
    arm = measured_arm(short_scene())
    setup = read_measurements(
        {
            "format": "cmbot-measurements/1",
            "scene": scene,
            "measurements": [{"posture": q[0].tolist(), "deflection_mm": [1, 1, 1]}],
        }
    ).setup
    model = DeflectionModel(arm, setup, q)
    deflections = 1e3 * model.at(np.zeros(model.parameters.count))[0] * 1.1
    if factors is None:
        deflections[2] = deflections[2, [1, 0, 2]]
    else:
        deflections *= factors
    modes = [(f, 0.02, [1.0, 0.7, 0.4]) for f in arm_modes(arm, q[0]).frequencies[:3].tolist()]
    write(tmp_path / "tap.csv", oscillations(modes, 0.01, rng))
    records = ["tap.csv" if recorded and k == 0 else "" for k in range(len(q))]
    rows = [
        ",".join(map(str, [*np.degrees(each), 5, *moved, record]))
        for each, moved, record in zip(q, deflections, records, strict=True)
    ]
    path = table(tmp_path, f"{JOINTS},weight_kg,dx,dy,dz,record", *rows)
    with pytest.raises(InputError) as refused:
        identify(*read_deflections(path, scene))
    assert told in str(refused.value)
    assert str(path) in str(refused.value)


def test_a_gauge_at_another_frame_of_the_last_link_is_recognised(scene: str, tmp_path: Path) -> None:
    """A weight in g is one, too."""
    q = POSTURE + np.random.default_rng(5).uniform(-0.6, 0.6, (5, 7))
    arm = measured_arm(short_scene())
    at_link = elastic_arm(replace(arm.robot, tool_frame="link_7"), arm.base)
    model = DeflectionModel(at_link, MeasuringSetup(), q)
    moved = 1e3 * model.at(np.zeros(model.parameters.count))[0]
    rows = [
        ",".join(map(str, [*np.degrees(each), 5, *own])) for each, own in zip(q, moved.tolist(), strict=True)
    ]
    path = table(tmp_path, f"{JOINTS},weight_kg,dx,dy,dz", *rows)
    with pytest.raises(InputError) as refused:
        identify(*read_deflections(path, scene, gauge_sd_mm=0.01))
    assert f"the gauge at robot.tool_frame ({arm.robot.tool_frame}): at tool or link_7 it fits" in str(
        refused.value
    )
    path = table(tmp_path, f"{JOINTS},kg,dz", row(5000, -3))
    with pytest.raises(InputError, match="kg, not g"):
        identify(*read_deflections(path, scene))


def folded(scene: str) -> tuple[dict[str, Any], FloatArray]:
    """What 5 kg do to the arm as modelled in postures in which it holds 7 kg, and the modes of the first."""
    turned = np.random.default_rng(5).uniform(-0.6, 0.6, (6, 7))
    turned[:, 3] -= 1.0
    q = POSTURE + turned
    arm = measured_arm(short_scene())
    model = DeflectionModel(arm, MeasuringSetup(weight_kg=5.0), q)
    moved = 1e3 * model.at(np.zeros(model.parameters.count))[0]
    rows = [
        {"posture": each, "deflection_mm": own} for each, own in zip(q.tolist(), moved.tolist(), strict=True)
    ]
    content = {"format": "cmbot-measurements/1", "scene": scene, "gauge_sd_mm": 0.01, "measurements": rows}
    return content, arm_modes(arm, q[0]).frequencies


def test_a_fit_that_cannot_succeed_ends_early(scene: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Deflections in hundredths of a millimetre: residuals stay hundreds of standard deviations large."""
    content, _ = folded(scene)
    for each in content["measurements"]:
        each["deflection_mm"] = [100 * own for own in each["deflection_mm"]]
    ended = list[tuple[int, float]]()

    def fitted(*args: Any, **options: Any) -> Any:
        found = least_squares(*args, **options)
        ended.append((found.nfev, float(np.sqrt(2 * found.cost / len(found.fun)))))
        return found

    monkeypatch.setattr(problem, "least_squares", fitted)
    estimate(read_measurements(content))
    hopeless = [evaluations for evaluations, size in ended if size > 20]
    assert hopeless
    assert max(hopeless) < 50
    # By errors as large as that it fits.
    assert ended[-1][1] < 2


def test_frequencies_may_not_fit_by_a_wrong_weight(scene: str) -> None:
    """All deflections are those of a lighter weight than stated; frequencies are of the arm."""
    content, modes = folded(scene)
    content["measurements"][0]["frequencies_hz"] = modes[:3].tolist()
    with pytest.raises(InputError, match="a wrong weight_kg"):
        identify(content | {"weight_kg": 7.0})
    assert identify(content | {"weight_kg": 5.0}).slips == ()


def test_a_weight_that_no_joint_can_hold_is_refused(scene: str) -> None:
    """The joint, its torque and the weight that it holds are those of Pinocchio's statics."""
    content, _ = folded(scene)
    robot = measured_arm(short_scene()).robot

    def torque(row: int, kg: float) -> FloatArray:
        model, q = robot.model.copy(), np.array(content["measurements"][row]["posture"])
        at = model.frames[robot.tool_frame_id]
        point = pin.Inertia(kg, at.placement.translation, np.zeros((3, 3)))
        model.inertias[at.parentJoint] += point
        return np.asarray(pin.computeGeneralizedGravity(model, model.createData(), q))

    with pytest.raises(InputError) as refused:
        identify(content | {"weight_kg": 20.0})
    told = re.search(
        r"\[(\d)\]: got 20 kg, with which joint_(\d) bears (\d+) Nm, .* holds ([\d.]+) kg in this posture",
        str(refused.value),
    )
    assert told is not None, refused.value
    row, joint = int(told[1]), int(told[2]) - 1
    assert abs(torque(row, 20.0)[joint]) == pytest.approx(float(told[3]), abs=0.5)
    assert abs(torque(row, float(told[4]))[joint]) == pytest.approx(robot.limits.torque[joint], rel=0.02)
    identify(content | {"weight_kg": 20.0}, accept_misfit=True)
    # Before its deflections are taken for some in another unit.
    with pytest.raises(InputError, match=r"got 49.05 kg, with which .*; weight_kg in kg, not g or N"):
        identify(content | {"weight_kg": 49.05})


@pytest.mark.parametrize(("shares", "refused"), [((0.5, 0.6, 1.0), True), ((0.5, 1.0, 1.0), False)])
def test_most_frequencies_of_a_posture_are_of_a_mode(
    shares: tuple[float, ...], refused: bool, scene: str
) -> None:
    content, modes = folded(scene)
    content["measurements"][0]["frequencies_hz"] = sorted((modes[:3] * shares).tolist())
    if not refused:
        assert [not each.modes for each in identify(content).matched] == [True, False, False]
        return
    with pytest.raises(InputError, match=r"2 of 3 frequencies.* a wrong weight_kg") as error:
        identify(content)
    assert f"the slowest of {modes[0]:.3g} Hz" in str(error.value)


@pytest.mark.parametrize(
    ("deflection", "gauge", "told"),
    [(-3.01, None, "state --gauge 0.01."), (-3.1, None, ""), (-3.01, 0.1, "")],
)
def test_an_error_of_the_gauge_that_is_not_stated_is_that_of_its_steps(
    deflection: float, gauge: float | None, told: str, scene: str, tmp_path: Path
) -> None:
    path = table(tmp_path, f"{JOINTS},kg,dz", row(5, deflection))
    (line,) = (
        line
        for line in remarks(estimate(read_deflections(path, scene, gauge_sd_mm=gauge)))
        if "a gauge's error of 0.1 mm" in line
    )
    assert line.endswith(told or "one standard deviation.")


def test_frequencies_that_contradict_an_arm_far_from_its_model_are_refused(scene: str) -> None:
    """What chance does now and then in one part, it hardly does in two for one reason."""
    content, modes = folded(scene)
    content["measurements"][0]["frequencies_hz"] = modes[:3].tolist()
    found = identify(content)
    worse = Part(kind="frequencies_hz", square=36.0, redundancy=1.0, probability=0.005, scale=6.0)
    prior = Part(kind="prior", square=20.0, redundancy=10.0, probability=0.005)
    require_fit(replace(found, parts=(worse, prior)))
    with pytest.raises(InputError, match=r"true weight_kg"):
        require_fit(replace(found, parts=(worse, replace(prior, scale=1.4))))


def test_radians_under_the_names_of_degrees_are_told(scene: str, tmp_path: Path) -> None:
    """What is advised is read: a Panda's fourth joint is never straight."""
    cells = "0.5,0.4,-0.5,-0.8,0.3,1.6,0.2,5,0.1,0.2,-0.5"
    file = table(tmp_path, f"{JOINTS},weight_kg,dx,dy,dz", cells)
    with pytest.raises(InputError, match=r"line 2, posture_deg: .* deg; radians.* or q4 .without _deg."):
        read_deflections(file, "panda_sanding")
    file = table(tmp_path, f"{JOINTS.replace('_deg', '')},weight_kg,dx,dy,dz", cells)
    (read,) = read_deflections(file, "panda_sanding")
    np.testing.assert_array_equal(read.q[0], [0.5, 0.4, -0.5, -0.8, 0.3, 1.6, 0.2])


def test_the_axis_that_a_record_lacks_is_named(scene: str, tmp_path: Path, rng: np.random.Generator) -> None:
    slowest = float(arm_modes(measured_arm(short_scene()), POSTURE).frequencies[0])
    tap = oscillations([(slowest, 0.02, (0.1, 0.1, 0.1))], 1e-3, rng)
    write(tmp_path / "tap.csv", tap)
    lines = (tmp_path / "tap.csv").read_text(encoding="utf-8").splitlines()
    two = [line.rpartition(",")[0] for line in lines]
    (tmp_path / "tap.csv").write_text("\n".join(two), encoding="utf-8")
    path = table(tmp_path, f"{JOINTS},record,record_axes", row("tap.csv", "tool"))
    outcome = run("identify", scene, "--table", path)
    assert outcome.status == 0, outcome.err
    assert "as stated: t.csv: line 2, record (no column of z)." in outcome.out.replace(f"{tmp_path}/", "")
