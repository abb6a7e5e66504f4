"""By what stances are ranked, and what they may not exceed."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

StanceObjective = Literal["torque", "hold", "sag", "sway"]
"""Peak of the torque on the base at work; adhesion that feet need over the job; sag of the tool; its sway on
a shaken deck."""
UNITS: dict[str, str] = {"torque": "Nm", "hold": "N", "sag": "mm", "sway": "mm per m/s2"}
"""Of the rankings."""


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """What a stance may not exceed beside its objective; each infinite where there is none.

    Attributes
    ----------
    base_torque_nm : float
        Torque on the base over the whole job.
    adhesion_n : float
        That feet need over the whole job.
    sag_mm : float
        Of the tool at work.
    sway_mm : float
        Root mean square of the tool by 1 m/s2 of the deck, `cmbot.excitation.sway_mm_per_m_s2`.
    travel_deg : float
        Of all joints together over the whole job.
    seconds : float
        Of the whole job.
    """

    base_torque_nm: float = np.inf
    adhesion_n: float = np.inf
    sag_mm: float = np.inf
    sway_mm: float = np.inf
    travel_deg: float = np.inf
    seconds: float = np.inf


@dataclass(frozen=True, kw_only=True)
class SagLimit:
    """What other stances than the scene's own may sag where the user says nothing.

    Attributes
    ----------
    most_mm : float
    source : str
        Where the figure is from, in words.
    """

    most_mm: float
    source: str


@dataclass(frozen=True, kw_only=True)
class StanceFigures:
    """What is known of a stance; None where it was not computed.

    Attributes
    ----------
    torque, job_torque : float, Nm
        Peak of the torque on the base at work, and over the job.
    adhesion, job_adhesion, stop_adhesion : float, N
        That the foot which needs most needs at work, over the job, and in an emergency stop.
    sag_mm : float
        Largest at work.
    first_hz : float
        The slowest mode at work.
    sway_mm : float
        As `Bounds` has it.
    holding_nm, holding_of_effort : float
        Largest torque that a locked joint below the arm holds over the job, and the largest share of what
        such a joint drives: beyond 1 its brake holds more than its drive.
    travel_deg, seconds : float
        Over the job.
    within_mm : float
        The distance from its path that the tool keeps, by the accuracy budget.
    """

    torque: float | None = None
    job_torque: float | None = None
    adhesion: float | None = None
    job_adhesion: float | None = None
    stop_adhesion: float | None = None
    sag_mm: float | None = None
    first_hz: float | None = None
    sway_mm: float | None = None
    holding_nm: float | None = None
    holding_of_effort: float | None = None
    travel_deg: float | None = None
    seconds: float | None = None
    within_mm: float | None = None

    def beyond(self, bounds: Bounds) -> tuple[str, float, float] | None:
        """Return the bound, by its name, that is exceeded by the largest factor, with value and bound."""
        job = {
            "base_torque_nm": self.job_torque or self.torque,
            "adhesion_n": self.job_adhesion or self.adhesion,
        }
        worst: tuple[str, float, float] | None = None
        for field in fields(bounds):
            most = float(getattr(bounds, field.name))
            value = job.get(field.name, getattr(self, field.name, None))
            if value is not None and value > most and (worst is None or value * worst[2] > worst[1] * most):
                worst = field.name, float(value), most
        return worst


NO_BOUNDS, NO_FIGURES = Bounds(), StanceFigures()


@dataclass(frozen=True, kw_only=True)
class Column:
    """How a figure of a stance is told.

    Attributes
    ----------
    name : str
        Of `StanceFigures`.
    words, unit : str
    factor : float
        From SI to the unit.
    form : str
        As of `format`.
    """

    name: str
    words: str
    unit: str
    factor: float = 1.0
    form: str = ".2f"

    def told(self, figures: StanceFigures) -> str | None:
        """Return the figure without its unit; None where it was not computed."""
        value = getattr(figures, self.name)
        return None if value is None else format(self.factor * value, self.form)


COLUMNS = (
    Column(name="torque", words="torque", unit="Nm", form=".1f"),
    Column(name="job_torque", words="over the job", unit="Nm", form=".1f"),
    Column(name="adhesion", words="adhesion needed", unit="kN", factor=1e-3),
    Column(name="job_adhesion", words="over the job", unit="kN", factor=1e-3),
    Column(name="stop_adhesion", words="in an emergency stop", unit="kN", factor=1e-3),
    Column(name="sag_mm", words="sag", unit="mm"),
    Column(name="first_hz", words="first mode", unit="Hz"),
    Column(name="sway_mm", words="sway", unit="mm per m/s2"),
    Column(name="holding_nm", words="locked joints hold", unit="Nm", form=".0f"),
    Column(name="holding_of_effort", words="of what they drive", unit="%", factor=100.0, form=".0f"),
    Column(name="within_mm", words="tool within", unit="mm", form=".1f"),
)
"""Of a planned stance, the most important first."""
