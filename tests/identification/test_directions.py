"""Records on a round mast, whose modes are near each other: the direction of the swing tells them apart."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from small_scenes import short_scene

from cmbot.common.arrays import FloatArray
from cmbot.elastic.arm import ElasticArm
from cmbot.elastic.modes import arm_modes
from cmbot.identification import (
    Identification,
    Measurements,
    MeasuringSetup,
    estimate,
    identified_rows,
    measured_arm,
    mode_rows,
    remarks,
)
from cmbot.identification.records import RingDown
from cmbot.scene import Scene

LENGTH_M, BENDING_NM2 = 3.0, 6e4
TRUE_X, TRUE_Y = 1.4, 0.85
NOISE_SHARE = 0.003


def on_a_mast(along_x: float, along_y: float) -> Scene:
    """The shipped arm on a mast along z that is so many times as stiff against forces along x and along y."""
    K = np.diag([0.0, 0.0, 1e8, 0.0, 0.0, BENDING_NM2])
    for way, turn, sign, factor in ((0, 4, -1, along_x), (1, 3, 1, along_y)):
        EI = factor * BENDING_NM2
        K[way, way], K[turn, turn] = 12 * EI / LENGTH_M**3, 4 * EI / LENGTH_M
        K[way, turn] = K[turn, way] = sign * 6 * EI / LENGTH_M**2
    base = {"bays": 0, "stiffness": K.tolist(), "mass": np.diag([30.0, 30, 30, 1, 1, 1]).tolist()}
    return short_scene(guardrail=base, robot={"joints": "elastic"})


@pytest.fixture(scope="module")
def truth() -> ElasticArm:
    return measured_arm(on_a_mast(TRUE_X, TRUE_Y))


@pytest.fixture(scope="module")
def modelled() -> ElasticArm:
    return measured_arm(on_a_mast(1.0, 1.0))


def rung(
    arm: ElasticArm, q: FloatArray, which: list[int], axes: str | None, rng: np.random.Generator
) -> RingDown:
    """What a record of some modes tells, along the axes of W or of the tool."""
    modes = arm_modes(arm, q)
    X_WT, J = arm.tool_jacobian(arm.configuration(q, modes.u), arm.model.createData())
    ways = J[:3, arm.elastic] @ modes.shapes[:, which]
    if axes == "tool":
        ways = X_WT.rotation.T @ ways
    exact = RingDown.at(modes.frequencies[which] * np.exp(NOISE_SHARE * rng.normal(size=len(which))))
    directions = (ways / np.linalg.norm(ways, axis=0)).T + 0.03 * rng.normal(size=(len(which), 3))
    return replace(exact, directions=directions)


def identified(
    truth: ElasticArm, modelled: ElasticArm, which: list[int], axes: Literal["W", "tool"] | None
) -> Identification:
    scene, rng = on_a_mast(1.0, 1.0), np.random.default_rng(1)
    q = np.array([scene.posture])
    setup = MeasuringSetup(record_axes=axes, frequency_sd_share=NOISE_SHARE)
    measured = Measurements(
        source="taps",
        scene=scene,
        setup=setup,
        q=q,
        deflection=np.full((1, 3), np.nan),
        job=None,
        modes=(rung(truth, q[0], which, axes, rng),),
    )
    return estimate(measured, modelled)


def base(found: Identification) -> dict[str, tuple[float, float, float]]:
    """Factor and standard deviation of the base along x and y, and the latter before."""
    rows = {row[0][5:12]: row for row in identified_rows(found) if row[0].startswith("base along")}
    return {name[-1]: (float(row[3]), float(row[4]) / 100, float(row[5]) / 100) for name, row in rows.items()}


@pytest.mark.parametrize("axes", ["W", "tool"])
def test_directions_give_each_ring_to_its_axis(
    truth: ElasticArm, modelled: ElasticArm, axes: Literal["W", "tool"]
) -> None:
    """The mast is stiffer along x than modelled and softer along y: its slower mode is the other one."""
    x, y = (base(identified(truth, modelled, [0, 1], axes))[axis] for axis in "xy")
    for (factor, deviation, _), true in ((x, TRUE_X), (y, TRUE_Y)):
        assert deviation < 0.16
        assert abs(np.log(factor / true)) < 2 * deviation
    for which, seen, other in (([0], "y", "x"), ([1], "x", "y")):
        found = identified(truth, modelled, which, axes)
        told = base(found)
        assert told[seen][1] < 0.55 * told[seen][2]
        assert told[other][1] > 0.95 * told[other][2]
        assert all(match.told_apart for match in found.matched)


def test_without_the_sensors_axes_near_modes_are_not_told_apart(
    truth: ElasticArm, modelled: ElasticArm
) -> None:
    for which in ([0], [1], [0, 1]):
        found = identified(truth, modelled, which, None)
        for axis, true in (("x", TRUE_X), ("y", TRUE_Y)):
            factor, deviation, _ = base(found)[axis]
            assert abs(np.log(factor / true)) < 2 * deviation
        assert not any(match.told_apart for match in found.matched)
        told = " ".join(remarks(found))
        assert "taps: measurements[0]: 1.3" in told or "taps: measurements[0]: 1.6" in told
        assert "not told apart, it counts for their mean. record_axes (tool or W)" in told
        for row, match in zip(mode_rows(found), found.matched, strict=True):
            assert row[:2] == ("taps: measurements[0]", f"{match.frequency:.4g}")
            assert " or " in row[-1]
            assert sum(match.probabilities) == pytest.approx(1.0)
