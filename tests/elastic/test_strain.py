"""Strains against the closed forms of beams, and against the energy that the beams store."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from elastic_robots import YOUNG, cantilever, make_arm, random_robot, second_moment
from guardrails import guardrail
from oracles.beams import angle_outline, polygon
from scipy.spatial.transform import Rotation

from cmbot.elastic.base import guardrail_frame, motion_of_feet
from cmbot.elastic.beam import beam_stiffness, beam_strain
from cmbot.elastic.strain import frame_strains, tube_strains

STEEL = 206e9


def test_the_strains_store_the_energy_of_the_beam(rng: np.random.Generator) -> None:
    """K = ∫ Bᵀ diag(E A, E I_z, E I_y) B dx and the twist; B is linear, so Simpson's rule is exact."""
    R, L = Rotation.random(5, rng=rng).as_matrix(), rng.uniform(0.1, 2.0, 5)
    axial, bend_y, bend_z = rng.uniform(1.0, 9.0, (3, 5))
    B = beam_strain(R, L)
    rigidity = np.stack([axial, bend_z, bend_y], axis=1)
    total = np.zeros((5, 12, 12))
    for share, weight in ((0.0, 1 / 6), (0.5, 4 / 6), (1.0, 1 / 6)):
        at = (1 - share) * B[:, 0] + share * B[:, 1]
        total += weight * L[:, None, None] * np.einsum("mci,mc,mcj->mij", at, rigidity, at)
    np.testing.assert_allclose(total, beam_stiffness(R, L, axial, 0 * L, bend_y, bend_z), atol=1e-9)


@pytest.mark.parametrize("roll", [0.0, 30.0, 250.0])
def test_a_loaded_post_is_a_cantilever(roll: float) -> None:
    """Of angle steel, so it bends aside from its load: the strain at each corner from Navier's formula."""
    rail = guardrail(rails=(), post={"roll_deg": roll, "top_m": 0.3})
    frame, (foot,) = guardrail_frame(rail)
    strains = frame_strains(frame, frame.shapes(foot) @ motion_of_feet(rail))
    wrench = np.array([300.0, -200.0, -900.0, 150.0, 80.0, 0.0])
    u = frame.compliance(foot) @ wrench

    outline = angle_outline(0.075, 0.008)
    area, centroid, moments = polygon(outline)
    c, s = math.cos(math.radians(roll)), math.sin(math.radians(roll))
    corners = (outline - centroid) @ np.array([[c, s], [-s, c]])  # x and y in W
    moments = np.array([[c, -s], [s, c]]) @ moments @ np.array([[c, s], [-s, c]])

    def largest(z: float) -> float:
        """At a height below the foot, which is at z = 0: the forces' moment grows with the lever."""
        if z > 0:
            return 0.0
        moment = np.array([wrench[3] + z * wrench[1], wrench[4] - z * wrench[0]])
        # A moment about x pulls where y is positive, one about y where x is negative.
        pull = np.linalg.solve(moments, np.array([-moment[1], moment[0]]))
        return float(np.abs(wrench[2] / area + corners @ pull).max()) / STEEL

    found = strains.largest(u[None])[0]
    for member, ends in zip(frame.members, found, strict=True):
        heights = frame.nodes[[member.start, member.end], 2]
        beyond = heights.max() > 1e-9  # the piece above the foot bears nothing
        expected = [0.0 if beyond else largest(z) for z in heights]
        np.testing.assert_allclose(ends, expected, rtol=1e-6, atol=1e-12)
    assert found.max() == pytest.approx(largest(-1.05), rel=1e-6)


@pytest.mark.parametrize("segments", [1, 3])
def test_a_loaded_link_is_a_cantilever(tmp_path: Path, segments: int) -> None:
    L, (force_y, force_z), (moment_y, moment_z) = 0.7, (30.0, -50.0), (4.0, 9.0)
    arm = make_arm(cantilever(tmp_path, length=L, mass=1.0), segments=segments)
    strains = tube_strains(arm)
    # By equilibrium every segment bears the force at the tip, and in its middle a moment.
    u = np.zeros(len(arm.elastic))
    for number in range(segments):
        lever = L * (1 - (number + 0.5) / segments)
        loads = np.array([force_y, force_z, 0.0, moment_y - lever * force_z, moment_z + lever * force_y])
        at = slice(5 * number, 5 * number + 5)
        # The first axis of the tube is x; the others may be turned about it.
        R = arm.model.jointPlacements[1 + 5 * number + 1].rotation
        turned = np.concatenate([R.T @ [0, *loads[:2]], R.T @ [0, *loads[3:]]])[[1, 2, 4, 5]]
        u[at] = np.linalg.solve(arm.stiffness[at, at], np.array([*turned[:2], 0.0, *turned[2:]]))
    levers = L * (1 - np.arange(segments + 1) / segments)
    moments = np.hypot(moment_y - levers * force_z, moment_z + levers * force_y)
    expected = moments * 0.03 / (YOUNG * second_moment())
    found = strains.largest(u[None])[0]
    np.testing.assert_allclose(found[:, 0], expected[:-1], rtol=1e-9)
    np.testing.assert_allclose(found[:, 1], expected[1:], rtol=1e-9)


def test_the_strains_of_links_store_the_energy_of_their_springs(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    arm = make_arm(random_robot(tmp_path, rng, 5), segments=2)
    strains, u = tube_strains(arm), rng.normal(size=len(arm.elastic))
    u[2::5] = 0.0  # no twist
    B = np.einsum("meck,mk->mec", strains.rows, u[strains.first[:, None] + np.arange(5)])
    tubes = [tube for tube in arm.robot.elasticity.values() for _ in range(2)]
    stored = 0.0
    for tube, (start, end) in zip(tubes, B, strict=True):
        EI, L = tube.young * tube.second_moment, tube.length / 2
        middle = (start + end) / 2
        stored += EI * L / 6 * (start @ start + 4 * middle @ middle + end @ end)
    assert stored == pytest.approx(u @ arm.stiffness @ u, rel=1e-9)
