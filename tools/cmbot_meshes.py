"""What the robot looks like: turned parts and plates, one mesh for each link and colour.

Looks only. Collision shapes are primitives and masses are numbers; both are in cmbot_tables.py. Lengths in
metres, in the frame of the link. Parts may run into each other where a real part would be welded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cmbot_parts import Mesh, Vector, bar, block, bolts, drum, join, lathe
from cmbot_tables import ANKLE_HEIGHT, ANKLE_RISE, ANKLE_SIDE, FOOT_SIDE, LEG, TOOL_LENGTH

MATERIALS = {
    "aluminium": (0.78, 0.80, 0.83, 1),
    "orange": (0.93, 0.42, 0.08, 1),
    "dark": (0.16, 0.17, 0.19, 1),
    "steel": (0.55, 0.57, 0.60, 1),
    "yellow": (0.96, 0.76, 0.10, 1),
    "blue": (0.13, 0.22, 0.38, 1),
    "grey": (0.36, 0.39, 0.44, 1),
    "red": (0.75, 0.12, 0.10, 1),
    "black": (0.07, 0.07, 0.08, 1),
}


@dataclass(frozen=True, kw_only=True)
class Visual:
    """One mesh with one material."""

    mesh: str
    material: str
    xyz: Vector = (0, 0, 0)
    rpy_deg: Vector = (0, 0, 0)


def tube(radius: float, low: float, high: float, axis: str) -> Mesh:
    """Return a link's tube with a clamping flange at both ends."""
    rim, long = radius + 0.008, 0.022
    profile = [(rim - 0.003, low), (rim, low + 0.003), (rim, low + long), (radius, low + long + 0.006)]
    profile += [(radius, high - long - 0.006), (rim, high - long), (rim, high - 0.003), (rim - 0.003, high)]
    return lathe(profile, axis)


def fork(length: float, reach: float, radius: float, inner: float, outer: float, axis: str) -> Mesh:
    """Return two cheeks, at `length` along x, that hold the next link's drum, and the web that joins them."""
    # In the plane of a plate across y, x is the second coordinate; across z the first.
    start, end = ((0.0, x) if axis == "y" else (x, 0.0) for x in (length - reach, length))
    cheeks = [bar(start, end, radius, low, high, axis) for low, high in ((-outer, -inner), (inner, outer))]
    back = length - reach - radius - 0.002  # just behind the round ends of the cheeks: here the tube ends
    low, high = [back, -radius, -radius], [length - reach + 0.02, radius, radius]
    side = "xyz".index(axis)
    low[side], high[side] = -outer, outer
    web = block((low[0], low[1], low[2]), (high[0], high[1], high[2]), axis, 0.015)
    return join(*cheeks, web)


def caps(radius: float, outer: float, axis: str, at: Vector) -> tuple[Mesh, Mesh]:
    """Return the covers of a joint's bearings, outside both cheeks, and their bolts."""
    covers = [drum(radius, low, low + 0.012, axis, at) for low in (-outer - 0.010, outer - 0.002)]
    rings = [bolts(0.72 * radius, 6, low, low + 0.004, axis, at) for low in (-outer - 0.0135, outer + 0.0095)]
    return join(*covers), join(*rings)


def arm_link(length: float, radius: float, hub: Mesh, start: float, axis: str) -> dict[str, Mesh]:
    """Return a long link: the hub at its own joint, a tube along x, a fork for the next one about `axis`."""
    covers, rings = caps(0.047, 0.052, axis, (length, 0, 0))
    return {
        "aluminium": tube(radius, start, length - 0.105 - radius, "x"),
        "orange": join(hub, covers),
        "dark": join(fork(length, 0.1, radius + 0.004, 0.034, 0.052, axis), rings),
    }


def wrist_and_tool() -> dict[str, dict[str, Mesh]]:
    """Return the colours of links 4 to 7 and of the spray tool."""
    covers, rings = caps(0.036, 0.038, "y", (0, 0, 0))
    cheeks = [bar((-0.085, 0.0), (0.0, 0.0), 0.038, low, low + 0.012, "y") for low in (-0.038, 0.026)]
    neck = [(0.046, -0.19), (0.05, -0.186), (0.05, -0.09), (0.042, -0.065), (0.042, -0.03)]
    nozzle = [(0.017, 0.195), (0.017, 0.235), (0.021, 0.238), (0.021, 0.252), (0.016, 0.256), (0.008, 0.29)]
    return {
        "link_4": {
            "orange": join(drum(0.053, -0.0335, 0.0335), drum(0.0465, -0.176, -0.1, "y")),
            "dark": join(lathe(neck, "y"), bolts(0.0465, 10, -0.1925, -0.18, "y")),
        },
        "link_5": {
            "aluminium": tube(0.04, -0.678, -0.124, "z"),
            "orange": join(drum(0.046, -0.677, -0.655), covers),
            "dark": join(*cheeks, block((-0.037, -0.038, -0.125), (0.037, 0.038, -0.07), "y", 0.01), rings),
        },
        "link_6": {
            "dark": drum(0.036, -0.0255, 0.0255),
            "steel": lathe(
                [(0.03, -0.062), (0.034, -0.058), (0.034, -0.05), (0.026, -0.045), (0.026, 0)], "y"
            ),
        },
        "link_7": {
            "orange": drum(0.039, 0.0625, 0.082),
            "dark": join(drum(0.033, 0.08, 0.088, chamfer=0.002), bolts(0.031, 8, 0.081, 0.0855, "z")),
        },
        "tool": {
            "yellow": join(
                lathe([(0.03, 0.0875), (0.034, 0.0915), (0.034, 0.18), (0.018, 0.2)]),
                block((-0.012, -0.039, 0.105), (0.012, -0.02, 0.17), "y"),
            ),
            "steel": join(
                lathe([*nozzle, (0.006, TOOL_LENGTH)]),
                drum(0.009, -0.039, 0.039, "x", (0, 0, 0.15), 0.002, 16),
            ),
            "dark": join(drum(0.0355, 0.118, 0.124), drum(0.0355, 0.166, 0.172)),
        },
    }


def foot() -> dict[str, Mesh]:
    """Return a magnet foot: pole plate on the post's face (y = 0.0375), four coils, a bearing."""
    corners = [(z, x) for z in (-0.05, 0.05) for x in (-0.04, 0.04)]
    coil = [(0.019, 0.056), (0.022, 0.059), (0.022, 0.082), (0.019, 0.085)]
    return {
        "black": join(
            block((-0.065, 0.0375, -0.075), (0.065, 0.057, 0.075), "y", 0.012),
            *(drum(0.009, 0.055, 0.089, "y", (x, 0, z), 0.002, 16) for z, x in corners),
        ),
        "red": join(*(lathe(coil, "y", (x, 0, z), 24) for z, x in corners)),
        "steel": join(drum(0.034, 0.055, 0.078, "y"), bolts(0.03, 8, 0.0575, 0.08, "y")),
    }


def ankle(side: float) -> dict[str, Mesh]:
    """Return an ankle in ankle_1's frame: foot turn about y at the origin, pitch axis `side` along z."""
    pitch = (ANKLE_RISE, ANKLE_HEIGHT, side)
    covers, rings = caps(0.034, 0.042, "z", pitch)
    cheeks = [
        bar(
            (ANKLE_RISE - 0.075, ANKLE_HEIGHT),
            (ANKLE_RISE, ANKLE_HEIGHT),
            0.037,
            low,
            low + 0.016,
            "z",
            (0, 0, side),
        )
        for low in (-0.042, 0.026)
    ]
    arms = [
        bar((0.0, 0.0), (side, 0.0), 0.042, 0.028, 0.082, "y"),  # in the plane (z, x)
        bar((side, 0.0), (side, ANKLE_RISE - 0.075), 0.04, 0.022, 0.088, "y"),
    ]
    return {
        "blue": join(*arms, *cheeks),
        "orange": join(drum(0.045, 0.004, 0.03, "y"), covers),
        "steel": join(drum(0.039, -0.003, 0.006, "y"), drum(0.03, 0.08, 0.09, "y"), rings),
    }


def cabinet_and_battery() -> dict[str, Mesh]:
    """Return what ankle_1 carries: the drives' cabinet with its cooling ribs and, below it, the battery."""
    ribs = [
        block((-0.15, 0.203, z), (-0.06, 0.2125, z + 0.006), "z", 0.003)
        for z in np.arange(-0.03, 0.18, 0.016)
    ]
    handles = [
        block((-0.235, 0.283, z - 0.035), (-0.205, 0.2865, z + 0.035), "y", 0.012) for z in (-0.1, 0.0, 0.1)
    ]
    return {
        "blue": join(
            block((-0.16, 0.04, -0.05), (-0.05, 0.205, 0.20), "z", 0.012),
            block((-0.06, 0.025, 0.045), (-0.03, 0.085, 0.105), "x", 0.01),
        ),
        "grey": join(
            block((-0.26, 0.045, -0.20), (-0.18, 0.285, 0.20), "z", 0.014),
            *(block((-0.185, 0.06, z), (-0.155, 0.19, z + 0.03), "x", 0.005) for z in (-0.04, 0.15)),
        ),
        "dark": join(
            *ribs,
            *(block((-0.262, 0.043, z), (-0.178, 0.287, z + 0.025), "z", 0.014) for z in (-0.165, 0.14)),
        ),
        "yellow": join(*handles),
    }


def legs() -> dict[str, dict[str, Mesh]]:
    """Return both legs, the knee between them, and the housing that the arm hangs from."""
    plain = tube(0.029, 0.025, LEG - 0.03, "y")
    knee = (0, LEG, 0)
    housing = [
        (0.05, -0.22),
        (0.06, -0.212),
        (0.066, -0.206),
        (0.066, -0.118),
        (0.058, -0.108),
        (0.058, -0.094),
    ]
    flange = [(0.068, -0.096), (0.07, -0.094), (0.07, -0.084), (0.068, -0.082)]
    return {
        "leg_1": {
            "grey": plain,
            "blue": join(drum(0.034, -0.025, 0.025), drum(0.04, -0.032, 0.034, at=knee)),
            "orange": drum(0.033, 0.03, 0.042, at=knee),
            "steel": drum(0.022, -0.158, -0.03, at=knee, facets=24),
        },
        "leg_2": {
            "grey": plain,
            "blue": join(drum(0.04, -0.036, 0.034), drum(0.034, -0.025, 0.025, at=knee)),
            "orange": drum(0.033, -0.044, -0.032),
        },
        "arm_base": {
            "blue": join(lathe(housing), block((-0.115, -0.055, -0.2), (-0.03, 0.055, -0.12), "y", 0.018)),
            "steel": join(lathe(flange), bolts(0.0635, 12, -0.112, -0.0955, "z")),
        },
    }


def looks() -> dict[str, dict[str, Mesh]]:
    """Return the meshes of every link by colour; both feet share theirs."""
    first = {**ankle(ANKLE_SIDE)}
    for colour, mesh in cabinet_and_battery().items():
        first[colour] = join(first[colour], mesh) if colour in first else mesh
    # The second ankle is the first, seen from its pitch axis: half a turn about z.
    second = {
        colour: Mesh(
            mesh.vertices * (-1, -1, 1) + (ANKLE_RISE, ANKLE_HEIGHT, -FOOT_SIDE), mesh.faces, process=False
        )
        for colour, mesh in ankle(FOOT_SIDE).items()
    }
    base = join(drum(0.068, -0.078, 0.066, chamfer=0.008))
    return {
        "foot": foot(), "ankle_1": first, **legs(), "ankle_2": second,
        "link_1": arm_link(0.83, 0.05, base, 0.055, "y"),
        "link_2": arm_link(1.0, 0.05, drum(0.058, -0.0335, 0.0335), 0.045, "z"),
        "link_3": arm_link(0.78, 0.047, drum(0.055, -0.0335, 0.0335), 0.045, "z"),
        **wrist_and_tool(),
    }  # fmt: skip


def build_meshes() -> dict[str, Mesh]:
    """Return every mesh under its file's name."""
    return {f"{link}_{colour}": mesh for link, colours in looks().items() for colour, mesh in colours.items()}


def visuals() -> dict[str, list[Visual]]:
    """Return what each link shows."""
    shown = {
        link: [Visual(mesh=f"{link}_{colour}", material=colour) for colour in colours]
        for link, colours in looks().items()
    }
    feet = shown.pop("foot")
    return {**shown, "foot_1": feet, "foot_2": feet}


VISUALS = visuals()
