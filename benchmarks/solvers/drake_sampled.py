"""The problem with all samples as rows, as Drake is given it: a block for each segment of the path."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from scipy import sparse

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.optimization.program import StateSamples
from solvers.cases import Case
from solvers.drake import Block, DrakeProgram, solve_with_drake
from solvers.ipopt import Answer
from solvers.sampled import FAR, ROUND, SampledProblem

__all__ = ["drake_program", "solve_by_drake"]


def solve_by_drake(case: Case, solver: str, *, samples: int, peak_alone: bool) -> Answer:
    """Solve a case with so many samples of every segment as rows, of the peak alone or of all constraints.

    Raises
    ------
    MissingExtra
        When Drake is not installed.
    """
    begin = time.process_time()
    request = case.request.with_options(samples_per_segment=samples)
    sampled = SampledProblem(replace(case, request=request))
    program = drake_program(sampled, peak_alone=peak_alone)
    ended = solve_with_drake(program, solver)
    return Answer(
        trajectory=sampled.trajectory(ended.x),
        iterations=ended.iterations,
        status=ended.status,
        rows=sum(len(block.low) for block in program.blocks) + sum(len(low) for _, low, _ in program.linear),
        seconds=time.process_time() - begin,
    )


def drake_program(sampled: SampledProblem, *, peak_alone: bool) -> DrakeProgram:
    """Return it with the rows of `sampled`, or those of the peak and, where via-points slide, the task."""
    d, problem = sampled.robot.dof, sampled.problem
    fixed = sampled.u(np.zeros(sampled.size + 1))
    blocks = [_segment(sampled, k, fixed, peak_alone) for k in range(len(sampled.splines.support))]
    if sampled.case.sliding:
        blocks += [_via_point(sampled, k) for k in range(len(sampled.case.via_points))]
    unit, curvature = sparse.diags_array(sampled.unit), sampled.splines.smoothing_curvature
    linear = []
    for bound in () if peak_alone else problem.bounds:
        W = sampled.weights[bound.order]
        A = sparse.kron(W[:, : sampled.columns], sparse.diags_array(1 / bound.scale)) @ unit
        at_zero = (W @ fixed / bound.scale).ravel()
        low, high = (np.tile(side / bound.scale, W.shape[0]) - at_zero for side in (bound.low, bound.high))
        A = sparse.hstack([A, sparse.coo_array((A.shape[0], 1))])
        linear.append((A, low, high))
    Q = sparse.block_diag([sampled.smoothing_curvature, np.zeros((1, 1))]).toarray()
    slope = sampled.case.smoothing * (curvature @ fixed.ravel())[: d * sampled.columns] * sampled.unit
    return DrakeProgram(
        start=sampled.start,
        lowest=sampled.lowest,
        highest=sampled.highest,
        objective=(Q, np.append(slope, 1.0)),
        blocks=tuple(blocks),
        linear=tuple(linear),
    )


def _segment(sampled: SampledProblem, k: int, fixed: FloatArray, peak_alone: bool) -> Block:
    """Rows of the samples on segment k: they depend on the splines that live there, and on b."""
    d, grid = sampled.robot.dof, sampled.problem.grid
    rows = sampled.splines.rows(grid)
    here = np.flatnonzero(rows.segment == k)
    support = sampled.splines.support[k]
    place = np.flatnonzero((support >= 0) & (support < sampled.columns))
    columns = support[place]
    offset = np.stack([W[here] @ fixed for W in sampled.weights[:3]])
    W = rows.weight[here][:, :3, place].transpose(1, 0, 2)
    unit = sampled.unit.reshape(-1, d)[columns]
    N, R, times = len(here), 1 if peak_alone else d + 2, grid[here]

    def states(x: FloatArray) -> StateSamples:
        return StateSamples(times, *(W @ (x[:-1].reshape(-1, d) * unit) + offset))

    def of(at: StateSamples, x: FloatArray) -> FloatArray:
        value = sampled.state_values(at, peak_alone=peak_alone)
        value[:, 0] -= x[-1]
        return value.ravel()

    def jacobian(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        at = states(x)
        D = sampled.state_derivatives(at, peak_alone=peak_alone)
        J = np.zeros((N, R, len(x)))
        J[:, :, :-1] = (np.einsum("onc,onrd->nrcd", W, D, optimize=True) * unit).reshape(N, R, -1)
        J[:, 0, -1] = -1.0
        return of(at, x), J.reshape(N * R, -1)

    low, high = np.full((N, R), -FAR), np.zeros((N, R))
    if not peak_alone:
        low[:, 1:-1], high[:, 1:-1], high[:, -1] = -1.0, 1.0, np.hypot(1.0, ROUND)
    return Block(
        of=np.append(_unknowns(columns, d), sampled.size),
        low=low.ravel(),
        high=high.ravel(),
        rows=lambda x: of(states(x), x),
        jacobian=jacobian,
    )


def _via_point(sampled: SampledProblem, k: int) -> Block:
    """Task of a sliding via-point."""
    d, column = sampled.robot.dof, sampled.splines.count + k
    unit = sampled.unit.reshape(-1, d)[column]
    given, number = sampled.case.via_points[k], np.array([k])

    def jacobian(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, J = sampled.task_at(number, (given + unit * x)[None])
        return value[0], J[0] * unit

    nothing = np.zeros(len(sampled.task_at(number, given[None])[0][0]))
    return Block(
        of=_unknowns(np.array([column]), d),
        low=nothing,
        high=nothing,
        rows=lambda x: jacobian(x)[0],
        jacobian=jacobian,
    )


def _unknowns(columns: IntArray, d: int) -> IntArray:
    return np.asarray((d * columns[:, None] + np.arange(d)).ravel())
