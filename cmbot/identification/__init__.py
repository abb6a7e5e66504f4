"""Identification: from deflections and natural frequencies that were measured to stiffness and its error."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from cmbot.common.reading.yaml_reader import lines_named
from cmbot.identification.deflection_table import read_deflections as read_deflections
from cmbot.identification.design import (
    Proposal as Proposal,
    job_postures as job_postures,
    propose as propose,
    require_axes as require_axes,
)
from cmbot.identification.estimation import (
    Identification as Identification,
    Part as Part,
    Slip as Slip,
    estimate as estimate,
)
from cmbot.identification.location import (
    Location as Location,
    features_to_touch as features_to_touch,
    locate as locate,
    located as located,
    location_remarks as location_remarks,
    placement_of as placement_of,
)
from cmbot.identification.measurements import (
    Measurements as Measurements,
    MeasuringSetup as MeasuringSetup,
    is_sheet as is_sheet,
    read_measurements as read_measurements,
)
from cmbot.identification.model import (
    DeflectionModel as DeflectionModel,
    SagAlong as SagAlong,
    measured_arm as measured_arm,
    prior_deviations as prior_deviations,
    sag_along as sag_along,
)
from cmbot.identification.report import (
    HEADINGS as HEADINGS,
    MODE_HEADINGS as MODE_HEADINGS,
    identified_rows as identified_rows,
    is_unseen as is_unseen,
    mode_rows as mode_rows,
    proposal_remarks as proposal_remarks,
    remarks as remarks,
    require_fit as require_fit,
    stiffness_rows as stiffness_rows,
    stiffness_text as stiffness_text,
    unseen as unseen,
)
from cmbot.identification.touches import (
    Feature as Feature,
    Touches as Touches,
    TouchSetup as TouchSetup,
    frame_of as frame_of,
    read_touches as read_touches,
)


def identify(
    *sources: str | Path | Mapping[str, Any] | Measurements, accept_misfit: bool = False
) -> Identification:
    """Estimate the stiffness of links, joints and base from measurements.

    Parameters
    ----------
    *sources : str, Path, mapping or Measurements
        Paths of files of measurements, of one robot in one place, their contents, or what `read_deflections`
        read.
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
    found = estimate(
        [source if isinstance(source, Measurements) else read_measurements(source) for source in sources]
    )
    if not accept_misfit:
        with ExitStack() as lines:
            for source in sources:
                if isinstance(source, str | Path):
                    lines.enter_context(lines_named(source))
            require_fit(found)
    return found
