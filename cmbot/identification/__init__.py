"""Identification: from deflections and natural frequencies that were measured to stiffness and its error."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from cmbot.common.reading.yaml_reader import lines_named
from cmbot.identification.deflection_table import read_deflections
from cmbot.identification.design import Proposal, job_postures, propose, require_axes
from cmbot.identification.estimation import Identification, Weight, estimate
from cmbot.identification.location import (
    Location,
    features_to_touch,
    locate,
    located,
    location_remarks,
    placement_of,
)
from cmbot.identification.measurements import (
    Measurements,
    MeasurementsFile,
    MeasuringSetup,
    Prior,
    is_sheet,
    read_measurements,
)
from cmbot.identification.misfit import Part, Slip
from cmbot.identification.model import DeflectionModel, SagAlong, measured_arm, prior_deviations, sag_along
from cmbot.identification.report import (
    HEADINGS,
    identified_rows,
    proposal_remarks,
    remarks,
    require_fit,
    stiffness_text,
    unseen,
)
from cmbot.identification.touches import Feature, Touches, TouchSetup, frame_of, read_touches

__all__ = [
    "HEADINGS",
    "DeflectionModel",
    "Feature",
    "Identification",
    "Location",
    "Measurements",
    "MeasurementsFile",
    "MeasuringSetup",
    "Part",
    "Prior",
    "Proposal",
    "SagAlong",
    "Slip",
    "TouchSetup",
    "Touches",
    "Weight",
    "estimate",
    "features_to_touch",
    "frame_of",
    "identified_rows",
    "identify",
    "is_sheet",
    "job_postures",
    "locate",
    "located",
    "location_remarks",
    "measured_arm",
    "placement_of",
    "prior_deviations",
    "proposal_remarks",
    "propose",
    "read_deflections",
    "read_measurements",
    "read_touches",
    "remarks",
    "require_axes",
    "require_fit",
    "sag_along",
    "stiffness_text",
    "unseen",
]


def identify(*sources: str | Path | Mapping[str, Any], accept_misfit: bool = False) -> Identification:
    """Estimate the stiffness of links, joints and base from measurements.

    Parameters
    ----------
    *sources : str, Path or mapping
        Paths of files of measurements, of one robot in one place, or their contents.
    accept_misfit : bool
        Use measurements that plainly do not fit, with errors that are larger.

    Returns
    -------
    Identification
        Its `stiffness` is what a scene's ``identified`` takes.

    Raises
    ------
    InputError
        When a key or value is wrong, nothing was measured or nothing bends; when measurements plainly do not
        fit; or as `cmbot.load_scene`.

    Examples
    --------
    >>> found = cmbot.identify("measurements.yaml")  # doctest: +SKIP
    >>> found.stiffness  # what a scene takes as ``identified``  # doctest: +SKIP
    """
    found = estimate([read_measurements(source) for source in sources])
    if not accept_misfit:
        with ExitStack() as lines:
            for source in sources:
                if not isinstance(source, Mapping):
                    lines.enter_context(lines_named(source))
            require_fit(found)
    return found
