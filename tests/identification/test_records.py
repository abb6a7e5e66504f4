"""Records of an accelerometer: modes of sums of damped oscillations, and of the elastic arm after a tap."""

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from command_line import refusal, write_scene
from scipy.signal import lfilter
from small_scenes import short_scene

from cmbot.common.errors import InputError
from cmbot.elastic.generalized_alpha import ElasticSystem, GeneralizedAlpha
from cmbot.elastic.modes import arm_modes
from cmbot.identification import estimate, measured_arm, read_measurements, remarks, stiffness_text
from cmbot.identification.records import read_record, ring_down
from cmbot.planning import robot_of
from cmbot.scene import load_scene
from cmbot.trajectory import QuinticTrajectory

STEP = 1 / 400


def oscillations(
    modes: list[tuple[float, float, list[float]]], noise: float, rng: np.random.Generator
) -> np.ndarray:
    """A tap after 0.3 s, then damped oscillations: frequency, ratio and amplitudes of each."""
    t = np.arange(0, 4, STEP)
    a = np.zeros((120 + len(t), len(modes[0][2])))
    for f, ratio, size in modes:
        w = 2 * np.pi * f
        a[120:] += np.outer(np.exp(-ratio * w * t) * np.cos(w * np.sqrt(1 - ratio**2) * t), size)
    return a + noise * rng.normal(size=a.shape)


def test_frequencies_and_damping_of_a_sum_of_oscillations(rng: np.random.Generator) -> None:
    modes = [(3.2, 0.02, [1.0, 0.2, 0.1]), (5.0, 0.01, [0.1, 0.9, 0.3]), (11.5, 0.015, [0.3, 0.1, 0.5])]
    found = ring_down(STEP, oscillations(modes, 0.01, rng) + 9.81)
    np.testing.assert_allclose(found.frequencies, [3.2, 5.0, 11.5], rtol=3e-3)
    np.testing.assert_allclose(found.damping, [0.02, 0.01, 0.015], atol=3e-3)
    assert (found.shares < 0.005).all()


@pytest.mark.slow
@pytest.mark.parametrize("colour", [0.0, 0.5])
def test_damping_is_as_exact_as_it_says(colour: float, rng: np.random.Generator) -> None:
    """Of 60 records the truth is within two standard deviations in about 95 %, as of frequencies."""
    ratios, frequencies, cosines = list[float](), list[float](), list[float]()
    for _ in range(60):
        number = rng.integers(1, 4)
        each = zip(np.cumsum(rng.uniform(2, 5, number)), rng.uniform(0.005, 0.04, number), strict=True)
        modes = [(f, ratio, rng.normal(size=3).tolist()) for f, ratio in each]
        a = oscillations(modes, 0.0, rng)
        noise = lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], rng.normal(size=a.shape), axis=0)
        found = ring_down(STEP, a + 10 ** rng.uniform(-2.3, -1) * noise)
        for f, ratio, size in modes:
            near = np.abs(found.frequencies / f - 1)
            if near.min(initial=np.inf) < 0.05:
                k = near.argmin()
                ratios.append((found.damping[k] - ratio) / found.damping_deviations[k])
                frequencies.append((found.frequencies[k] / f - 1) / found.shares[k])
                cosines.append(abs(found.directions[k] @ size) / np.linalg.norm(size))
    assert len(ratios) > 100
    for away in (ratios, frequencies):
        assert 0.92 < np.mean(np.abs(away) < 2) < 0.99
    assert min(cosines) > np.cos(np.radians(8))


def test_noise_has_no_modes(rng: np.random.Generator) -> None:
    assert len(ring_down(STEP, rng.normal(size=(1600, 3))).frequencies) == 0
    assert len(ring_down(STEP, np.zeros((70, 1))).frequencies) == 0


@pytest.mark.slow
def test_noise_is_told_from_decays(rng: np.random.Generator) -> None:
    """Of 100 records of noise at most one passes; all decays that begin at ten times the noise do."""
    passed = sum(
        len(ring_down(1 / 200, 0.02 * rng.normal(size=(2400, 3))).frequencies) > 0 for _ in range(100)
    )
    assert passed <= 1
    for f in (1.5, 4.0, 12.0, 25.0):
        for ratio in (0.005, 0.02, 0.05):
            found = ring_down(STEP, oscillations([(f, ratio, [1.0, 0.4, 0.3])], 0.1, rng))
            assert np.abs(found.frequencies / f - 1).min(initial=np.inf) < 0.02, (f, ratio)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [0.9, 0.99])
def test_coloured_noise_after_a_knock_has_no_modes(colour: float, rng: np.random.Generator) -> None:
    """Nor has a hum, at a frequency of the arm or above."""
    passed = 0
    for _ in range(40):
        a = lfilter([1.0], [1.0, -colour], rng.normal(size=(2400, 2)), axis=0)
        a[400:404] += 20 * a.std() * np.array([0.5, 1, -1, -0.5])[:, None]
        passed += len(ring_down(STEP, a).frequencies) > 0
    assert passed <= 1


@pytest.mark.parametrize("hum", [25.0, 50.0])
@pytest.mark.parametrize(("f", "ratio"), [(3.0, 0.01), (20.0, 0.1)])
def test_a_hum_is_no_mode_and_hides_none(
    f: float, ratio: float, hum: float, rng: np.random.Generator
) -> None:
    t, tap = STEP * np.arange(2400), 400
    a = (np.sin(2 * np.pi * hum * t) + 0.1 * rng.normal(size=len(t)))[:, None]
    knock = np.zeros_like(a)
    knock[tap : tap + 4, 0] = [5, 10, -10, -5]
    assert not len(ring_down(STEP, a + knock).frequencies)
    after = t[tap:] - t[tap]
    decay = np.zeros_like(a)
    decay[tap:, 0] = 3 * np.exp(-2 * np.pi * f * ratio * after) * np.sin(2 * np.pi * f * after)
    found = ring_down(STEP, a + knock + decay)
    np.testing.assert_allclose(found.frequencies, [f], rtol=0.02)
    np.testing.assert_allclose(found.damping, [ratio], rtol=0.3)


def write(path: Path, a: np.ndarray, step: float = STEP) -> Path:
    rows = np.column_stack([step * np.arange(len(a)), a])
    np.savetxt(path, rows, delimiter=",", header="t,ax,ay,az", comments="", fmt="%.9g")
    return path


@pytest.mark.parametrize("columns", [slice(0, 3), slice(1, 2)])
def test_a_record_as_klipper_writes_it(tmp_path: Path, rng: np.random.Generator, columns: slice) -> None:
    """A heading of its own, times of the printer's clock, six digits; 3200 samples a second of an ADXL345."""
    t = 8391.25 + np.arange(12_800) / 3200.0
    w = 2 * np.pi * 7.5
    a = np.where(t > 8391.5, np.exp(-0.02 * w * (t - 8391.5)) * np.cos(w * (t - 8391.5)), 0.0)
    a = 9000.0 * np.outer(a, [0.2, 1.0, 0.4])[:, columns] + 20.0 * rng.normal(size=(len(t), 3))[:, columns]
    names = ",".join(f"accel_{axis}" for axis in "xyz"[columns])
    lines = [f"#time,{names}"] + [",".join(f"{x:.6f}" for x in row) for row in np.column_stack([t, a])]
    path = tmp_path / "raw_data.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    found = read_record(path)
    np.testing.assert_allclose(found.frequencies, [7.5], rtol=3e-3)
    np.testing.assert_allclose(found.damping, [0.02], atol=3e-3)


def test_the_arm_after_a_tap(tmp_path: Path, rng: np.random.Generator) -> None:
    """Simulated by the elastic model; its modes are known."""
    scene = short_scene()
    arm, q = measured_arm(scene), np.array(scene.posture)
    modes = arm_modes(arm, q)
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    at = arm.configuration(q, modes.u)
    J = pin.computeFrameJacobian(arm.model, arm.model.createData(), at, arm.tool_frame_id, world)
    start = np.linalg.solve(modes.mass, J[:3, arm.elastic].T @ [3.0, -2.0, 4.0])
    system = ElasticSystem.of(arm, modes.damping(0.015))
    tapped = GeneralizedAlpha(system, step=0.002, rho_inf=0.95, corrections=1)
    motion = tapped.run([QuinticTrajectory.held(q, 3.0)], modes.u, start)
    a = motion.a @ J[:3, arm.elastic].T
    a = np.concatenate([np.zeros((150, 3)), a])
    path = write(tmp_path / "tap.csv", a + 0.005 * np.abs(a).max() * rng.normal(size=a.shape), 0.002)
    found = read_record(path)
    away = np.abs(np.log(found.frequencies[:, None] / modes.frequencies)).min(axis=1)
    assert len(found.frequencies) >= 3
    assert away.max() < 0.04
    assert np.median(away) < 0.005
    assert np.median(found.damping) == pytest.approx(0.015, abs=0.005)
    row = {"posture": q.tolist(), "record": "tap.csv"}
    content = {"format": "cmbot-measurements/1", "scene": "triangle", "measurements": [row]}
    (tmp_path / "m.yaml").write_text(json.dumps(content), encoding="utf-8")
    identified = estimate(read_measurements(tmp_path / "m.yaml"), arm)
    # What was tapped is as modelled.
    assert np.abs(identified.mean / identified.prior).max() < 1.0
    assert all(part.probability > 0.01 for part in identified.parts)
    assert any("Damping of the modes in the records: 1." in line for line in remarks(identified))
    # What sways in a scene with the file of it is damped so.
    (tmp_path / "s.yaml").write_text(stiffness_text(identified.stiffness, "tap.csv"), encoding="utf-8")
    named = short_scene(robot={"joints": "elastic"}).as_data() | {
        "identified": str(tmp_path / "s.yaml"),
        "name": "tapped",
    }
    robot = robot_of(load_scene(named))
    assert robot.damping_ratio == pytest.approx(np.median(found.damping), abs=1e-6)
    damping = identified.stiffness.damping
    assert damping is not None
    assert damping.sd >= np.std(found.damping) - 1e-6


def test_a_record_without_a_decay_is_named(tmp_path: Path, rng: np.random.Generator) -> None:
    """The reason is told, though the sheet names the file: it says nothing of what is in it."""
    write(tmp_path / "noise.csv", 0.02 * rng.normal(size=(2400, 3)), 1 / 200)
    row = {"posture": list(short_scene().posture), "record": "noise.csv"}
    content = {"format": "cmbot-measurements/1", "scene": "triangle", "measurements": [row]}
    told = refusal("identify", write_scene(tmp_path / "m.yaml", content))
    assert "noise.csv: got a record with no decay that stands out of its noise, expected a tap" in told
    assert not (tmp_path / "m.stiffness.yaml").exists()


@pytest.mark.parametrize("form", ["phyphox", "milliseconds", "uneven"])
def test_a_record_as_phones_and_loggers_write_it(form: str, tmp_path: Path, rng: np.random.Generator) -> None:
    """The same decay with other headings, decimal marks, units of time and uneven steps."""
    modes = [(1.1, 0.02, [0.05, 0.01, 0.02]), (7.5, 0.01, [0.3, 1.0, 0.4])]
    a = oscillations(modes, 1e-3, rng)
    t = STEP * np.arange(len(a))
    path = tmp_path / "record.csv"
    if form == "phyphox":
        heading = '"Time (s)";' + ";".join(f'"Linear Acceleration {axis} (m/s^2)"' for axis in "xyz")
        rows = [";".join(f"{x:.9e}".replace(".", ",") for x in row) for row in np.column_stack([t, a])]
    else:
        if form == "uneven":
            t[1:-1] += rng.uniform(-0.04, 0.04, len(t) - 2) * STEP
        heading = "# logger 7\ntimestamp\tx\ty\tz"
        scaled = 1e3 * t if form == "milliseconds" else t
        rows = ["\t".join(map(repr, row)) for row in np.column_stack([scaled, a]).tolist()]
    path.write_text("\n".join([heading, *rows]), encoding="utf-8")
    found = read_record(path)
    np.testing.assert_allclose(found.frequencies, [1.1, 7.5], rtol=1e-2)
    away = np.abs(found.damping - [0.02, 0.01])
    assert (away < 3 * found.damping_deviations + 2e-3).all()
    assert (found.damping_deviations < 5e-3).all()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,b\n0,1\n", "line 1: got t,b, expected a column t and one or all of ax, ay, az"),
        (
            "freq,psd_x,psd_y,psd_z,psd_xyz\n1,1,1,1,3\n",
            "line 1: got freq,psd_x and more, expected the raw record",
        ),
        ("t,ax\n" + 70 * "0,one\n", "line 2, ax: got 'one', expected a finite number"),
        ("t,ax\n0,1\n1,2\n", "got 2 rows, expected 64 or more rows"),
        (
            "t,ax\n" + "".join(f"{k**2},{k % 2}\n" for k in range(70)),
            "line 3: got 1 ms after the row before, expected steps of 69 ms, give or take 10 %",
        ),
        (
            "t,ax\n" + "".join(f"{k / 100},{min(k % 20, 9)}\n" for k in range(70)),
            "ax: got 11 rows one after the other at 9, its largest value",
        ),
        (
            "t,ax\n" + "".join(f"{k / 100},0\n" for k in range(70)),
            "got a record with no decay that stands out of its noise, expected a tap, then for",
        ),
        (
            "t,ax\n" + "".join(f"{k / 25},{k % 3}\n" for k in range(70)),
            "got 25 samples a second, in which fast modes look like slow ones, expected at least 80",
        ),
    ],
)
def test_a_record_that_is_none_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "tap.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_record(path)
    assert message in str(refused.value)


def test_a_spectrum_that_a_sheet_names_is_called_one(tmp_path: Path) -> None:
    (tmp_path / "psd.csv").write_text("freq,psd_x,mzv\n5,1,0\n", encoding="utf-8")
    row = {"posture_deg": [0, -90, 90, 0, 45, 45, 0], "record": "psd.csv"}
    sheet = {"format": "cmbot-measurements/1", "scene": "triangle", "measurements": [row]}
    with pytest.raises(InputError, match="the raw record of which this is the spectrum"):
        read_measurements(write_scene(tmp_path / "sheet.yaml", sheet))


SECRETS = (
    "12345",
    "password: 12345\n",
    "- 12345\n",
    "12345,t\n1,2\n",
    "t,ax\n12345,root\n",
    "format: 12345\n",
)


@pytest.mark.parametrize("secret", SECRETS)
def test_files_that_a_sheet_names_are_not_quoted(secret: str, tmp_path: Path) -> None:
    """A stranger's sheet may name any file: an error tells nothing of what is in one that is no scene."""
    (tmp_path / "secret").write_text(secret, encoding="utf-8")
    row = {"posture_deg": [0, -90, 90, 0, 45, 45, 0], "record": "secret"}
    sheet = {"format": "cmbot-measurements/1", "scene": "triangle", "measurements": [row]}
    for changes in ({}, {"scene": "secret"}):
        with pytest.raises(InputError) as refused:
            read_measurements(write_scene(tmp_path / "sheet.yaml", sheet | changes))
        assert "secret" in str(refused.value)
        assert "12345" not in str(refused.value)
