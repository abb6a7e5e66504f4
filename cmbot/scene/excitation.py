"""What shakes the arm, as a scene file says it: the deck, trains over it, wind; and a damper against it."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.reading.fields import Angle, Coordinate, FilePath, Length, OneOf, Text
from cmbot.common.reading.validation import FileModel, refusal
from cmbot.scene.files import AxlesName

Hertz = Annotated[float, Field(gt=0, le=1000)]
Density = Annotated[float, Field(ge=0, le=1e6)]
Ratio = Annotated[float, Field(gt=0, lt=1)]
Speed = Annotated[float, Field(ge=1, le=600)]
Minute = Annotated[float, Field(ge=0, lt=60)]
Amount = Annotated[float, Field(ge=-1e4, le=1e4)]
Shape = tuple[Amount, Amount, Amount, Amount, Amount, Amount]

_WORST_CONDITION = 1e8


class SpanFile(FileModel):
    """The span of a bridge: a simply supported beam."""

    length_m: Length
    """m."""
    first_hz: Hertz
    """Its first natural frequency, Hz, loaded as it is between trains."""
    mass_t_m: Annotated[float, Field(gt=0, le=1000)]
    """Mass of the deck, t/m."""
    damping: Ratio
    """Ratio of its modes."""
    at_m: Coordinate
    """Where the robot stands, from the bearing at which trains come on, m."""

    def _check(self) -> None:
        if not 0 <= self.at_m <= self.length_m:
            raise refusal("a place on the span, 0 to length_m", got=self.at_m, key=("at_m",))


class TrainsFile(FileModel):
    """Trains over a span, one after the other, at each of some speeds."""

    axles: AxlesName
    """``freight``, ``emu``, ``hslm_a1`` to ``hslm_a10``, or the path of a CSV file with the columns
    ``at_m,load_kn``: each axle's distance behind the first one, and its load."""
    speeds_km_h: Annotated[tuple[Speed, ...], Field(min_length=1, max_length=100)]
    """Speeds, km/h, each of which has a row in the table."""
    span: SpanFile
    per_hour: Annotated[float, Field(ge=0, le=60)] | None = None
    """How many trains pass in an hour; left out: 4."""
    minutes: Annotated[tuple[Minute, ...], Field(min_length=1, max_length=60)] | None = None
    """In place of ``per_hour``: when they come, minutes past each hour."""

    def _check(self) -> None:
        if self.minutes is not None and self.per_hour is not None:
            raise refusal("per_hour or minutes", got="both", key=("minutes",))


class DeckFile(OneOf):
    """What the deck under the robot does: exactly one of record, spectrum and trains."""

    one_of = ("record", "spectrum", "trains")

    record: FilePath | None = None
    """Path of a CSV file with the columns ``t,ax,ay,az``: times, s, and accelerations in W, m/s2."""
    spectrum: (
        Annotated[tuple[tuple[Hertz, Density, Density, Density], ...], Field(min_length=2, max_length=10_000)]
        | None
    ) = None
    """Rows of a frequency, Hz, and the one-sided spectral densities of the accelerations along x, y and z,
    (m/s2)^2/Hz; linear in between, nothing outside."""
    trains: TrainsFile | None = None

    def _check(self) -> None:
        super()._check()
        for before, after in pairwise(self.spectrum or ()):
            if not before[0] < after[0]:
                got = f"{after[0]:g} Hz after {before[0]:g} Hz"
                raise refusal("rows in the order of their frequencies", got=got, key=("spectrum",))


class WindFile(FileModel):
    """Wind on the links."""

    mean_m_s: Annotated[float, Field(ge=0, le=60)]
    """Mean speed, m/s."""
    gusts_m_s: Annotated[float, Field(ge=0, le=30)] = 0.0
    """Standard deviation of the speed, m/s."""
    from_deg: Angle = 90.0
    """From where it blows, about z from the x axis of W: at 90 from +y."""


class PassingFile(FileModel):
    """Pressure of passing trains on the links: those of ``deck.trains``."""

    distance_m: Annotated[float, Field(ge=2.3, le=100)]
    """From the axis of the track to the arm, m."""
    shape: Literal["freight", "smooth", "streamlined"] = "freight"
    """Of the trains: EN 1991-2, 6.6.2."""


class ExcitationFile(FileModel):
    """What shakes the arm."""

    deck: DeckFile | None = None
    wind: WindFile | None = None
    passing: PassingFile | None = None
    damping: Ratio | None = None
    """Ratio of every mode of the arm; left out: as identified, otherwise 0.01."""

    def _check(self) -> None:
        if self.deck is None and self.wind is None:
            raise refusal("deck or wind", got="neither")
        if self.passing is not None and (self.deck is None or self.deck.trains is None):
            raise refusal("no such key without deck.trains", got="passing", key=("passing",))


class DamperFile(FileModel):
    """A tuned damper: a mass on springs that are alike in all directions."""

    mass_kg: Annotated[float, Field(gt=0, le=1000)] = 1.0
    """Its mass, kg."""
    at: Text = "tool"
    """Where it is: ``tool``, ``arm_base``, or the name of a joint, which it is at."""
    frequency_hz: Hertz | None = None
    """Of the mass on its springs, Hz; left out: the best."""
    damping: Ratio | None = None
    """Its ratio; left out: the best."""


class ModesFile(FileModel):
    """What the robot stands on, by six natural modes without the robot.

    They are those of a modal test, or of a finite-element model, and take the place of the guardrail's
    stiffness and mass.
    """

    frequencies_hz: tuple[Hertz, Hertz, Hertz, Hertz, Hertz, Hertz]
    """Hz."""
    damping: tuple[Ratio, Ratio, Ratio, Ratio, Ratio, Ratio]
    """Ratios."""
    shapes: tuple[Shape, Shape, Shape, Shape, Shape, Shape]
    """A row for each mode: displacement along x, y, z and rotation about them at the foot, m and rad, at a
    modal mass of 1 kg m2."""

    def _check(self) -> None:
        # Rotations are taken in metres, at a lever of one.
        if np.linalg.cond(np.array(self.shapes)) > _WORST_CONDITION:
            raise refusal("six shapes that are independent", got="dependent ones", key=("shapes",))

    def matrices(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return stiffness, mass and damping (6, 6) at the foot, linear then angular, SI."""
        rows, w = np.linalg.inv(np.array(self.shapes).T), 2 * np.pi * np.array(self.frequencies_hz)
        made = (w**2, np.ones(6), 2 * np.array(self.damping) * w)
        stiffness, mass, damping = (read_only(rows.T @ (values[:, None] * rows)) for values in made)
        return stiffness, mass, damping
