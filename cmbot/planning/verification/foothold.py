"""A second computation of what the feet bear, from the scene file's numbers and the bodies' weights."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.verification.check import Check
from cmbot.planning.verification.multibody import Multibody
from cmbot.robot import Robot
from cmbot.scene import GuardrailFile, HoldFile, Scene

__all__ = ["hold_checks"]

_GRAVITY = np.array([0.0, 0.0, -9.81])
# What two computations may differ by, as a share of the largest; by what share a bound may be missed.
_SAME, _LIMIT, _LEAST = 1e-6, 1e-9, 1e-6
# Points along a quarter's edge by which distances from the centre are averaged.
_POINTS = 40


def hold_checks(
    scene: Scene,
    body: Multibody,
    robot: Robot,
    times: FloatArray,
    efforts: tuple[FloatArray, FloatArray, FloatArray],
) -> Iterator[Check]:
    """Yield what the package's adhesion differs by, and what a foot bears against its bounds.

    Parameters
    ----------
    scene : Scene
    body : Multibody
    robot : Robot
        What the package made of the scene's robot.
    times : (N,), s
    efforts : three arrays
        Joint torques (N, n) and the moving arm's force and torque (N, 3) on the guardrail: `body.efforts`.
    """
    holding = robot.holding
    if holding is None:
        return
    file = scene.file.guardrail
    hold = file.hold[0] if file.hold else HoldFile(kind="welded")
    load, half = _load(file, hold, body, efforts)
    if half is not None:
        own = np.maximum(_adhesion(load, half, hold.friction), 0.0)
        theirs = holding.each(np.hstack(efforts[1:]))[:, 0]
        quantity = "difference of the adhesion needed from a second computation"
        yield _worst(quantity, times, np.abs(own - theirs), max(_SAME * float(own.max()), _LEAST), "N")
        if hold.adhesion_n is not None:
            bound = hold.adhesion_n / hold.safety * (1 + _LIMIT)
            yield _worst("adhesion needed by a second computation", times, own, bound, "N")
    if hold.force_n is not None and hold.moment_nm is not None:
        use = (np.abs(load) / np.array([*hold.force_n, *hold.moment_nm])).max(axis=1)
        bound = (1 + _LIMIT) / hold.safety
        yield _worst("load of the clamp by a second computation", times, use, bound, "of its bounds")


def _load(
    file: GuardrailFile, hold: HoldFile, body: Multibody, efforts: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, tuple[float, float] | None]:
    """Forces and moments (N, 6) along the member, across it and outward; half of the contact's sides, m."""
    post, on_post = file.post, file.foot.offset_m == 0
    rail = next((rail for rail in file.rails if rail.height_m == 0), None)
    section = post.section if on_post or rail is None else rail.section
    along = np.array([0.0, 0.0, 1.0]) if on_post else np.array([1.0, 0.0, 0.0])
    low, high = -hold.plate_m[0] / 2, hold.plate_m[0] / 2
    if on_post:
        low, high = max(low, post.bottom_m), min(high, post.top_m)
    else:
        before = (file.foot_post - 1) * file.post_spacing_m + file.foot.offset_m
        low, high = max(low, -before), min(high, file.bays * file.post_spacing_m - before)
    out, half = np.array([0.0, 1.0, 0.0]), None
    if section.angle is not None:
        half = ((high - low) / 2, min(hold.plate_m[1], section.angle[0]) / 2)
        centre = section.angle[0] / 2 * out + (low + high) / 2 * along
    else:
        centre = (section.bar or 0.0) / 2 * out
    _, force, torque = efforts
    weights = [(one.mass, one.centre) for one in body.bodies if one.joint == 0]
    still = sum(mass for mass, _ in weights) * _GRAVITY
    moment = sum((np.cross(point, mass * _GRAVITY) for mass, point in weights), np.zeros(3))
    force = force + still
    about = torque + moment - np.cross(centre, force)
    axes = np.stack([along, np.cross(out, along), out], axis=1)
    return np.hstack([force @ axes, about @ axes]), half


def _adhesion(load: FloatArray, half: tuple[float, float], friction: float) -> FloatArray:
    """What the contact needs (N,), N: the formulas of the docs, the mean distance by points of a quarter."""
    nodes, weights = np.polynomial.legendre.leggauss(_POINTS)
    # Graded towards the centre, where the distance is not smooth.
    share, weight = (0.5 * (1 + nodes)) ** 3, weights * 1.5 * (0.5 * (1 + nodes)) ** 2
    distance = np.hypot(half[0] * share[:, None], half[1] * share)
    radius = float(weight @ distance @ weight)
    slide_u, slide_w, pull, about_u, about_w, torsion = load.T
    rest = np.sqrt(slide_u**2 + slide_w**2) / friction
    rest += np.sqrt((about_u / half[1]) ** 2 + (about_w / half[0]) ** 2)
    turn = np.abs(torsion) / (friction * radius)
    slip = (rest**1.25 + turn**1.25) ** 0.8
    tip = np.maximum(np.abs(about_u) / half[1], np.abs(about_w) / half[0])
    return np.asarray(pull + np.maximum(np.maximum(tip, slip), 0.0))


def _worst(quantity: str, times: FloatArray, value: FloatArray, bound: float, unit: str) -> Check:
    k = int(value.argmax())
    return Check(quantity=quantity, time=float(times[k]), value=float(value[k]), bound=bound, unit=unit)
