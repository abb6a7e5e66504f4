"""A foot on a member of the guardrail: where it holds, and what it can bear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import short_repr


def mean_distance(half_along: float, half_across: float) -> float:
    """Return the mean distance of a rectangle's points from its centre, m.

    Parameters
    ----------
    half_along, half_across : float, m
        Half of its sides.

    Notes
    -----
    With a and b the halves and d its half diagonal,
    ``(d + a^2 / (2 b) ln((b + d) / a) + b^2 / (2 a) ln((a + d) / b)) / 3``.
    """
    a, b = half_along, half_across
    d = float(np.hypot(a, b))
    return float((d + a**2 / (2 * b) * np.log((b + d) / a) + b**2 / (2 * a) * np.log((a + d) / b)) / 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Foot:
    """A foot that holds a member.

    Attributes
    ----------
    kind : str
        ``magnet``, ``clamp`` or ``welded``.
    centre : (3,), m
        Of the contact, from O0, along the axes of W.
    axes : (3, 3)
        Rows in W: along the member, across it, and out of the steel.
    half : two floats or None, m
        Half of the flat contact along and across the member; None on a round bar.
    friction : float
        Between plate and steel.
    safety : float
        By which what is needed is multiplied before it is compared with what the foot can bear.
    adhesion : float or None, N
        That a magnet has; None: not given.
    force, moment : three floats or None, N and Nm
        What a clamp bears along and across the member and out of the steel; None: not given.
    share : (6, 6)
        Takes the wrench of the whole robot to that on this foot, both about O0 in W.
    """

    kind: Literal["magnet", "clamp", "welded"]
    centre: FloatArray
    axes: FloatArray
    half: tuple[float, float] | None
    friction: float
    safety: float
    adhesion: float | None = None
    force: tuple[float, float, float] | None = None
    moment: tuple[float, float, float] | None = None
    share: FloatArray

    __repr__ = short_repr

    @property
    def bounded(self) -> bool:
        """Whether something is known of what it can bear."""
        return self.adhesion is not None or self.force is not None

    @cached_property
    def radius(self) -> float | None:
        """Mean distance of the contact's points from its centre, m; None without a flat contact."""
        return None if self.half is None else mean_distance(*self.half)

    @cached_property
    def from_wrench(self) -> FloatArray:
        """Takes the wrench of the whole robot (force, torque about O0 in W) to this foot's load, (6, 6).

        The load is the force along the member, across it and out of the steel, N, and the moments about these
        axes through the contact's centre, Nm.
        """
        x, y, z = self.centre
        # The moment about another point is n_0 - p x f.
        lever = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
        to_centre = np.block([[np.eye(3), np.zeros((3, 3))], [lever, np.eye(3)]])
        turned = np.kron(np.eye(2), self.axes)
        return np.asarray(turned @ to_centre @ self.share)
