"""The estimate: as exact as it says, with truths that its parameters do not make."""

import json
from dataclasses import replace
from pathlib import Path

import identification as benchmark
import numpy as np
import pytest
from small_scenes import short_scene

import cmbot
from cmbot.common.errors import InputError, SceneError
from cmbot.elastic import elastic_base
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.modes import arm_modes
from cmbot.elastic.sag import Sag
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.identification import (
    Identification,
    Measurements,
    Proposal,
    design,
    estimate,
    identified_rows,
    measured_arm,
    propose,
    remarks,
    require_fit,
    sag_along,
    stiffness_rows,
    stiffness_text,
    unseen,
)
from cmbot.identification.problem import Label, Problem
from cmbot.identification.records import RingDown
from cmbot.planning import covariance_of, precheck_scene, robot_of
from cmbot.scene import Scene, load_scene

SCENE = short_scene(robot={"joints": "elastic"})


@pytest.fixture(scope="module")
def modelled() -> ElasticArm:
    return measured_arm(SCENE)


@pytest.fixture(scope="module")
def proposal() -> Proposal:
    """Postures from a few."""
    start = np.array(SCENE.posture)
    job = np.linspace(start, start + 0.2, 6)
    patch = pytest.MonkeyPatch()
    with patch.context() as small:
        small.setattr(design, "_MAX_CANDIDATES", 60)
        small.setattr(design, "_REFINED", ())
        return propose(SCENE, 6, job)


@pytest.fixture(scope="module")
def found(proposal: Proposal, modelled: ElasticArm) -> tuple[benchmark.Truth, ElasticArm, Identification]:
    """A truth that is softer, its arm, and what was identified of it."""
    rng = np.random.default_rng(3)
    truth = benchmark.soft(modelled, proposal.setup, rng)
    arm = truth.arm(modelled)
    return truth, arm, estimate(benchmark.simulated(proposal, truth, arm, rng), modelled)


def test_the_truth_is_within_the_intervals(proposal: Proposal) -> None:
    coverage = benchmark.run(proposal, benchmark.drawn, 4)
    # Of 4 x 32 and 4 x 18 numbers that depend on one another.
    assert 0.88 < coverage.parameters <= 1
    assert 0.8 < coverage.sag <= 1
    assert coverage.length.max() < 3 * proposal.after.length_95


def test_a_base_that_mixes_all_directions(proposal: Proposal) -> None:
    assert benchmark.run(proposal, benchmark.mixed, 2).length.max() < 2 * proposal.after.length_95


def test_sag_is_known_better_than_before(found: tuple[benchmark.Truth, ElasticArm, Identification]) -> None:
    _, arm, identified = found
    assert identified.before is not None
    assert identified.after is not None
    true = Sag(arm).at(identified.job).tool
    told = identified.stiffness.measured
    assert told is not None and told.sag_mm is not None
    assert told.sag_mm[1] == pytest.approx(1e3 * np.sqrt((true**2).sum(axis=1).mean()), rel=0.05)
    off = [np.linalg.norm(sag.tool - true, axis=1).max() for sag in (identified.before, identified.after)]
    assert off[1] < 0.1 * off[0]
    assert identified.after.share < 0.2 * identified.before.share
    assert all(part.probability > 1e-3 and part.scale == 1.0 for part in identified.parts)
    assert identified.weights[0].estimated == pytest.approx(5.0, abs=0.03)


def test_a_weight_that_is_wrong_is_in_the_errors(
    proposal: Proposal, found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    """All deflections in proportion to the weight: what is not known of it, is not known of the sag."""
    given = found[2].measurements[0]
    loose = replace(given, setup=given.setup.changed(weight_sd_kg=0.25))
    after = estimate(loose, modelled).after
    assert after is not None
    assert found[2].after is not None
    assert after.share > 3 * found[2].after.share


def test_play_in_the_joints_makes_measurements_worth_less(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    given = found[2].measurements[0]
    loose = replace(given, setup=given.setup.changed(windup_sd_arcmin=1.0))
    after = estimate(loose, modelled).after
    assert after is not None
    assert found[2].after is not None
    assert after.share > 2 * found[2].after.share


@pytest.fixture(scope="module")
def swapped(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> Identification:
    """From measurements of which two rows were exchanged."""
    given = found[2].measurements[0]
    return estimate(replace(given, deflection=given.deflection[[0, 4, 2, 3, 1, 5]]), modelled)


def test_rows_that_do_not_fit_are_named_and_refused(
    found: tuple[benchmark.Truth, ElasticArm, Identification], swapped: Identification
) -> None:
    require_fit(found[2])
    assert found[2].slips == ()
    assert {slip.label.row for slip in swapped.slips if slip.significant} == {1, 4}
    given = found[2].measurements[0]
    for slip in swapped.slips:
        # What the others tell is what was measured.
        off = slip.expected - given.deflection[slip.label.row]
        assert np.abs(off).max() < 0.2 * np.abs(given.deflection[1] - given.deflection[4]).max()
    message = (
        r"measurements\[[14]\]\.deflection_mm: got x .* nor does measurements\[[14]\]\.deflection_mm fit"
    )
    with pytest.raises(InputError, match=message):
        require_fit(swapped)
    with pytest.raises(InputError, match=r"the gauge not at robot\.tool_frame"):
        require_fit(swapped)
    assert sum("Fits the others worst" in line for line in remarks(swapped)) == 2
    assert not any("Fits" in line for line in remarks(found[2]))


def test_errors_are_as_large_as_the_measurements_scatter(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    """A gauge is three times worse than stated: about as exact as with one that is stated so."""
    given = found[2].measurements[0]
    # Of six rows one may stand out by chance; in this draw none does.
    noise = 1e-4 * np.sqrt(8) * np.random.default_rng(4).standard_normal(given.deflection.shape)
    noisy = replace(given, deflection=given.deflection + noise)
    unstated = estimate(noisy, modelled)
    part = unstated.parts[0]
    assert part.probability < 0.01
    assert part.square > 2 * part.redundancy
    stated = estimate(replace(noisy, setup=given.setup.changed(gauge_sd_mm=0.1 * part.scale)), modelled)
    np.testing.assert_allclose(unstated.covariance, stated.covariance, rtol=1e-3, atol=1e-6)
    assert stated.parts[0].square == pytest.approx(stated.parts[0].redundancy, rel=0.03)
    assert any("times worse than stated" in line for line in remarks(unstated))
    require_fit(unstated)


def test_an_arm_far_from_its_model_is_no_slip(proposal: Proposal, modelled: ElasticArm) -> None:
    rng = np.random.default_rng(2)
    truth = benchmark.soft(modelled, proposal.setup, rng)
    truth = replace(truth, factors=dict.fromkeys(truth.factors, 0.3), base=0.3 * truth.base)
    far = estimate(benchmark.simulated(proposal, truth, truth.arm(modelled), rng), modelled)
    deflections, prior = far.parts
    assert deflections.scale == 1.0 < prior.scale
    assert far.slips == ()
    require_fit(far)
    assert any("farther from its model than the prior says" in line for line in remarks(far))
    metres = replace(far.measurements[0], deflection=1e-3 * far.measurements[0].deflection)
    with pytest.raises(InputError, match=r"measurements: got .* expected .* mm"):
        require_fit(estimate(metres, modelled))


@pytest.mark.parametrize("share", [0.04, 0.1])
def test_a_base_far_from_its_model_needs_a_wider_prior(
    share: float, proposal: Proposal, modelled: ElasticArm
) -> None:
    rng = np.random.default_rng(2)
    truth = benchmark.soft(modelled, proposal.setup, rng)
    truth = replace(truth, base=share * truth.base)
    measured = benchmark.simulated(proposal, truth, truth.arm(modelled), rng)
    with pytest.raises(InputError, match=r"prior: \{base: 2\}") as refused:
        require_fit(estimate(measured, modelled))
    assert "standard deviations away" not in str(refused.value)
    wider = measured.setup.prior.changed(base=2.0)
    require_fit(estimate(replace(measured, setup=measured.setup.changed(prior=wider)), modelled))


def test_what_a_weight_does_not_tell_of_the_base_is_explained(
    found: tuple[benchmark.Truth, ElasticArm, Identification],
) -> None:
    rows = [row[0] for row in identified_rows(found[2]) if row[-1] == "not seen: no finding"]
    assert {"base along x, N/m", "base along y, N/m"} & {*rows}
    assert any("A hanging weight hardly moves a base along x, y" in line for line in remarks(found[2]))


def test_two_sheets_are_as_one(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    given = found[2].measurements[0]

    def part(rows: slice) -> Measurements:
        return replace(given, q=given.q[rows], deflection=given.deflection[rows])

    both = estimate([part(slice(0, 2)), part(slice(2, None))], modelled)
    np.testing.assert_allclose(both.mean, found[2].mean, atol=1e-5)
    np.testing.assert_allclose(both.covariance, found[2].covariance, rtol=1e-3, atol=1e-7)
    assert len(both.weights) == 1
    lighter = given.setup.changed(weight_kg=4.0)
    assert len(Problem([given, given, replace(given, setup=lighter)], modelled).weights) == 2
    wider = given.setup.changed(prior=given.setup.prior.changed(links=0.5))
    with pytest.raises(InputError, match="prior: got another prior"):
        estimate([given, replace(given, setup=wider)], modelled)
    elsewhere = SCENE.with_payload(1.0)
    with pytest.raises(InputError, match="scene: got short, expected the robot, payload and base of"):
        estimate([given, replace(given, scene=elsewhere)], modelled)


def test_deflections_that_no_arm_has_are_refused(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    given = found[2].measurements[0]
    heavy = replace(given, setup=given.setup.changed(weight_kg=9000.0))
    with pytest.raises(InputError, match="in kg, not g or N, of an arm that carries itself and 9000 kg"):
        estimate(heavy, modelled)


def test_frequencies_tell_more_and_components_left_out_less(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    _, arm, with_all = found
    given = with_all.measurements[0]
    only_z = given.deflection.copy()
    only_z[:, :2] = np.nan
    tapped = tuple(arm_modes(arm, q).frequencies[: 2 if k < 2 else 0] for k, q in enumerate(given.q))
    tapped = (np.append(tapped[0], 9e3), *tapped[1:])
    less = estimate(replace(given, deflection=only_z), modelled)
    modes = tuple(map(RingDown.at, tapped))
    more = estimate(replace(given, deflection=only_z, modes=modes), modelled)
    shares = [each.after.share for each in (with_all, less) if each.after is not None]
    assert shares[0] < shares[1]
    assert np.all(np.diag(more.covariance) <= np.diag(less.covariance) * 1.2)
    assert np.linalg.slogdet(more.covariance)[1] < np.linalg.slogdet(less.covariance)[1]
    # No mode is near: it tells nothing, and that is said.
    (far,) = (each for each in more.matched if not each.modes)
    assert (far.label, far.frequency) == (Label("frequencies_hz", 0, 0), 9e3)
    assert any("measurements[0]: 9000 Hz is left out" in line for line in remarks(more))


def test_a_tap_that_does_not_fit_is_named_with_its_row_and_frequency(
    found: tuple[benchmark.Truth, ElasticArm, Identification], modelled: ElasticArm
) -> None:
    _, arm, identified = found
    given = identified.measurements[0]
    modes = [RingDown.at(()) for _ in given.q]
    modes[2] = RingDown.at(1.2 * arm_modes(arm, given.q[2]).frequencies[:1])
    wrong = estimate(replace(given, modes=tuple(modes)), modelled)
    with pytest.raises(InputError) as refused:
        require_fit(wrong)
    assert "measurements[2]" in str(refused.value)
    assert f"{modes[2].frequencies[0]:.3g} Hz" in str(refused.value)


def test_nothing_measured_of_a_joint_keeps_its_prior(
    found: tuple[benchmark.Truth, ElasticArm, Identification],
) -> None:
    identified = found[2]
    names, directions = unseen(identified)
    # The last joint turns about the tool's own axis.
    assert "joint_7" in names
    assert 0 < directions < 21
    k = [name for _, name in identified.parameters.springs].index("joint_7")
    assert identified.covariance[k, k] == pytest.approx(identified.prior[k] ** 2, rel=0.05)
    rows = {row[0]: row for row in identified_rows(identified)}
    assert rows["joint_7, Nm/rad"][-1] == "not seen: no finding"
    assert len(rows) == 4 + 7 + 6
    assert any("joint_7" in line and "Not seen" in line for line in remarks(identified))


def test_every_stiffness_has_its_deviation_and_the_file_what_was_read(
    found: tuple[benchmark.Truth, ElasticArm, Identification],
) -> None:
    """Of the base by differences: how the push against one direction changes with every parameter."""
    identified = found[2]
    arm, p = identified.arm, identified.parameters.count
    known = StiffnessParameters(arm)
    at = arm.springs["base", ""]

    def softness(parameters: np.ndarray) -> np.ndarray:
        return np.log(np.diag(np.linalg.inv(known.stiffness(parameters)[np.ix_(at, at)])))

    step = 1e-5
    slopes = np.stack([(softness(step * e) - softness(-step * e)) / (2 * step) for e in np.eye(p)], axis=1)
    Sigma = identified.stiffness.covariance_matrix
    expected = np.sqrt(np.diag(slopes @ Sigma @ slopes.T))
    modelled = identified.parameters.factor @ identified.parameters.factor.T
    rows = list(stiffness_rows(identified.stiffness, modelled))
    np.testing.assert_allclose([row[3] for row in rows[-6:]], expected, rtol=1e-6)
    np.testing.assert_allclose([row[1] for row in rows[-6:]], 1 / np.diag(modelled))
    np.testing.assert_allclose([row[3] for row in rows[:-6]], np.sqrt(np.diag(Sigma)[: p - 21]))
    measured = identified.stiffness.measured
    assert measured is not None and measured.modes == ()
    (readings,) = measured.readings
    assert (readings.kind, readings.count) == ("deflections", 6)
    # The noise is as stated.
    assert readings.residual is not None and 0.3 < readings.residual < 2


def test_the_file_makes_the_same_arm_with_the_same_spread(
    found: tuple[benchmark.Truth, ElasticArm, Identification], tmp_path: Path
) -> None:
    identified = found[2]
    job = identified.job
    assert job is not None
    assert identified.after is not None
    (tmp_path / "rail.yaml").write_text(stiffness_text(identified.stiffness, "here"), encoding="utf-8")
    scene = scene_with("rail.yaml", tmp_path)
    arm = elastic_arm(robot_of(scene), elastic_base(scene.elastic_guardrail))
    np.testing.assert_allclose(Sag(arm).at(job).tool, identified.after.tool, atol=1e-9)
    covariance = covariance_of(scene, arm)
    assert covariance is not None
    again = sag_along(arm, covariance, job)
    np.testing.assert_allclose(again.deviation, identified.after.deviation, rtol=1e-6)
    # About what was identified it is the covariance of the modelled arm's parameters, moved there.
    step = 1e-4 * np.linalg.cholesky(identified.covariance)[:, 15]
    ends = [
        Sag(replace(identified.arm, stiffness=identified.parameters.stiffness(identified.mean + side * step)))
        for side in (-1, 1)
    ]
    (low, high) = (end.at(job).tool for end in ends)
    slope = np.linalg.norm(high - low, axis=1) / 2e-4
    assert np.all(slope <= again.deviation * (1 + 1e-3))


def scene_with(identified: object, folder: Path, **changes: object) -> Scene:

    data = SCENE.as_data() | {"identified": identified} | changes
    path = folder / "scene.yaml"
    path.write_text(json.dumps(data), encoding="utf-8")
    return load_scene(path)


def test_an_identified_stiffness_belongs_to_its_robot_and_place(
    found: tuple[benchmark.Truth, ElasticArm, Identification], tmp_path: Path
) -> None:
    stiffness = found[2].stiffness
    data = stiffness.model_dump(mode="json", exclude_none=True)
    other = data | {"links": [data["links"][0] | {"modelled": 1.0}, *data["links"][1:]]}
    with pytest.raises(SceneError, match="the stiffness is that of another robot"):
        robot_of(scene_with(other, tmp_path))
    other = data | {"joints": [data["joints"][0] | {"name": "knee"}, *data["joints"][1:]]}
    with pytest.raises(SceneError, match=r"identified\.joints: got knee, expected a joint that bends"):
        robot_of(scene_with(other, tmp_path))
    with pytest.raises(SceneError, match="expected a stiffness measured where the feet hold now"):
        scene_with(data | {"base": data["base"] | {"footholds": [[1, 0, 0]]}}, tmp_path)
    with pytest.raises(SceneError, match="expected elastic, as joints were identified"):
        scene_with(data, tmp_path, robot={"joints": "rigid"})
    with pytest.raises(SceneError, match="expected 32 rows of 32 numbers"):
        scene_with(data | {"covariance": data["covariance"][:-1]}, tmp_path)
    fewer = [row[:-21] for row in data["covariance"][:-21]]
    without = {key: value for key, value in data.items() if key != "base"} | {"covariance": fewer}
    with pytest.raises(SceneError, match=r"guardrail.stiffness: got stiffness, expected no such key beside"):
        scene_with(without, tmp_path, guardrail={"stiffness": SOFT})
    with pytest.raises(SceneError, match=r"guardrail.mass: got a mass alone"):
        scene_with(without, tmp_path, guardrail={"mass": np.eye(6).tolist()})
    scene = scene_with(without, tmp_path)
    arm = elastic_arm(robot_of(scene), elastic_base(scene.elastic_guardrail))
    other = (
        r"identified: got .* \(measured by .*\), expected what bends in this scene, in this order: link_1.*"
    )
    with pytest.raises(SceneError, match=f"{other}; the stiffness is that of another robot"):
        covariance_of(scene, arm)
    with pytest.raises(SceneError) as refused:
        precheck_scene(scene_with(without, tmp_path, guardrail={"bays": 1}))
    assert refused.value.line == 1
    with pytest.raises(SceneError, match="identified: got an identified stiffness, expected a scene without"):
        measured_arm(scene)


SOFT = [1e6, 1e6, 1e6, 1e5, 1e5, 1e5]


@pytest.mark.parametrize(
    "given",
    [
        {"stiffness": SOFT},
        {"stiffness": SOFT, "mass": (5 * np.eye(6)).tolist()},
        {"mass": (5 * np.eye(6)).tolist()},
        {"stiffness_factor": 0.5},
    ],
    ids="-".join,
)
def test_what_was_identified_wins_over_the_scene(
    found: tuple[benchmark.Truth, ElasticArm, Identification], tmp_path: Path, given: dict[str, object]
) -> None:
    data = found[2].stiffness.model_dump(mode="json", exclude_none=True)
    plain, scene = scene_with(data, tmp_path), scene_with(data, tmp_path, guardrail=given)
    for one in (plain, scene):
        np.testing.assert_array_equal(
            elastic_base(one.elastic_guardrail).stiffness, data["base"]["stiffness"]
        )
    np.testing.assert_array_equal(
        elastic_base(scene.elastic_guardrail).mass, np.array(data["base"].get("mass", np.zeros((6, 6))))
    )
    (told,) = (value for name, value in precheck_scene(scene).found if name == "stiffness")
    keys = [f"guardrail.{key}" for key in given]
    assert told.endswith(f"It replaces {' and '.join(keys)} of the scene.")
    (plainly,) = (value for name, value in precheck_scene(plain).found if name == "stiffness")
    assert told.startswith(plainly)
    assert "It replaces" not in plainly


def test_on_a_rigid_base_the_locked_joints_are_what_bends_of_it() -> None:
    rigid = measured_arm(SCENE.changed(guardrail={"bays": 0}))
    compliance = np.linalg.inv(rigid.base.stiffness)
    np.testing.assert_allclose(compliance, rigid.robot.leg_compliance[0], atol=1e-9)


def test_the_public_door() -> None:
    with pytest.raises(cmbot.InputError, match="expected the path of a file of measurements"):
        cmbot.identify(3)  # type: ignore[arg-type]
