"""Whether identified stiffness is as exact as it claims: simulated measurements of arms that are known.

    python benchmarks/identification.py [--runs 1000] [--postures 8]
    python benchmarks/identification.py --tracking [--runs 3]
    python benchmarks/identification.py --misfit [--runs 200]

Eight proposed postures, 5 kg, 0.1 mm, along the planned triangle. The truths are built and brought to rest by
the package's elastic model from scaled tubes, joints and bases, not by the estimator's parameters; the weight
is wrong by its standard deviation, too. Cases: truths drawn from the prior that the estimate states; a base
that no entry of the prior describes, a full 6 x 6 that mixes all displacements and rotations; and everything
times 0.7 with joints of 5e4 Nm/rad.

With `--tracking` the last of these is simulated along the triangle with its sag compensated: by the model of
the paper, whose joints are rigid, by the model with assumed joints, and by what was identified; the last plan
promises its deviation for one standard deviation of the stiffness.

With `--misfit` measurements of truths drawn from the prior are spoiled: how often that is refused, how often
what is named are the rows that were spoiled, and whether the errors of what is written are large enough.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.linalg import expm
from threadpoolctl import threadpool_limits

from cmbot import load_scene, plan
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.sag import Sag
from cmbot.elastic.stiffness_parameters import StiffnessParameters
from cmbot.identification import (
    Measurements,
    MeasuringSetup,
    Proposal,
    estimate,
    job_postures,
    measured_arm,
    propose,
    require_fit,
)
from cmbot.planning import Plan
from cmbot.scene import Scene
from cmbot.simulation import PrescribedWork, SimulationOptions, track_work

__all__ = ["CASES", "Coverage", "Truth", "drawn", "mixed", "run", "simulated", "soft"]

_WITHIN, _SIGMAS = 0.03, 1.959964
# Size of the random mixture of a base's displacements and rotations.
_MIXED = 0.15
_SOFT, _JOINT = 0.7, 5e4
_SIGMA = "standard deviations of the stiffness"
# Rows that are spoiled.
_ROW, _OTHER = 2, 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """What is measured: factors on links and joints, and the stiffness (6, 6) of the base."""

    factors: dict[tuple[str, str], float]
    base: FloatArray
    weight: float

    def arm(self, modelled: ElasticArm) -> ElasticArm:
        """Return the true arm in place of the modelled one."""
        robot = modelled.robot
        tubes, springs = dict(robot.elasticity), dict(robot.joint_elasticity)
        for (kind, name), factor in self.factors.items():
            if kind == "link":
                tube = tubes[name]
                tubes[name] = replace(tube, young=factor * tube.young, shear=factor * tube.shear)
            else:
                springs[name] = replace(springs[name], stiffness=factor * springs[name].stiffness)
        stiff = replace(robot, elasticity=tubes, joint_elasticity=springs)
        return elastic_arm(stiff, replace(modelled.base, stiffness=self.base))  # type: ignore[type-var]


Draw = Callable[[ElasticArm, MeasuringSetup, np.random.Generator], Truth]


def drawn(arm: ElasticArm, setup: MeasuringSetup, rng: np.random.Generator) -> Truth:
    """Draw a truth from the prior that the estimate states."""
    prior = setup.prior
    deviation = {"link": prior.links, "joint": prior.joints}
    factors = {
        spring: float(np.exp(deviation[spring[0]] * rng.standard_normal()))
        for spring in arm.springs
        if spring[0] in deviation
    }
    X = np.diag(prior.base * rng.standard_normal(6))
    row, column = np.triu_indices(6, 1)
    X[row, column] = X[column, row] = prior.base_coupling * rng.standard_normal(15)
    L = np.linalg.cholesky(np.linalg.inv(arm.base.stiffness))
    base = np.linalg.inv(L @ expm(X) @ L.T)
    weight = setup.weight_kg + setup.weight_sd_kg * rng.standard_normal()
    return Truth(factors=factors, base=(base + base.T) / 2, weight=weight)


def mixed(arm: ElasticArm, setup: MeasuringSetup, rng: np.random.Generator) -> Truth:
    """Draw a truth whose base is a full 6 x 6: its displacements and rotations are mixed at random."""
    truth = drawn(arm, setup, rng)
    scale = np.sqrt(np.diag(arm.base.stiffness))
    own = arm.base.stiffness / np.outer(scale, scale)
    T = np.eye(6) + _MIXED * rng.standard_normal((6, 6))
    return replace(truth, base=np.outer(scale, scale) * (T.T @ own @ T))


def soft(arm: ElasticArm, setup: MeasuringSetup, rng: np.random.Generator) -> Truth:
    """Return the truth that is 0.7 times as stiff, with joints of 5e4 Nm/rad."""
    robot = arm.robot
    factors = {("link", name): _SOFT for name in robot.elasticity}
    factors |= {("joint", name): _JOINT / spring.stiffness for name, spring in robot.joint_elasticity.items()}
    weight = setup.weight_kg + setup.weight_sd_kg * rng.standard_normal()
    return Truth(factors=factors, base=_SOFT * arm.base.stiffness, weight=weight)


CASES: dict[str, Draw] = {
    "drawn from the prior": drawn,
    "base a full 6 x 6": mixed,
    "x 0.7, joints of 5e4 Nm/rad": soft,
}


def simulated(proposal: Proposal, truth: Truth, arm: ElasticArm, rng: np.random.Generator) -> Measurements:
    """Return what a gauge would read of a truth, the arm `arm`, in the proposed postures."""
    bent = Sag(arm.softened(1.0, truth.weight)).at(proposal.q).tool
    rest = Sag(arm).at(proposal.q).tool
    noise = 1e-3 * proposal.setup.gauge_sd_mm * rng.standard_normal(bent.shape)
    return Measurements(
        source="simulated",
        scene=proposal.scene,
        setup=proposal.setup,
        q=proposal.q,
        deflection=bent - rest + noise,
        job=proposal.job,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Coverage:
    """What came out of R runs.

    Attributes
    ----------
    parameters : float
        Share of parameters within 1.96 standard deviations of their estimates; NaN where the truth is not
        one of them.
    sag : float
        Share of the components of the sag along the job within 1.96 standard deviations.
    length, vector : (R,)
        RMS errors of the sag's length, and of it as a vector, as shares of its RMS.
    refused : float
        Share of runs in which the measurements were said not to fit.
    """

    parameters: float
    sag: float
    length: FloatArray
    vector: FloatArray
    refused: float


def run(proposal: Proposal, draw: Draw, runs: int, seed: int = 0) -> Coverage:
    """Measure, identify and compare with the truth, again and again."""
    rng, modelled = np.random.default_rng(seed), measured_arm(proposal.scene)
    known, inside, length, vector, refused = [], [], [], [], []
    for _ in range(runs):
        refused.append(False)
        truth = draw(modelled, proposal.setup, rng)
        arm = truth.arm(modelled)
        found = estimate(simulated(proposal, truth, arm, rng), modelled)
        true = Sag(arm).at(proposal.job).tool
        known += list(_inside(found.mean, found.covariance, truth, found.parameters))
        covariance = found.stiffness.covariance_matrix
        deviation = np.sqrt(np.diagonal(Sag(found.arm, covariance).spread(proposal.job), axis1=1, axis2=2))
        inside.append(np.abs(found.after.tool - true) <= _SIGMAS * deviation)
        rms = np.sqrt((true**2).sum(axis=1).mean())
        apart = np.linalg.norm(found.after.tool, axis=1) - np.linalg.norm(true, axis=1)
        length.append(np.sqrt((apart**2).mean()) / rms)
        vector.append(np.sqrt(((found.after.tool - true) ** 2).sum(axis=1).mean()) / rms)
        try:
            require_fit(found)
        except InputError:
            refused[-1] = True
    return Coverage(
        parameters=float(np.mean(known)),
        sag=float(np.mean(inside)),
        length=np.array(length),
        vector=np.array(vector),
        refused=float(np.mean(refused)),
    )


Spoil = Callable[[FloatArray, np.random.Generator], FloatArray]


def _exchanged(d: FloatArray, rng: np.random.Generator) -> FloatArray:
    spoiled = d.copy()
    spoiled[[_ROW, _OTHER]] = d[[_OTHER, _ROW]]
    return spoiled


def _in_row(change: Callable[[FloatArray], FloatArray]) -> Spoil:
    def spoil(d: FloatArray, rng: np.random.Generator) -> FloatArray:
        return np.vstack([d[:_ROW], change(d[_ROW]), d[_ROW + 1 :]])

    return spoil


def _coarser(times: float) -> Spoil:
    return lambda d, rng: d + 1e-4 * np.sqrt(times**2 - 1) * rng.standard_normal(d.shape)


SPOILT: dict[str, tuple[Spoil, set[int]]] = {
    "nothing": (lambda d, rng: d, set()),
    "one sign": (_in_row(lambda row: row * [1, 1, -1]), {_ROW}),
    "x and y exchanged in a row": (_in_row(lambda row: row[[1, 0, 2]]), {_ROW}),
    "1 mm in a row": (_in_row(lambda row: np.add(row, [0, 0, 1e-3])), {_ROW}),
    "two rows exchanged": (_exchanged, {_ROW, _OTHER}),
    "gauge twice as coarse as stated": (_coarser(2.0), set()),
    "gauge ten times as coarse": (_coarser(10.0), set()),
    "written in cm": (lambda d, rng: 0.1 * d, set()),
}


def misfit(proposal: Proposal, runs: int, console: Console) -> None:
    """Print what becomes of measurements that are wrong."""
    modelled, job = measured_arm(proposal.scene), proposal.job
    table = Table("spoiled", "refused", "right rows named", "sag in 95 % where written", "errors times")
    for name, (spoil, rows) in SPOILT.items():
        rng, refused, named, inside, scales = np.random.default_rng(0), [], [], [], []
        for _ in range(runs):
            truth = drawn(modelled, proposal.setup, rng)
            arm = truth.arm(modelled)
            measured = simulated(proposal, truth, arm, rng)
            found = estimate(replace(measured, deflection=spoil(measured.deflection, rng)), modelled)
            scales.append(found.parts[0].scale)
            named.append({slip.label.row for slip in found.slips if slip.significant} == rows)
            try:
                require_fit(found)
            except InputError:
                refused.append(True)
                continue
            refused.append(False)
            spread = Sag(found.arm, found.stiffness.covariance_matrix).spread(job)
            deviation = np.sqrt(np.diagonal(spread, axis1=1, axis2=2))
            inside.append(np.abs(found.after.tool - Sag(arm).at(job).tool) <= _SIGMAS * deviation)
        kept = f"{100 * np.mean(inside):.1f} %" if inside else "-"
        shares = (f"{100 * np.mean(each):.1f} %" for each in (refused, named))
        table.add_row(name, *shares, kept, f"{np.median(scales):.1f}")
    console.print(table)


def _inside(
    mean: FloatArray, covariance: FloatArray, truth: Truth, parameters: StiffnessParameters
) -> Iterator[bool]:
    """Whether the true parameters are in their intervals, those of the base last."""
    at = [-np.log(truth.factors[spring]) for spring in parameters.springs]
    L = parameters.factor
    inner = np.linalg.solve(L, np.linalg.solve(L, np.linalg.inv(truth.base)).T)
    values, V = np.linalg.eigh((inner + inner.T) / 2)
    X = (V * np.log(values)) @ V.T
    true = np.concatenate([at, X[np.triu_indices(6)]])
    yield from np.abs(mean - true) <= _SIGMAS * np.sqrt(np.diag(covariance))


def off_path(scene: Scene, truth: ElasticArm, sigmas: float = 0.0) -> tuple[Plan, float]:
    """Compensate the sag that a scene foresees; the true arm's RMS distance from the path along it, m."""
    options = replace(scene.planner, compensate=True, deviation_sigmas=sigmas, max_tool_deviation_m=1e-3)
    planned = plan(scene.with_options(options), progress=False)
    simulated_options = SimulationOptions(settle_s=0.0)
    work = PrescribedWork.planned(planned)
    found = track_work(truth, work, simulated_options, sag=planned.sag)
    return planned, float(found.metrics.path.rms[3])


def tracking(proposal: Proposal, runs: int, console: Console) -> None:
    """Print how far the true arm is off its path, by what was known of it."""
    rng, modelled = np.random.default_rng(0), measured_arm(proposal.scene)
    rigid = proposal.scene
    second = rigid.as_data()
    elastic = load_scene(second | {"robot": {**second["robot"], "joints": "elastic"}})
    truth = soft(modelled, proposal.setup, rng)
    arm = truth.arm(modelled)
    table = Table("compensated by", "off the path, RMS, mm", "sd across it at most, mm", "promised")
    for name, scene in (("the model with rigid joints", rigid), ("the model with assumed joints", elastic)):
        table.add_row(name, f"{1e3 * off_path(scene, arm)[1]:.2f}", "-", "-")
    for k in range(runs):
        found = estimate(simulated(proposal, truth, arm, rng), modelled)
        stiffness = found.stiffness.model_dump(mode="json", exclude_none=True)
        robot = {name: entry for name, entry in second["robot"].items() if name != "joints"}
        known = load_scene(second | {"robot": robot, "identified": stiffness})
        planned, rms = off_path(known, arm, sigmas=1.0 if k == runs - 1 else 0.0)
        spread, allowed = planned.compensation.deviation, planned.options.max_tool_deviation_m
        kept = next((check for check in planned.certificate.checks if _SIGMA in check.quantity), None)
        within = "-" if kept is None else f"{1e3 * kept.value:.2f} of {1e3 * allowed:g} mm"
        table.add_row(f"identification {k + 1}", f"{1e3 * rms:.2f}", f"{1e3 * spread:.2f}", within)
    console.print(table)


def main() -> int:
    """Plan, propose, simulate, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--runs", type=int)
    parser.add_argument("--tracking", action="store_true")
    parser.add_argument("--misfit", action="store_true")
    parser.add_argument("--postures", type=int, default=8)
    options = parser.parse_args()
    console = Console()
    scene = load_scene("triangle")
    job = job_postures(plan(scene, progress=False))
    with threadpool_limits(limits=1, user_api="blas"):
        proposal = propose(scene, options.postures, job)
        after = proposal.after
        console.print(
            f"Promised for {options.postures} postures with 95 %: within {100 * after.length_95:.2f} % "
            f"(length), {100 * after.share_95:.2f} % (vector); as modelled "
            f"{100 * proposal.before.length_95:.1f} %"
        )
        if options.tracking:
            tracking(proposal, options.runs or 3, console)
            return 0
        if options.misfit:
            misfit(proposal, options.runs or 200, console)
            return 0
        columns = ("runs", "parameters in 95 %", "sag in 95 %", "length within 3 %", "95 % of lengths within")
        table = Table("truth", *columns, "of vectors", "refused")
        for name, draw in CASES.items():
            runs = options.runs or 1000
            found = run(proposal, draw, runs)
            table.add_row(
                name,
                str(runs),
                f"{100 * found.parameters:.1f} %",
                f"{100 * found.sag:.1f} %",
                f"{100 * np.mean(found.length <= _WITHIN):.1f} %",
                f"{100 * np.quantile(found.length, 0.95):.2f} %",
                f"{100 * np.quantile(found.vector, 0.95):.2f} %",
                f"{100 * found.refused:.1f} %",
            )
    console.print(table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
