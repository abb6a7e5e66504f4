"""Plan directories read back: the same plan, and on request certified again."""

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from plan_folders import FILES, same_arrays, with_baseline

from cmbot.archive import load_plan, save
from cmbot.common.errors import PathNotFound
from cmbot.planning import Job, Plan
from cmbot.planning.certification.metrics import figures


@pytest.fixture(scope="module")
def loaded(saved_triangle: Path) -> Plan:
    return load_plan(saved_triangle)


def test_round_trip(loaded, triangle_plan):
    plan = loaded
    same_arrays(plan.trajectory, triangle_plan.trajectory)
    for name in ("t", "q", "v", "a", "j"):
        got, expected = getattr(plan.baseline.samples, name), getattr(triangle_plan.baseline.samples, name)
        exact = name in "tq"
        np.testing.assert_allclose(got, expected, 0 if exact else 1e-11, 0 if exact else 1e-12, err_msg=name)
    ours, theirs = plan.baseline, triangle_plan.baseline
    for field in fields(ours.samples):
        got, expected = getattr(ours.samples, field.name), getattr(theirs.samples, field.name)
        if expected is None:
            assert got is None
            continue
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9, err_msg=field.name)
    for name in ("figures", "drift", "smallest_singular_value"):
        assert getattr(ours, name) == getattr(theirs, name), name
    same = ("options", "certificate", "passes")
    for name in (*same, "choice", "gap_to_floor", "objective", "seconds"):
        assert getattr(plan, name) == getattr(triangle_plan, name), name
    assert plan.scene.content_hash == triangle_plan.scene.content_hash
    assert plan.scene == triangle_plan.scene
    assert plan.robot.content_hash == triangle_plan.robot.content_hash
    assert plan.task.keep == triangle_plan.task.keep
    np.testing.assert_array_equal(plan.task.path.corners, triangle_plan.task.path.corners)
    np.testing.assert_allclose(plan.start.posture, triangle_plan.start.posture, rtol=1e-15)
    assert plan.start.moved == pytest.approx(triangle_plan.start.moved, rel=1e-15)
    assert plan.start.failures == ()
    same_arrays(plan.lower_bound, triangle_plan.lower_bound)
    assert plan.summary() == triangle_plan.summary()
    again = figures(plan.robot, plan.baseline.samples)
    assert again.peak_guardrail_torque == pytest.approx(plan.baseline.figures.peak_guardrail_torque)
    assert again.limit_use.jerk == pytest.approx(plan.baseline.figures.limit_use.jerk)
    same_arrays(plan.samples, triangle_plan.samples)
    got, expected = loaded.approach, triangle_plan.approach
    same_arrays(got.trajectory, expected.trajectory)
    assert got.certificate == expected.certificate
    assert got.along_self_motion is expected.along_self_motion
    assert got.task.keep == expected.task.keep
    times = np.linspace(0, expected.task.path.duration, 101)
    np.testing.assert_array_equal(got.task.path.position(times), expected.task.path.position(times))
    same_arrays(got.task.path, expected.task.path)


def test_saved_again_it_is_the_same(saved_triangle, loaded, tmp_path):
    again = save(loaded, tmp_path / "again")
    for name in FILES - {"plan.json", "baseline.csv"}:
        assert (again / name).read_bytes() == (saved_triangle / name).read_bytes()
    first, second = (json.loads((path / "plan.json").read_text()) for path in (saved_triangle, again))
    # Angles in degrees, and what is measured again, may differ in their last digits.
    changing = {"start", "files", "content"}
    assert {key: first[key] for key in first.keys() - changing} == {
        key: second[key] for key in second.keys() - changing
    }


def test_round_trip_with_fixed_knots(short_plan, tmp_path):
    folder = save(short_plan, tmp_path / "plan")
    data = json.loads((folder / "plan.json").read_text())
    for key in ("torque_floor", "gap_to_floor", "floor", "choice"):
        assert data[key] is None
    assert {path.name for path in folder.iterdir()} == FILES
    assert set(data["files"]) == FILES - {"plan.json"}
    read = load_plan(folder, verify=True)
    assert (read.lower_bound, read.choice, read.approach, read.gap_to_floor) == (None, None, None, None)
    same_arrays(read.trajectory, short_plan.trajectory)
    assert read.baseline.figures == short_plan.baseline.figures
    assert read.start.moved == 0


def test_a_start_elsewhere_is_kept(returning_plan, tmp_path):
    failures = (
        PathNotFound(
            "in the way", time=1.5, progress=0.25, smallest_singular_value=0.3, pair=("link", "slab")
        ),
        PathNotFound("out of reach", time=0.5, progress=0.125, smallest_singular_value=0.1),
    )
    start = replace(returning_plan.start, failures=failures)
    assert start.moved > 0
    read = load_plan(save(replace(returning_plan, start=start), tmp_path / "plan")).start
    np.testing.assert_allclose(read.posture, start.posture, rtol=1e-15)
    assert read.moved == pytest.approx(start.moved, rel=1e-15)
    for got, expected in zip(read.failures, failures, strict=True):
        assert vars(got) == vars(expected)
        assert str(got) == str(expected)


def without_obstacles(certificate):
    checks = tuple(
        replace(check, value=math.inf) if check.quantity.startswith("clearance") else check
        for check in certificate.checks
    )
    free = replace(certificate.figures, min_clearance=math.inf)
    return replace(certificate, checks=checks, figures=free, clearance_bound=math.inf)


def test_without_anything_to_hit_clearances_are_infinite(thin_plan, tmp_path):
    certificate = without_obstacles(thin_plan.certificate)
    approach = replace(thin_plan.approach, certificate=without_obstacles(thin_plan.approach.certificate))
    work = replace(thin_plan.job.strokes[0], certificate=certificate)
    plan = replace(thin_plan, job=Job(segments=(approach, work)))
    baseline = thin_plan.baseline
    plan = with_baseline(
        plan,
        samples=replace(baseline.samples, clearance=np.full(len(baseline.samples.t), np.inf)),
        figures=replace(baseline.figures, min_clearance=math.inf),
    )
    read = load_plan(save(plan, tmp_path / "plan"))
    assert read.certificate == certificate
    assert read.approach.certificate == approach.certificate
    assert read.baseline.figures.min_clearance == math.inf
    text = (tmp_path / "plan" / "plan.json").read_text()
    assert "Infinity" not in text
    assert (tmp_path / "plan" / "baseline.csv").read_text().splitlines()[1].endswith(",inf")


def test_verify_certifies_again(saved_triangle, triangle_plan):
    plan = load_plan(saved_triangle, verify=True)
    for again, made in (
        (plan.certificate, triangle_plan.certificate),
        (plan.approach.certificate, triangle_plan.approach.certificate),
    ):
        assert again.clearance_bound == pytest.approx(made.clearance_bound, rel=1e-9)
        # Beyond the plan's own checks there are those of a second computation.
        own = again.checks[: len(made.checks)]
        assert sum("second computation" in check.quantity for check in again.checks[len(own) :]) > 5
        for got, expected in zip(own, made.checks, strict=True):
            assert got.quantity == expected.quantity
            assert got.value == pytest.approx(expected.value, rel=1e-9, abs=1e-12)
