"""A plan as the files of its directory."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from cmbot.archive.folder import claim, replace_folder, write_file
from cmbot.archive.knots import knots_npz
from cmbot.archive.places import require_free, shown_files
from cmbot.archive.plan_file import PlanFile, hashes_of, plan_record
from cmbot.archive.records import BASELINE_FILE, JOB_FILES, PLAN_FILE
from cmbot.archive.tables import samples_csv
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import given_path, validated
from cmbot.planning import Plan, require_plan


def save(
    plan: Plan, directory: str | Path, *, force: bool = False, added: Mapping[str, bytes | str] | None = None
) -> Path:
    """Write a plan directory; it appears whole or not at all.

    Parameters
    ----------
    plan : Plan
    directory : str or Path
        A new or empty folder; folders above it are made as needed.
    force : bool
        Replace the plan that is there, with its pages, plots and tracking errors; never another folder.
        Files that its ``plan.json`` does not name are not the plan's: they stay.
    added : mapping from str to bytes or str, optional
        Pages and plots that appear with it, by their names: those that the command line gives them.

    Returns
    -------
    Path
        The directory.

    Raises
    ------
    InputError
        When `plan` is no Plan, or `directory` no path.
    ArchiveError
        When something is in the way, another process is writing there, the system refuses, or the plan holds
        a number that is not finite.
    SceneError
        When a file that the scene names is missing, or Python made a scene that no scene file describes.

    Examples
    --------
    >>> folder = cmbot.save(plan, "out/triangle")
    >>> (folder / "job.csv").is_file()
    True
    """
    require_plan(plan, "cmbot.save")
    directory = given_path(directory, "cmbot.save", "directory", "the path of a new folder")
    shown = shown_files(added)
    table, knots = JOB_FILES
    contents = {table: job_table(plan, table), knots: knots_npz(plan.job.trajectory)}
    if plan.baseline is not None:
        contents[BASELINE_FILE] = samples_csv(plan.baseline.samples, BASELINE_FILE)
    record = plan_record(plan, hashes_of(plan))
    # What could not be read back is not written.
    validated(PlanFile, record, PLAN_FILE, ArchiveError)
    with claim(directory) as target:
        require_free(directory, force=force)
        replace_folder(target, PLAN_FILE, record, contents | shown)
    return directory


def export_csv(plan: Plan, path: str | Path, *, work: bool = False) -> None:
    """Write the job of a plan as a table, every 0.01 s: ``job.csv``, or the work alone in the same columns.

    Parameters
    ----------
    plan : Plan
    path : str or Path
        An earlier file of that name is replaced.
    work : bool
        From the beginning of the first stroke, time 0, to the end of the last one.

    Raises
    ------
    InputError
        When `plan` is none.
    ArchiveError
        When the file cannot be written.
    """
    require_plan(plan, "cmbot.archive.export_csv")
    target = given_path(path, "cmbot.archive.export_csv", "path", "the path of a file to write")
    write_file(target, job_table(plan, target.name, work=work))


def job_table(plan: Plan, source: str, *, work: bool = False) -> bytes:
    """Return the job of a plan as CSV, or the work alone; `source` is for messages."""
    samples, labels = plan.job_samples
    if work:
        samples, segments = plan.samples, plan.work.segments
        # A join belongs to the segment that ends there.
        numbers = np.searchsorted([segment.end for segment in segments[:-1]], samples.t)
        labels = tuple(segments[number].name for number in numbers)
    return samples_csv(samples, source, labels)
