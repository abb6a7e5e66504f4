"""A foot: where it holds what it stands on, and what it can bear."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.representation import ShortRepr
from cmbot.hold.contact import MAGNET_PRESSURE, Contact, Gap


@dataclass(frozen=True, kw_only=True, eq=False)
class Foot(ShortRepr):
    """A foot that holds a member, or a link of a robot that stands on something flat.

    Attributes
    ----------
    kind : str
        ``magnet``, ``clamp`` or ``welded``.
    centre : (3,), m
        The contact's centroid, from O0, along the axes of W.
    axes : (3, 3)
        Rows in W: along the member, across it, and out of the steel.
    contact : Contact or None
        The flat contact; None on a round bar.
    friction : float
        Between plate and steel.
    safety : float
        By which what is needed is multiplied before it is compared with what the foot can bear.
    gap : str
        ``allowed``: the plate may lift at one side until it tips; ``none``: it may not.
    adhesion : float or None, N
        That a magnet has on this steel; None: not given.
    steel : float or None, m
        Thickness of the steel under the contact, where that is known.
    force, moment : three floats or None, N and Nm
        What clamp and member bear along and across the member and out of the steel; None: not given.
    share : (6, 6)
        Takes the wrench of the whole robot to that on this foot, both about O0 in W.
    """

    kind: Literal["magnet", "clamp", "welded"]
    centre: FloatArray
    axes: FloatArray
    contact: Contact | None
    friction: float
    safety: float
    gap: Gap = "allowed"
    adhesion: float | None = None
    steel: float | None = None
    force: tuple[float, float, float] | None = None
    moment: tuple[float, float, float] | None = None
    share: FloatArray

    @property
    def bounded(self) -> bool:
        """Whether something is known of what it can bear."""
        return self.adhesion is not None or self.force is not None

    @property
    def bounds(self) -> FloatArray:
        """What it bears of a load as a clamp (6,), N and Nm; infinite where that is not given."""
        unknown = (np.inf,) * 3
        return np.array([*(self.force or unknown), *(self.moment or unknown)])

    @property
    def most_adhesion(self) -> float:
        """What no magnet on this contact exceeds, N, however thick the steel is; zero without a contact."""
        return 0.0 if self.contact is None else MAGNET_PRESSURE * self.contact.area

    @property
    def ceiling(self) -> float:
        """What no magnet on this contact exceeds, N; infinite without a contact.

        Iron is saturated at 2 T. A magnet of two poles along the member leads its flux through the steel
        between them, so on thin steel only as much of the contact pulls as two cross sections of the steel.
        """
        if self.contact is None:
            return np.inf
        area = self.contact.area
        if self.steel is not None:
            area = min(area, 2 * self.steel * self.contact.size[1])
        return MAGNET_PRESSURE * area

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
