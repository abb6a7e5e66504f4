"""Units that may have been mistaken: degrees and radians, millimetres and metres, and others."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np

from cmbot.collision import Obstacle, extent_of
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.robot import Finding, Robot
from cmbot.scene import Scene

FAR_REACHES = 10.0
"""What is further than so many times the arm's reach is far away."""

_TURN = 2 * np.pi
# An obstacle whose every side is at least the first, m, may be in millimetres: decks and girders are long.
# One whose every side is beyond the second is, where as millimetres it would be near the arm;
# so is a tool that is fixed as far away.
_HUGE, _VAST = 5.0, 50.0
# What is nearer than so many times the arm's reach is near it.
_NEAR_REACHES = 4.0
_MILLIMETRE = 1e-3
# No base is placed more exactly, mm.
_NO_BASE_MM = 0.01
# No joint that turns takes so long to its velocity, s, with so little acceleration, rad/s2; none that slides
# has as much, m/s2.
_SLOWEST_START_S, _SLOWEST_RAD_S2, _FASTEST_M_S2 = 5.0, np.radians(10.0), 50.0
# On a base softer than this in every direction, N/m, an arm would sink by centimetres.
_SOFTEST_N_M = 1e4
# Keys, the units that their numbers look like and their own, and the sizes of numbers that do. No magnet for
# a robot pulls less, no clamp holds less, and no arm carries so much. No tip that may touch is so short, no
# lean so small, no arm's tool so fast, and no pump so slow. Right angles, and parts of them, are whole.
_SUSPECTS: tuple[tuple[str, tuple[str, str], Callable[[FloatArray], bool]], ...] = (
    (r"start\.posture_deg", ("radians", "degrees"), lambda size: _is_uneven_turn(size)),
    (
        r"start\.posture",
        ("degrees, or mm of a joint that slides", "rad and m (start.posture_deg is in degrees)"),
        lambda size: size.max() > _TURN,
    ),
    (r"(guardrail|base)\..*(adhesion|force)_n", ("kN", "N"), lambda size: size.max() < 100.0),
    (r"robot\.(payload_kg|tool\.mass_kg)", ("grams", "kg"), lambda size: size.max() >= 300.0),
    (r"tool\.contact_mm", ("metres", "mm"), lambda size: 0 < size.max() < 0.5),
    (r"tool\.process_ramp_s", ("milliseconds", "s"), lambda size: size.max() >= 20.0),
    (r"tool.*\.(max_)?speed_m_s", ("mm/s", "m/s"), lambda size: size.max() > 10.0),
    (r".*\.lean_deg", ("radians", "degrees"), lambda size: 0 < size.max() < 1.0),
    (
        r"(robot|tool|tool_path|frames)\..*\.rpy_deg",
        ("radians", "degrees"),
        lambda size: in_radians(size),
    ),
    (r"tool_path\..*\.(angle|from|to)_deg", ("radians", "degrees"), lambda size: in_radians(size, 15.0)),
    (r"tool\.fixed\.xyz", ("millimetres", "metres"), lambda size: size.max() > _VAST),
    (r"uncertainty\.(foot|workpiece)\.mm", ("metres", "mm"), lambda size: 0 < size.max() <= _NO_BASE_MM),
)
# Places along a path, m, which may be as far from the origin as the robot is.
_PLACES = re.compile(r"frames\..*\.xyz|tool_path\..*(\.(xyz|by|via|to|centre|origin|u|v)|waypoints)")
# How near an angle is to a whole one, deg.
_NEARLY_WHOLE_DEG = 0.1


def mistaken_units(scene: Scene, robot: Robot | None = None) -> Iterator[tuple[str, str, str]]:
    """Yield what of a scene looks as if it were in other units: key, the units it looks like, and its own.

    With a robot the limits of its joints, too.
    """
    yield from () if robot is None else _mistaken_limits(robot)
    stiffness, mount, stance = scene.elastic_guardrail.stiffness, scene.robot.mount, scene.stance
    if stiffness is not None and np.diag(stiffness)[:3].max() < _SOFTEST_N_M:
        yield scene.softest_key, "N/mm", "N/m and Nm/rad"
    stands = (*(stance.foot if stance else ()), *(mount.xyz if mount else ()), 0.0)
    far = _VAST + max(map(abs, stands))
    for key, numbers in scene.numbers:
        size = np.abs(numbers)
        for pattern, units, is_suspect in _SUSPECTS:
            if re.fullmatch(pattern, key) and is_suspect(size):
                yield key, *units
        if _PLACES.fullmatch(key) and size.max() > far:
            yield key, "millimetres", f"metres{' (of a table: units: mm)' * key.endswith('waypoints')}"
    for number, obstacle in enumerate(_own(scene)):
        if obstacle.scale is None and _shortest_side(extent_of(obstacle)) >= _HUGE:
            yield f"obstacles[{number}]", "millimetres", "metres (scale: 1 says that they are)"


def _mistaken_limits(robot: Robot) -> Iterator[tuple[str, str, str]]:
    """Accelerations with which a joint that turns is slow to start, or one that slides fast."""
    limits = robot.limits
    seconds, slides = limits.velocity / limits.acceleration, limits.prismatic
    if ((seconds > _SLOWEST_START_S) & (limits.acceleration < _SLOWEST_RAD_S2) & ~slides).any():
        yield "robot.limits", "accelerations in rad/s2", "deg/s2"
    if (limits.acceleration > _FASTEST_M_S2)[slides].any():
        yield "robot.limits", "accelerations in mm/s2", "m/s2"


def _is_uneven_turn(size: FloatArray) -> bool:
    """Whether angles are at most a turn in radians, and two of them no whole numbers."""
    return bool(0.5 < size.max() <= _TURN and (np.abs(size - size.round()) > 1e-6).sum() >= 2)


def in_radians(size: FloatArray, whole: float = 45.0) -> bool:
    """Return whether angles but 0 are multiples of so many degrees if they are radians, a turn at most."""
    angles = np.degrees(size[size > 0])
    times = np.round(angles / whole)
    off = np.abs(angles - whole * times)
    return bool(size.any() and (times >= 1).all() and (off < _NEARLY_WHOLE_DEG).all() and angles.max() < 361)


def unit_findings(scene: Scene, robot: Robot | None = None) -> Iterator[Finding]:
    """Yield a warning for all that `mistaken_units` yields.

    Parameters
    ----------
    scene : Scene
    robot : Robot, optional
        Whose limits are looked at, too.
    """
    for key, looks, units in mistaken_units(scene, robot):
        yield Finding(severity="warning", key=key, got=f"numbers that look like {looks}", expected=units)


def require_metres(scene: Scene, robot: Robot) -> None:
    """Refuse an obstacle that is far away, or vast, and as millimetres would be near the arm.

    Parameters
    ----------
    scene : Scene
    robot : Robot

    Raises
    ------
    SceneError
        For the first one that does not say with ``scale: 1`` that it is meant.
    """
    for number, obstacle in enumerate(_own(scene)):
        found = None if obstacle.scale == 1 else _as_millimetres(obstacle, robot)
        if found is not None:
            got, expected = found
            raise SceneError(scene.source, f"obstacles[{number}]", f"{obstacle.name}, {got}", expected)


def _own(scene: Scene) -> list[Obstacle]:
    """Obstacles that are none of the guardrail's members."""
    return list(scene.all_obstacles[: len(scene.obstacles)])


def _as_millimetres(obstacle: Obstacle, robot: Robot) -> tuple[str, str] | None:
    """What is suspicious of an obstacle that looks like millimetres, and what is expected; else None."""
    extent, place = extent_of(obstacle), obstacle.X_WO[:3, 3]
    away, near, far = _distance(extent, robot), _NEAR_REACHES * robot.reach, FAR_REACHES * robot.reach
    # A scale says of the size that it is meant, not of the place.
    is_vast = obstacle.scale is None and _shortest_side(extent) > _VAST
    smaller = place + _MILLIMETRE * (extent - place)
    if (
        not (away > far or is_vast)
        or min(_distance(each, robot) for each in (_MILLIMETRE * extent, smaller)) > near
    ):
        return None
    got = f"{away:.4g} m from an arm that reaches {robot.reach:.3g} m"
    if away <= far:
        got = f"{' x '.join(f'{side:.4g}' for side in np.diff(extent, axis=0)[0])} m"
    if obstacle.scale is not None:
        return f"{got}: like xyz in millimetres", "xyz in metres, as scale has no part in it"
    how = "size and xyz in metres"
    if _distance(smaller, robot) <= far:
        how = "metres; scale: 0.001 reads its size in millimetres, not xyz"
    return f"{got}: like millimetres", f"{how}; scale: 1 says that it is meant"


def _shortest_side(extent: FloatArray) -> float:
    return float(np.diff(extent, axis=0).min())


def _distance(extent: FloatArray, robot: Robot) -> float:
    """Distance of the arm's first joint from a box between two corners (2, 3) in W, m."""
    low, high = extent - robot.base_point
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(low, -high))))
