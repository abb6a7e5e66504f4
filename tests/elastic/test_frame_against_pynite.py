"""The guardrail's compliance against PyNite, another frame program."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from guardrails import guardrail, relative_difference
from numpy.typing import NDArray
from oracles.beams import angle_cantilever, angle_outline, polygon
from Pynite import FEModel3D

from cmbot.elastic import AngleSection, BarSection, Guardrail, elastic_base, shares

FloatArray = NDArray[np.float64]

LOADS = ("FX", "FY", "FZ", "MX", "MY", "MZ")
DISPLACEMENTS = ("DX", "DY", "DZ", "RX", "RY", "RZ")
YOUNG, SHEAR = 206e9, 79e9


def model() -> FEModel3D:
    made = FEModel3D()
    made.add_material("steel", YOUNG, SHEAR, 0.3, 7850.0)
    return made


def add_section(made: FEModel3D, section: AngleSection | BarSection) -> str:
    """Add a section whose local y axis is that of the larger moment, from its outline."""
    if isinstance(section, BarSection):
        d = section.diameter
        name, area, moments = f"bar {d}", math.pi * d**2 / 4, [math.pi * d**4 / 64] * 2
        torsion = math.pi * d**4 / 32
    else:
        area, _, tensor = polygon(angle_outline(section.leg, section.thickness))
        name, moments = f"angle {section.leg}", np.linalg.eigvalsh(tensor).tolist()
        torsion = area * section.thickness**2 / 3
    if name not in made.sections:
        made.add_section(name, area, moments[1], moments[0], torsion)
    return name


def compliance(made: FEModel3D, *nodes: str) -> FloatArray:
    """Compliance (6 k, 6 k) at nodes: load cases of one newton or newton metre."""
    cases = [(node, load) for node in nodes for load in LOADS]
    for node, load in cases:
        made.add_node_load(node, load, 1.0, case=f"{node} {load}")
        made.add_load_combo(f"{node} {load}", {f"{node} {load}": 1.0})
    made.analyze_linear(check_stability=False)
    return np.array(
        [
            [getattr(made.nodes[node], d)[f"{at} {load}"] for at, load in cases]
            for node in nodes
            for d in DISPLACEMENTS
        ]
    )


def support(made: FEModel3D, node: str) -> None:
    made.def_support(node, True, True, True, True, True, True)


# For members in the plane y = 0 PyNite's local y axis is W's at rotation 0, and turns about the member's own
# axis. Ours begins at the first leg, and the larger moment is about the line halfway between the legs: along
# x the leg begins at y; upwards at x, from which y is at 90 deg.
POST, RAIL = 45.0 - 90.0, 45.0  # degrees beyond the roll


@pytest.mark.parametrize("roll", [-90.0, 0.0, 35.0])
@pytest.mark.parametrize("upright", [True, False])
def test_rotation_of_sections_in_pynite(upright: bool, roll: float) -> None:
    """One cantilever, against its outline where it is: the sign of PyNite's rotation."""
    made = model()
    section = add_section(made, AngleSection(leg=0.075, thickness=0.008))
    along = (0.0, 0.0, 1.3) if upright else (1.3, 0.0, 0.0)
    made.add_node("clamp", 0, 0, 0)
    made.add_node("tip", *along)
    made.add_member("member", "clamp", "tip", "steel", section, rotation=roll + (POST if upright else RAIL))
    support(made, "clamp")
    c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    axes = [(c, s, 0), (-s, c, 0)] if upright else [(0, c, s), (0, -s, c)]
    expected = angle_cantilever(along, 0.075, 0.008, axes, YOUNG, SHEAR)
    assert relative_difference(compliance(made, "tip"), expected) < 1e-9


def pynite_compliance(found: Guardrail) -> FloatArray:
    """The guardrail in PyNite, drawn by itself: one member from joint to joint."""
    made = model()
    post = found.post
    held = [(x, z) for x, _, z in found.footholds]
    levels = sorted({post.clamp, post.top, *(rail.height for rail in found.rails), *(z for _, z in held)})
    places = sorted({*found.post_positions, *(x for x, _ in held)})

    def add(points: Sequence[tuple[float, float]], section: str, rotation: float) -> None:
        for x, z in points:
            if f"{x} {z}" not in made.nodes:
                made.add_node(f"{x} {z}", x, 0, z)
        for (x, z), (x_next, z_next) in pairwise(points):
            name = f"{len(made.members)}"
            made.add_member(name, f"{x} {z}", f"{x_next} {z_next}", "steel", section, rotation=rotation)

    for x in found.post_positions:
        add([(x, z) for z in levels], add_section(made, post.section), math.degrees(post.roll) + POST)
        support(made, f"{x} {post.clamp}")
    for rail in found.rails:
        points = [(x, rail.height) for x in places]
        add(points, add_section(made, rail.section), math.degrees(rail.roll) + RAIL)
    return compliance(made, *(f"{x} {z}" for x, z in held))


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(guardrail(), id="default"),
        pytest.param(guardrail(foot={"offset_m": 0.875}), id="foot at mid-rail"),
        pytest.param(guardrail(bays=3, foot={"post": 1}, post={"roll_deg": 25.0}), id="skewed end post"),
    ],
)
def test_all_entries_of_the_compliance(found: Guardrail) -> None:
    base = elastic_base(found)
    assert base is not None
    assert relative_difference(np.linalg.inv(base.stiffness), pynite_compliance(found)) < 1e-9


def two_feet(*points: tuple[float, float], **keys: Any) -> Guardrail:
    """A guardrail held at two points (x, z); O0 is a little before the first."""
    footholds = tuple((x, 0.0, z) for x, z in points)
    return replace(guardrail(**keys), foot_point=(points[0][0], 0.006, points[0][1]), footholds=footholds)


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(two_feet((0.0, 0.0), (0.0, -0.6)), id="one above the other on a post"),
        pytest.param(two_feet((0.0, 0.0), (0.22, -0.80)), id="post and bottom rail"),
        pytest.param(two_feet((0.4, 0.0), (1.1, -0.45), post={"roll_deg": 25.0}), id="two rails"),
    ],
)
def test_two_feet_share_a_wrench_as_in_pynite(found: Guardrail) -> None:
    """The robot joins the feet rigidly: Lagrange's multipliers are what each bears about its own point."""
    levers = [np.subtract(point, found.foot_point) for point in found.footholds]
    G = np.vstack([np.block([[np.eye(3), -skew(p)], [np.zeros((3, 3)), np.eye(3)]]) for p in levers])
    C = pynite_compliance(found)
    system = np.block([[C, -G], [G.T, np.zeros((6, 6))]])
    forces = np.linalg.solve(system, np.vstack([np.zeros((12, 6)), np.eye(6)]))[:12]
    each = [G[part].T @ forces[part] for part in (slice(0, 6), slice(6, 12))]
    scale = np.array([1.0] * 3 + [0.3] * 3)  # newtons beside newton metres, over a distance of the feet
    for got, expected in zip(shares(found), each, strict=True):
        assert np.abs((got - expected) / scale[:, None] * scale).max() < 1e-9


def skew(p: FloatArray) -> FloatArray:
    """Matrix (3, 3) of the cross product with a vector."""
    return np.array([[0, -p[2], p[1]], [p[2], 0, -p[0]], [-p[1], p[0], 0]])
