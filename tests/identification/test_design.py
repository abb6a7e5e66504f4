"""The design: better than chance, and the postures can be taken."""

import itertools
from collections.abc import Sequence

import identification as benchmark
import numpy as np
import pytest
from small_scenes import short_scene, strokes_scene, tool_points

from cmbot.collision import Clearances
from cmbot.common.errors import InputError
from cmbot.identification import (
    DeflectionModel,
    MeasuringSetup,
    Proposal,
    design,
    estimate,
    job_postures,
    measured_arm,
    prior_deviations,
    proposal_remarks,
    propose,
    read_measurements,
)
from cmbot.planning import Plan, robot_of
from cmbot.robot import Dynamics

SCENE = short_scene()


@pytest.fixture(autouse=True)
def _few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design, "_MAX_CANDIDATES", 60)
    monkeypatch.setattr(design, "_REFINED", (0.3,))
    monkeypatch.setattr(design, "_POSTURES_AROUND", 4)


@pytest.fixture
def proposal(triangle_plan: Plan) -> Proposal:
    return propose(SCENE, 4, job_postures(triangle_plan))


def test_postures_are_clear_and_can_be_held(proposal: Proposal) -> None:
    assert proposal.q.shape == (4, 7)
    assert (
        Clearances(measured_arm(SCENE).robot, SCENE.all_obstacles).query(proposal.q).distance >= 0.02
    ).all()
    loaded = measured_arm(SCENE, 5.0).robot
    torque = Dynamics(loaded).static_efforts(proposal.q).joint_torque
    assert (np.abs(torque) <= loaded.limits.torque).all()
    assert loaded.payload == 5.0


def test_it_tells_more_than_chance(proposal: Proposal) -> None:
    arm, setup = measured_arm(SCENE), MeasuringSetup()
    rng = np.random.default_rng(0)
    posture_design = design._PostureDesign(SCENE, setup, np.ones(3, dtype=bool), proposal.job, None)
    q = posture_design.clear(posture_design.random(rng))[:24]
    G = posture_design.rows(q)
    shares = [
        np.trace(posture_design.W @ design._covariance(G, list(range(k, k + 4)))) ** 0.5
        for k in range(0, 24, 4)
    ]
    assert proposal.after.share < min(shares)
    assert proposal.after.share < 0.5 * proposal.before.share
    # The promise is the covariance of the linearised problem there.
    own = posture_design.rows(proposal.q)
    assert np.trace(posture_design.W @ design._covariance(own, [0, 1, 2, 3])) ** 0.5 == pytest.approx(
        proposal.after.share
    )
    prior = prior_deviations(DeflectionModel(arm, setup, q[:1]).parameters, setup.prior)
    assert prior.shape == (32,)


def test_fewer_components_tell_less_and_more_postures_more(proposal: Proposal) -> None:
    job = proposal.job
    only_z, more = propose(SCENE, 4, job, axes="z"), propose(SCENE, 8, job)
    assert more.after.share < proposal.after.share < only_z.after.share
    assert list(only_z.seen) == [False, False, True]
    assert any(" z to 0.1 mm" in line for line in proposal_remarks(only_z))
    assert only_z.sheet("triangle").count("deflection_mm: {z: null}  # about -") == 4


def test_a_tour_is_short() -> None:
    """With few postures, no order is shorter; postures on a line are visited along it."""
    rng = np.random.default_rng(0)
    q, start, speeds = rng.uniform(-1, 1, (6, 3)), np.zeros(3), np.array([1.0, 2.0, 0.5])

    def seconds(order: Sequence[int]) -> float:
        way = np.vstack([start, q[list(order)]])
        return float((np.abs(np.diff(way, axis=0)) / speeds).max(axis=1).sum())

    order = design._tour(start, q, speeds)
    assert sorted(order) == list(range(6))
    assert seconds(order) <= 1.1 * min(map(seconds, itertools.permutations(range(6))))
    line = np.array([0.7, 0.1, 0.9, 0.3, 0.5])[:, None] * np.ones(3)
    assert design._tour(start, line, speeds) == [1, 3, 4, 0, 2]


def test_more_postures_beside_those_measured(proposal: Proposal) -> None:
    arm, rng = measured_arm(SCENE), np.random.default_rng(1)
    truth = benchmark.drawn(arm, proposal.setup, rng)
    known = estimate(benchmark.simulated(proposal, truth, truth.arm(arm), rng), arm)
    assert known.after is not None
    more = propose(SCENE, 2, proposal.job, proposal.setup, known=known)
    assert more.before.share == pytest.approx(known.after.share, rel=1e-6)
    assert more.after.share < 0.95 * more.before.share
    assert any("as 4 postures told" in line for line in proposal_remarks(more))
    # The promise is what the estimate from both says, as far as that stays where it is.
    truth_there = benchmark.simulated(more, truth, truth.arm(arm), rng)
    both = estimate([*known.measurements, truth_there], arm)
    assert both.after is not None
    assert both.after.share == pytest.approx(more.after.share, rel=0.25)
    other = MeasuringSetup(weight_kg=3.0)
    assert propose(SCENE, 2, proposal.job, other, known=known).after.share < more.before.share


def test_the_sheet_is_a_file_of_measurements_once_it_is_filled_in(
    proposal: Proposal, tmp_path: object
) -> None:
    sheet = proposal.sheet("triangle")
    path = tmp_path / "sheet.yaml"  # type: ignore[operator]
    path.write_text(sheet, encoding="utf-8")
    with pytest.raises(InputError, match="measurements: got none, expected a measured number"):
        read_measurements(path)
    path.write_text(sheet.replace("[null, null, null]", "[1.0, null, -2.0]"), encoding="utf-8")
    found = read_measurements(path)
    np.testing.assert_allclose(found.q, proposal.q, atol=1e-4)
    np.testing.assert_allclose(found.job, proposal.job, atol=1e-5)
    assert found.setup.model_dump(include=set(MeasuringSetup.model_fields)) == proposal.setup.model_dump()


def test_the_postures_of_a_scene_follow_its_path() -> None:
    q = job_postures(SCENE)
    np.testing.assert_allclose(q[0], SCENE.posture, atol=1e-9)
    assert q.shape == (25, 7)


def test_a_job_has_postures_of_all_its_strokes() -> None:
    scene = strokes_scene()
    q = job_postures(scene)
    tool = tool_points(robot_of(scene), q)
    # There by 0.1 m, and back beside it.
    assert np.ptp(tool[:12, 1]) == pytest.approx(0.1, abs=0.02)
    assert np.ptp(tool[14:, 1]) == pytest.approx(0.1, abs=0.02)


def test_a_path_that_cannot_be_followed_says_what_can_be_done_instead() -> None:
    far = short_scene(tool_path={"legs": [{"by": [0, -4, 0], "seconds": 4}]})
    with pytest.raises(InputError, match="expected a plan of it in its place"):
        job_postures(far)


@pytest.mark.parametrize(
    ("number", "axes", "message"),
    [
        (0, "xyz", "number: got 0, expected 1 to 60 postures"),
        (2, "xw", "axes: got 'xw', expected letters of xyz"),
        (2, "", "axes: got '', expected letters of xyz"),
    ],
)
def test_what_cannot_be_proposed_is_refused(number: int, axes: str, message: str) -> None:
    with pytest.raises(InputError, match="propose") as refused:
        propose(SCENE, number, np.zeros((1, 7)), axes=axes)
    assert message in str(refused.value)


def test_a_weight_that_nothing_can_hold_is_refused() -> None:
    with pytest.raises(InputError, match="0 clear postures, expected 2 or more"):
        propose(SCENE, 2, np.zeros((1, 7)), MeasuringSetup(weight_kg=9000.0))
