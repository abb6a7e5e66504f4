"""The loads of a job: what the arm exerts on its base, and what its joints bear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.result.plan import Plan

LOAD_HEADINGS = ("", "largest", "unit", "at, s", "during", "share of its limit")
"""Headings of `load_rows`."""


@dataclass(frozen=True, kw_only=True)
class Load:
    """A component of the wrench on the base, or the torque or force of a joint, where it is largest.

    Attributes
    ----------
    name : str
    value : float
        With its sign, in `unit`.
    unit : str
    time : float, s
        On the job's clock.
    segment : str
        Of the job.
    limit : float or None
        What a joint can bear, in `unit`; None of components on the base.
    """

    name: str
    value: float
    unit: str
    time: float
    segment: str
    limit: float | None = None


def loads(plan: Plan) -> tuple[Load, ...]:
    """Return the largest loads of a job: three forces and three torques on the base, and one of each joint.

    They are those of the samples of ``job.csv``. What the arm exerts on the base is about `load_point`, along
    the axes of W.

    Parameters
    ----------
    plan : Plan
    """
    return tuple(_loads(plan))


def load_point(plan: Plan) -> FloatArray:
    """Return the point (3,), m, in W, about which `loads` has torques: the origin of the base's link."""
    return np.array(plan.robot.foot_point)


def _loads(plan: Plan) -> Iterator[Load]:
    samples, segments = plan.job_samples

    def largest(name: str, values: FloatArray, unit: str, limit: float | None = None) -> Load:
        k = int(np.abs(values).argmax())
        value, time = float(values[k]), float(samples.t[k])
        return Load(name=name, value=value, unit=unit, time=time, segment=segments[k], limit=limit)

    base = plan.scene.base_name
    for what, unit, of in (
        ("force", "N", samples.guardrail_force),
        ("torque", "Nm", samples.guardrail_torque),
    ):
        for k, axis in enumerate("xyz"):
            yield largest(f"{what} on the {base}, {axis}", of[:, k], unit)
        yield largest(f"{what} on the {base}, norm", np.linalg.norm(of, axis=1), unit)
    limits = plan.robot.limits
    for k, joint in enumerate(plan.robot.joints):
        unit = limits.units(k).torque
        what = "force" if limits.prismatic[k] else "torque"
        yield largest(f"{what} of {joint}", samples.joint_torque[:, k], unit, float(limits.torque[k]))


def load_rows(plan: Plan) -> Iterator[tuple[str, ...]]:
    """Yield the loads of a plan as rows of a table below `LOAD_HEADINGS`.

    Parameters
    ----------
    plan : Plan
    """
    for load in loads(plan):
        share = "" if load.limit is None else f"{100 * abs(load.value) / load.limit:.1f} %"
        yield load.name, f"{load.value:.4g}", load.unit, f"{load.time:.2f}", load.segment, share
