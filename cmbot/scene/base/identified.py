"""The stiffness that was identified: a file of `cmbot identify`, and the block ``identified:`` of a scene."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from cmbot.common.arrays import FloatArray, read_only
from cmbot.common.reading.fields import Text, Vector
from cmbot.common.reading.validation import FileModel, refusal
from cmbot.scene.base.matrices import Matrix6, PositiveDefinite6

_BASE_PARAMETERS = 21

Number = Annotated[float, Field(ge=-1e6, le=1e6)]
Numbers = Annotated[tuple[Number, ...], Field(max_length=300)]


class IdentifiedSpring(FileModel):
    """A link or a joint."""

    name: Text
    modelled: Annotated[float, Field(gt=0, le=1e15)]
    """What `factor` is of, in the robot's model: E I of a link, N m2, the stiffness of a joint, Nm/rad."""
    factor: Annotated[float, Field(ge=1e-6, le=1e6)]
    """Identified stiffness over the modelled one."""


class IdentifiedBase(FileModel):
    """The base, at the origin of foot 1."""

    footholds: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=2)]
    """Points that the feet held when it was measured, foot 1 first, m."""
    stiffness: PositiveDefinite6
    """6 x 6 stiffness, linear then angular (N/m, N/rad, Nm/rad)."""
    mass: Matrix6 | None = None
    """6 x 6 mass that moves with the foot, which is not identified; left out: none."""


class IdentifiedDamping(FileModel):
    """That of the modes in records, as shares of critical damping."""

    ratio: Annotated[float, Field(gt=0, lt=1)]
    sd: Annotated[float, Field(ge=0, lt=1)]
    """Standard deviation of one mode's ratio."""


class IdentifiedMode(FileModel):
    """A natural frequency that was measured."""

    hz: Annotated[float, Field(gt=0, le=1e4)]
    hz_sd: Annotated[float, Field(ge=0, le=1e4)]
    """Its standard deviation, Hz, as stated."""
    damping: tuple[Number, Number] | None = None
    """Share of critical damping and its standard deviation; left out: not measured."""


class IdentifiedReadings(FileModel):
    """Readings of one kind."""

    kind: Literal["deflections", "frequencies"]
    count: Annotated[int, Field(ge=1, le=100_000)]
    """Number of postures with a deflection, or of frequencies."""
    residual: Annotated[float, Field(ge=0, le=1e6)] | None = None
    """Root mean square of what is left, over what the stated errors leave; left out: all was fitted."""


class MeasuredFile(FileModel):
    """What was measured, for whoever reads the file or a plan's page."""

    sheets: Annotated[tuple[Text, ...], Field(max_length=1000)]
    """Names of the files of measurements."""
    readings: Annotated[tuple[IdentifiedReadings, ...], Field(max_length=2)] = ()
    modes: Annotated[tuple[IdentifiedMode, ...], Field(max_length=4000)] = ()
    prior_sd: Annotated[tuple[Number, ...], Field(max_length=300)] = ()
    """Standard deviations before, of what the covariance is of; left out: not told."""
    sag_mm: tuple[Number, Number] | None = None
    """Root mean square of the tool's sag along the job, as modelled and as identified; left out: not told."""


class IdentifiedStiffness(FileModel):
    """Stiffness in place of the model's, and how well it is known.

    The covariance is of the logarithms of the compliances of links and joints, in the order given here, then
    of 21 numbers of the base. These are the entries on and above the diagonal, row by row, of a symmetric X.
    The base's compliance is ``L exp(X) L'``, with the lower Cholesky factor L of the identified one.
    """

    format: Literal["cmbot-stiffness/1"] = "cmbot-stiffness/1"
    links: Annotated[tuple[IdentifiedSpring, ...], Field(max_length=100)] = ()
    joints: Annotated[tuple[IdentifiedSpring, ...], Field(max_length=100)] = ()
    base: IdentifiedBase | None = None
    """Left out: the base is rigid."""
    damping: IdentifiedDamping | None = None
    """Left out, as no record of a decay was used: assumed."""
    measured: MeasuredFile | None = None
    """By what; nothing is planned by it."""
    covariance: Annotated[tuple[Numbers, ...], Field(min_length=1, max_length=300)]
    """Of what was identified, a row for each number."""

    def _check(self) -> None:
        count = len(self.links) + len(self.joints) + (0 if self.base is None else _BASE_PARAMETERS)
        rows = {len(row) for row in self.covariance}
        if len(self.covariance) != count or rows != {count}:
            got = f"{len(self.covariance)} rows of {', '.join(map(str, sorted(rows)))}"
            raise refusal(f"{count} rows of {count} numbers", got=got, key=("covariance",))
        matrix = np.array(self.covariance)
        scale = np.abs(matrix).max()
        if not np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * scale):
            raise refusal("a symmetric matrix", got="one that is not", key=("covariance",))
        if np.linalg.eigvalsh(matrix)[0] < -1e-9 * scale:
            raise refusal("a covariance", got="a matrix with negative variances", key=("covariance",))

    @property
    def springs(self) -> tuple[tuple[str, str], ...]:
        """Kind and name of what was identified beside the base, in the order of the covariance."""
        links = (("link", each.name) for each in self.links)
        return (*links, *(("joint", each.name) for each in self.joints))

    @property
    def covariance_matrix(self) -> FloatArray:
        """The covariance (p, p)."""
        return read_only(np.array(self.covariance))
