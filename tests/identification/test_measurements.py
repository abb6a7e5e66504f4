"""Files of measurements: what they say, and what is refused."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cmbot.common.errors import InputError
from cmbot.identification import read_measurements

POSTURE = [-10, -90, 90, 0, 10, 50, 0]
ONE = {"posture_deg": POSTURE, "deflection_mm": [0.4, -0.1, -3.9]}


def content(**changes: Any) -> dict[str, Any]:
    return {"format": "cmbot-measurements/1", "scene": "triangle", "measurements": [ONE], **changes}


def test_a_file_is_read_in_si(tmp_path: Path) -> None:
    second = {
        "posture": np.radians(POSTURE).tolist(),
        "deflection_mm": {"z": -5},
        "frequencies_hz": [6, 7],
    }
    path = tmp_path / "measured.yaml"
    path.write_text(json.dumps(content(measurements=[ONE, second], job=[[0.0] * 7])), encoding="utf-8")
    found = read_measurements(path)
    np.testing.assert_allclose(found.q, np.radians([POSTURE, POSTURE]))
    np.testing.assert_allclose(found.deflection[0], [0.0004, -0.0001, -0.0039])
    np.testing.assert_array_equal(np.isnan(found.deflection[1]), [True, True, False])
    assert [len(each.frequencies) for each in found.modes] == [0, 2]
    assert found.scene.name == "triangle"
    assert found.job is not None
    assert found.setup.weight_kg == 5.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"measurements": [{**ONE, "posture": POSTURE}]},
            "measurements[0]: got both, expected either posture_deg",
        ),
        (
            {"measurements": [{"deflection_mm": [1, 2, 3]}]},
            "got neither, expected either posture_deg or posture",
        ),
        ({"measurements": [{"posture_deg": POSTURE}]}, "measurements: got none, expected a measured number"),
        (
            {"measurements": [{"posture_deg": POSTURE, "frequencies_hz": [7, 6]}]},
            "frequencies_hz: got (7.0, 6.0), expected the slowest first",
        ),
        (
            {"measurements": [{"posture_deg": POSTURE, "frequencies_hz": [6], "record": "tap.csv"}]},
            "frequencies_hz: got both, expected no such key beside record",
        ),
        (
            {"measurements": [{"posture_deg": POSTURE, "record": "none.csv"}]},
            "measurements[0].record: got none.csv, expected a file that exists",
        ),
        (
            {"measurements": [{"posture_deg": [1, 2], "deflection_mm": [1, 2, 3]}]},
            "measurements[0].posture_deg: got 2 numbers, expected 7, one for each joint of the robot",
        ),
        (
            {"measurements": [{"posture_deg": POSTURE, "deflection_mm": {"z": -5, "w": 1}}]},
            "measurements[0].deflection_mm: got w, expected x, y or z",
        ),
        (
            {"measurements": [{"posture_deg": POSTURE, "deflection_mm": [1, 2]}]},
            "measurements[0].deflection_mm: got",
        ),
        ({"job": [[0.0]]}, "job[0]: got 1 numbers, expected 7"),
        ({"weight_kg": 0}, "weight_kg: got 0, expected more than 0"),
        ({"gauge_sd_mm": 0}, "gauge_sd_mm: got 0, expected at least 1e-06"),
        ({"wieght_kg": 5}, "did you mean weight_kg?"),
        ({"scene": "nosuch.yaml"}, "nosuch.yaml: no such file"),
    ],
)
def test_what_is_wrong_is_refused_by_its_key(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        read_measurements(content(**changes))
    assert message in str(refused.value)


IN_RANGE = np.array([0.5, 0.4, -0.5, -0.8, 0.3, 1.6, 0.2])


@pytest.mark.parametrize(
    ("key", "posture", "advice"),
    [
        ("posture_deg", IN_RANGE, "; radians? name them posture, in a table "),
        ("posture", np.degrees(IN_RANGE), "; degrees? name them posture_deg, in a table "),
        ("posture", [*np.degrees(IN_RANGE[:-1]), 999.0], ""),
        ("posture_deg", [0.5, 0.4, -0.5, 12.0, 0.3, 1.6, 0.2], ""),
        ("posture", [0.01, 0.01, -0.01, -0.01, 0.01, 0.03, 0.0], ""),
    ],
)
def test_the_other_unit_is_asked_for_where_it_fits_the_ranges(
    key: str, posture: Sequence[float], advice: str
) -> None:
    """The fourth joint of a Panda cannot be straight: radians are recognised under the name of degrees."""
    one = {key: list(posture), "deflection_mm": [1, 2, 3]}
    with pytest.raises(InputError) as refused:
        read_measurements(content(scene="panda_sanding", measurements=[one]))
    assert refused.value.key == f"measurements[0].{key}"
    assert "the joint's range, " in refused.value.expected
    assert advice in refused.value.expected
    assert bool(advice) == ("?" in refused.value.expected)
