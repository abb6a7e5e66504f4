"""What an arm stands on, as the pages bend it: the guardrail's frame, or a pole among the obstacles."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from cmbot.collision import Box, Capsule, Cylinder, Mesh, Obstacle, load_mesh
from cmbot.common.arrays import FloatArray
from cmbot.elastic import Guardrail
from cmbot.elastic.base import guardrail_frame, motion_of_feet
from cmbot.elastic.frame import Frame
from cmbot.elastic.strain import BeamStrains, frame_strains
from cmbot.scene import Scene, guardrail_obstacles
from cmbot.views.page import pack

# A pole is this many times as long as it is wide, its surface no farther from the foot than this, m.
_SLENDER, _NEAR = 3.0, 0.03
# How near the foot is to an end of a pole that is held at the other alone, as a share of its length; the sine
# of the inclination from which on a pole stands on its lower end.
_END, _UPRIGHT = 0.2, 0.7


class Pole(NamedTuple):
    """An obstacle that carries the foot.

    Its name, its beams (b, 2, 3) in W, m, each held at its start, and whether it is a mesh.
    """

    name: str
    beams: FloatArray
    mesh: bool


def pole_of(scene: Scene) -> Pole | None:
    """Return the pole, mast or bar on which the robot stands, None where no obstacle is one.

    It is a slender obstacle at which the foot is. With the foot at one end it is held at the other; else
    upright at its lower end, and level at both.
    """
    if scene.elastic_guardrail.post_positions:
        return None
    found = []
    tube = None if scene.base is None else scene.base.tube
    foot = np.array(scene.elastic_guardrail.foot_point if tube is None else tube.end_m)
    for obstacle in scene.all_obstacles:
        ends, radius = _axis(obstacle, foot)
        along = ends[1] - ends[0]
        length = float(np.linalg.norm(along))
        if obstacle.workpiece or length < _SLENDER * 2 * radius:
            continue
        share = float((foot - ends[0]) @ along) / length**2
        at = ends[0] + np.clip(share, 0, 1) * along
        if (distance := float(np.linalg.norm(foot - at))) <= radius + _NEAR:
            pole = Pole(obstacle.name, _beams(ends, share), isinstance(obstacle.shape, Mesh))
            found.append((distance, pole))
    return min(found, key=lambda each: each[0])[1] if found else None


def supports(scene: Scene) -> list[Obstacle]:
    """Return the obstacles that bend with the foot: rails and posts, or a pole."""
    names = {obstacle.name for obstacle in guardrail_obstacles(scene.elastic_guardrail)}
    if (pole := pole_of(scene)) is not None:
        names.add(pole.name)
    return [obstacle for obstacle in scene.all_obstacles if obstacle.name in names]


def _axis(obstacle: Obstacle, foot: FloatArray) -> tuple[FloatArray, float]:
    """The ends (2, 3) of an obstacle's axis in W and its half width, m; no axis of a ball.

    That of a mesh is the longest edge of the smallest box about it; no axis of one away from the `foot`.
    """
    X = obstacle.X_WO
    match obstacle.shape:
        case Box(size=size):
            edges = np.array(size)
        case Cylinder(radius=radius, length=length) | Capsule(radius=radius, length=length):
            edges = np.array([2 * radius, 2 * radius, length])
        case Mesh(path=path, scale=scale):
            mesh = load_mesh(path, obstacle.name, scale=scale)
            low, high = mesh.bounds
            there = np.linalg.solve(X, np.append(foot, 1.0))[:3]
            if ((there < low - _NEAR) | (there > high + _NEAR)).any():
                return np.zeros((2, 3)), np.inf
            about = mesh.bounding_box_oriented.primitive
            edges, X = np.array(about.extents), X @ np.array(about.transform)
        case _:
            return np.zeros((2, 3)), np.inf
    direction = np.eye(3)[edges.argmax()]
    ends = np.array([-0.5, 0.5])[:, None] * float(edges.max()) * direction
    return ends @ X[:3, :3].T + X[:3, 3], float(np.sort(edges)[1]) / 2


def _beams(ends: FloatArray, share: float) -> FloatArray:
    low, high = ends
    share = float(np.clip(share, 0, 1))
    at = low + share * (high - low)
    rise = (high - low)[2] / np.linalg.norm(high - low)
    if share > 1 - _END:
        held = [low]
    elif share < _END:
        held = [high]
    elif abs(rise) > _UPRIGHT:
        held = [low if rise > 0 else high]
    else:
        held = [low, high]
    return np.array([[end, at] for end in held])


class Rails:
    """The guardrail's beams: how their nodes move with the feet, and their strains."""

    def __init__(self, guardrail: Guardrail) -> None:
        self._guardrail = guardrail
        self._frame, self._feet = guardrail_frame(guardrail)
        self._shapes, self._rigid = self._frame.shapes(*self._feet), motion_of_feet(guardrail)
        if guardrail.leg_compliance is not None:
            # The page moves the feet with the arm's base; legs that give way move them less.
            moved, self._rigid = self._rigid, motion_of_feet(replace(guardrail, leg_compliance=None))
            self._shapes = self._shapes @ moved @ np.linalg.pinv(self._rigid)

    @property
    def frame(self) -> Frame:
        """The guardrail's frame of beams."""
        return self._frame

    @cached_property
    def strains(self) -> BeamStrains | None:
        """By the displacement of O0; None where the scene gives the stiffness, not what bends."""
        if self._guardrail.stiffness is not None:
            return None
        return frame_strains(self._frame, self._shapes @ self._rigid)

    def data(self) -> dict[str, Any]:
        """Return them, ready for JSON: ``shapes`` (k, 6, 6 m) by the motion of the m ``feet``."""
        return {
            "nodes": pack(self._frame.nodes),
            "shapes": pack(self._shapes),
            "feet": self._frame.nodes[list(self._feet)].tolist(),
            "members": [[member.start, member.end] for member in self._frame.members],
            "strains": None if self.strains is None else packed_strains(self.strains),
        }


def packed_strains(of: BeamStrains) -> dict[str, Any]:
    """Return strains of beams, ready for JSON; ``outline``: of each beam the number of its outline."""
    outlines = list(dict.fromkeys(of.outlines))
    return {
        "rows": pack(of.rows),
        "width": of.rows.shape[-1],
        "first": of.first.tolist(),
        "outlines": [{"corners": each.corners, "radius": each.radius} for each in outlines],
        "outline": [outlines.index(each) for each in of.outlines],
    }
