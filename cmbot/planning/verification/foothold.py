"""A second computation of what the feet bear, from the scene file's numbers and the bodies' weights."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.planning.certification.check import Check
from cmbot.planning.verification.multibody import Multibody
from cmbot.robot import Robot
from cmbot.scene import GuardrailFile, HoldFile, Scene

__all__ = ["hold_checks"]

_NORMALS = {
    **{"outer": (0.0, 1.0, 0.0), "inner": (0.0, -1.0, 0.0), "top": (0.0, 0.0, 1.0)},
    **{"bottom": (0.0, 0.0, -1.0), "right": (1.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0)},
}
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
    file, stance = scene.file.guardrail, scene.robot.stance
    foot_point = np.zeros(3) if stance is None else np.array(stance.foot)
    wrench = np.hstack(_whole(body, foot_point, efforts))
    holds = file.hold or (HoldFile(kind="welded"),)
    for number, contact in enumerate(_contacts(file, holds)):
        hold = holds[min(number, len(holds) - 1)]
        which = f" of foot {number + 1}" if len(robot.feet) > 1 else ""
        # How two feet share a wrench is the elastic frame's, which is not judged.
        force, torque = np.split(wrench @ robot.feet[number].share.T, 2, axis=1)
        about = torque - np.cross(contact.centre - foot_point, force)
        load = np.hstack([force @ contact.axes, about @ contact.axes])
        if contact.half is not None:
            own = np.maximum(_adhesion(load, contact.half, hold.friction), 0.0)
            theirs = np.maximum(holding.needed(number, np.hstack(efforts[1:])), 0.0)
            quantity = f"difference of the adhesion needed{which} from a second computation"
            bound = max(_SAME * float(own.max()), _LEAST)
            yield _worst(quantity, times, np.abs(own - theirs), bound, "N")
            if hold.adhesion_n is not None:
                bound = hold.adhesion_n / hold.safety * (1 + _LIMIT)
                yield _worst(f"adhesion needed{which} by a second computation", times, own, bound, "N")
        if hold.force_n is not None and hold.moment_nm is not None:
            use = hold.safety * (np.abs(load) / np.array([*hold.force_n, *hold.moment_nm])).max(axis=1)
            quantity = f"load of the clamp{which} by a second computation"
            yield _worst(quantity, times, use, 1 + _LIMIT, "of its bounds")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Contact:
    """The middle of a contact (3,), m, in W, axes (3, 3) as columns, half of its sides, m."""

    centre: FloatArray
    axes: FloatArray
    half: tuple[float, float] | None


def _contacts(file: GuardrailFile, holds: Sequence[HoldFile]) -> Iterator[_Contact]:
    """The contacts of the feet, from the numbers of the file."""
    origin = -(file.foot_post - 1) * file.post_spacing_m - file.foot.offset_m
    posts = {f"post_{k + 1}": origin + k * file.post_spacing_m for k in range(file.bays + 1)}
    rails = {rail.name: rail for rail in file.rails}
    places: list[tuple[str, float | None, str]] = []
    if file.stance is not None:
        both = (file.stance.foot_1, file.stance.foot_2)
        places += [(place.member, place.along_m, place.face) for place in both if place is not None]
    elif file.foot.offset_m == 0:
        places.append((f"post_{file.foot_post}", None, "outer"))
    else:
        places += [(name, None, "outer") for name, rail in rails.items() if rail.height_m == 0][:1]
    for (member, along_m, face), hold in zip(places, (*holds, holds[-1]), strict=False):
        out = np.array(_NORMALS[face])
        if member in posts:
            section, low, high = file.post.section, file.post.bottom_m, file.post.top_m
            along, fixed = np.array([0.0, 0.0, 1.0]), np.array([posts[member], 0.0, 0.0])
        else:
            section, low, high = rails[member].section, origin, origin + file.bays * file.post_spacing_m
            along, fixed = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, rails[member].height_m])
        at = 0.0 if along_m is None else low + along_m
        first, last = max(at - hold.plate_m[0] / 2, low), min(at + hold.plate_m[0] / 2, high)
        half, depth, middle = None, (section.bar or 0.0) / 2, at
        if section.angle is not None:
            half = ((last - first) / 2, min(hold.plate_m[1], section.angle[0]) / 2)
            depth, middle = section.angle[0] / 2, (first + last) / 2
        axes = np.stack([along, np.cross(out, along), out], axis=1)
        yield _Contact(centre=fixed + middle * along + depth * out, axes=axes, half=half)


def _whole(
    body: Multibody, foot_point: FloatArray, efforts: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Force and torque (N, 3) of the whole robot about O0, N and Nm."""
    weights = [(one.mass, one.centre - foot_point) for one in body.bodies if one.joint == 0]
    still = sum(mass for mass, _ in weights) * _GRAVITY
    moment = sum((np.cross(lever, mass * _GRAVITY) for mass, lever in weights), np.zeros(3))
    return efforts[1] + still, efforts[2] + moment


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
