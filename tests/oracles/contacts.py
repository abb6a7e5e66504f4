"""Where feet touch their members, from the numbers of a scene file."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray

__all__ = ["Contact", "contacts"]

_NORMALS = {
    **{"outer": (0.0, 1.0, 0.0), "inner": (0.0, -1.0, 0.0), "top": (0.0, 0.0, 1.0)},
    **{"bottom": (0.0, 0.0, -1.0), "right": (1.0, 0.0, 0.0), "left": (-1.0, 0.0, 0.0)},
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Contact:
    """The middle of a contact (3,), m, in W, axes (3, 3) as columns, half of its sides, m."""

    centre: FloatArray
    axes: FloatArray
    half: tuple[float, float] | None  # of a closed side


def contacts(file: Any, holds: Sequence[Any]) -> Iterator[Contact]:
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
        yield Contact(centre=fixed + middle * along + depth * out, axes=axes, half=half)
