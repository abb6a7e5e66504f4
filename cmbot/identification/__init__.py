"""Identification: from deflections and natural frequencies that were measured to stiffness and its error."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cmbot.identification.design import Proposal, job_postures, propose
from cmbot.identification.estimation import Identification, estimate
from cmbot.identification.measurements import (
    Measurements,
    MeasurementsFile,
    MeasuringSetup,
    Prior,
    read_measurements,
)
from cmbot.identification.model import DeflectionModel, SagAlong, measured_arm, prior_deviations, sag_along
from cmbot.identification.report import (
    HEADINGS,
    identified_rows,
    proposal_remarks,
    remarks,
    stiffness_text,
    unseen,
)

__all__ = [
    "HEADINGS",
    "DeflectionModel",
    "Identification",
    "Measurements",
    "MeasurementsFile",
    "MeasuringSetup",
    "Prior",
    "Proposal",
    "SagAlong",
    "estimate",
    "identified_rows",
    "identify",
    "job_postures",
    "measured_arm",
    "prior_deviations",
    "proposal_remarks",
    "propose",
    "read_measurements",
    "remarks",
    "sag_along",
    "stiffness_text",
    "unseen",
]


def identify(source: str | Path | Mapping[str, Any]) -> Identification:
    """Estimate the stiffness of links, joints and base from measurements.

    Parameters
    ----------
    source : str, Path or mapping
        Path of a file of measurements, or its content.

    Returns
    -------
    Identification
        Its `stiffness` is what a scene's ``identified`` takes.

    Raises
    ------
    InputError
        When a key or value is wrong, nothing was measured or nothing bends; or as `cmbot.load_scene`.
    """
    return estimate(read_measurements(source))
