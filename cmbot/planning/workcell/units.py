"""Units that may have been mistaken: degrees and radians of start and lean, millimetres, and others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.collision import Obstacle, extent_of
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.robot import Finding, Robot
from cmbot.scene import Scene

FAR_REACHES = 10.0
"""What is further than so many times the arm's reach is far away."""

# An angle is whole to this, deg.
_WHOLE_ANGLE_TOLERANCE_DEG = 1e-6
# An obstacle whose every side is at least the first, m, may be in millimetres: decks and girders are long.
# One whose every side is beyond the second is, where as millimetres it would be near the arm;
# so is a tool that is fixed as far away.
_HUGE, _VAST = 5.0, 50.0
# What is nearer than so many times the arm's reach is near it.
_NEAR_REACHES = 4.0
_MILLIMETRE = 1e-3
# On a base softer than this in every direction, N/m, an arm would sink by centimetres.
_SOFTEST_N_M = 1e4
# No magnet for a robot pulls less, and no clamp holds less, N.
_LEAST_HOLD_N = 100.0
# No robot's arm carries so much, kg.
_HEAVIEST_KG = 300.0
# No tip that may touch is so short, mm, no lean so small, deg, and no arm's tool faster than that, m/s.
_SHORTEST_TIP_MM, _LEAST_LEAN_DEG, _FASTEST_M_S = 0.5, 1.0, 10.0


def mistaken_units(scene: Scene) -> Iterator[tuple[str, str, str]]:
    """Yield what of a scene looks as if it were in other units: key, the units it looks like, and its own."""
    key = scene.posture_key
    if key.endswith("posture_deg"):
        angles = np.abs(np.degrees(scene.posture))
        fractions = np.abs(angles - np.round(angles)) > _WHOLE_ANGLE_TOLERANCE_DEG
        if 0.5 < angles.max() <= 2 * np.pi and fractions.sum() >= 2:
            yield key, "radians", "degrees"
    elif key == "start.posture" and np.abs(scene.posture).max() > 2 * np.pi:
        yield key, "degrees", "rad (start.posture_deg is in degrees)"
    stiffness = scene.elastic_guardrail.stiffness
    if stiffness is not None and np.diag(stiffness)[:3].max() < _SOFTEST_N_M:
        yield scene.softest_key, "N/mm", "N/m and Nm/rad"
    holds = [("guardrail", hold) for hold in scene.guardrail.hold or ()]
    holds += [("base", scene.base.hold)] if scene.base and scene.base.hold else []
    for block, hold in holds:
        for name, most in (("adhesion_n", hold.adhesion_n), ("force_n", hold.force_n and max(hold.force_n))):
            if most is not None and most < _LEAST_HOLD_N:
                yield f"{block}.hold.{name}", "kN", "N"
    tool, fixed, attached = scene.tool, scene.tool.fixed, scene.robot.tool
    if attached is not None and np.abs(attached.xyz).max() > _VAST:
        yield "robot.tool.xyz", "millimetres", "metres"
    masses = {"payload_kg": scene.robot.payload_kg, "tool.mass_kg": attached.mass_kg if attached else None}
    yield from (
        (f"robot.{key}", "grams", "kg") for key, mass in masses.items() if (mass or 0) >= _HEAVIEST_KG
    )
    if 0 < tool.contact_mm < _SHORTEST_TIP_MM:
        yield "tool.contact_mm", "metres", "mm"
    speeds = {"tool.max_speed_m_s": tool.max_speed_m_s}
    for number, stroke in enumerate(scene.strokes):
        key = scene.stroke_key(number)
        speeds |= {f"{key}.speed_m_s": stroke.speed_m_s}
        speeds |= {f"{key}.legs[{k}].speed_m_s": leg.speed_m_s for k, leg in enumerate(stroke.legs)}
        lean = None if stroke.raster is None else stroke.raster.lean_deg
        if lean is not None and 0 < np.abs(lean).max() < _LEAST_LEAN_DEG:
            yield f"{key}.raster.lean_deg", "radians", "degrees"
    yield from ((key, "mm/s", "m/s") for key, speed in speeds.items() if speed and speed > _FASTEST_M_S)
    if fixed is not None and np.abs(fixed.xyz).max() > _VAST:
        yield "tool.fixed.xyz", "millimetres", "metres"
    for obstacle in _own(scene):
        if obstacle.scale is None and _shortest_side(extent_of(obstacle)) >= _HUGE:
            yield f"obstacle {obstacle.name}", "millimetres", "metres (scale: 1 says that they are)"


def unit_findings(scene: Scene) -> Iterator[Finding]:
    """Yield a warning for all that `mistaken_units` yields.

    Parameters
    ----------
    scene : Scene
    """
    for key, looks, units in mistaken_units(scene):
        got = f"numbers that look like {looks}"
        yield Finding(severity="warning", key=key, got=got, expected=units)


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
