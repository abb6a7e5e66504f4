"""Jobs on the processes of dask, and their results on the disk."""

from __future__ import annotations

import importlib
import json
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from cmbot.campaign.child import run_in_child
from cmbot.campaign.job import Job, JobResult, JobStatus
from cmbot.common.errors import InputError, MissingExtra

__all__ = ["run_jobs"]

_FORMAT = "cmbot-job/1"


def run_jobs(
    jobs: Sequence[Job],
    directory: str | Path,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    fresh: bool = False,
    report: Callable[[JobResult], None] | None = None,
) -> tuple[JobResult, ...]:
    """Run jobs on several processes; each writes its result as ``NAME.json`` when it ends.

    A job whose file is there and has its key is not run again, however it ended. One that crashes or hangs
    costs itself alone.

    Parameters
    ----------
    jobs : sequence of Job
    directory : str or Path
        Of the result files; made as needed.
    workers : int
        Processes on this machine, each with one job at a time. They and their scheduler listen on 127.0.0.1.
    scheduler : str, optional
        Address of a running dask scheduler, whose workers are used instead; they see the same files.
    fresh : bool
        Run every job, whatever files are there.
    report : callable, optional
        Called with each result, as the jobs end; those that are not run come first.

    Returns
    -------
    tuple of JobResult
        In the order of `jobs`.

    Raises
    ------
    InputError
        When two jobs have the same name, or `workers` is not positive.
    ArchiveError
        When a result cannot be written.
    MissingExtra
        When jobs are to be run and dask is not installed.
    """
    directory = Path(directory)
    if twice := [name for name, number in Counter(job.name for job in jobs).items() if number > 1]:
        raise InputError("run_jobs", "jobs", f"several jobs named {twice[0]!r}", "a unique name for each")
    if not workers >= 1:
        raise InputError("run_jobs", "workers", workers, "a whole number from 1 on")
    found: dict[str, JobResult] = {}

    def ended(result: JobResult) -> None:
        found[result.name] = result
        if report is not None:
            report(result)

    left = []
    for job in jobs:
        known = None if fresh else _known(directory, job)
        if known is None:
            left.append(job)
        else:
            ended(known)
    if left:
        for result in _run(left, workers, scheduler):
            _store(directory, result)
            ended(result)
    return tuple(found[job.name] for job in jobs)


def _run(jobs: Sequence[Job], workers: int, scheduler: str | None) -> Iterator[JobResult]:
    """Yield results as the jobs end."""
    distributed = _distributed()
    with _client(distributed, min(workers, len(jobs)), scheduler) as client:
        path = [str(Path(folder).resolve()) for folder in sys.path]
        # Earlier jobs first; a worker that dies with a job is not tried again.
        futures = {
            client.submit(run_in_child, job, path, key=f"{job.name}-{job.key}", pure=False, retries=0): job
            for job in jobs
        }
        for future in distributed.as_completed(futures):
            job = futures[future]
            if future.status == "finished":
                yield future.result()
            else:
                error = f"no worker finished it ({future.exception()})"
                yield JobResult(name=job.name, key=job.key, status=JobStatus.CRASHED, error=error)


@contextmanager
def _client(distributed: Any, workers: int, scheduler: str | None) -> Iterator[Any]:
    if scheduler is not None:
        with distributed.Client(scheduler) as client:
            yield client
        return
    # Without an address the dashboard's server takes a fixed port, which a second campaign finds taken.
    local = {"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"}
    # A job's memory is its child's, which the worker does not see.
    options = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "memory_limit": 0}
    with distributed.LocalCluster(**local, **options) as cluster, distributed.Client(cluster) as client:
        yield client


def _distributed() -> Any:
    try:
        return importlib.import_module("distributed")
    except ImportError as error:
        raise MissingExtra("dask.distributed", "campaign") from error


def _known(directory: Path, job: Job) -> JobResult | None:
    """The result on the disk that has a job's key; None where there is none, or it is damaged."""
    try:
        data = json.loads((directory / f"{job.name}.json").read_text(encoding="utf-8"))
        if data.pop("format") != _FORMAT or data["key"] != job.key:
            return None
        return replace(JobResult(**data), resumed=True)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        return None


def _store(directory: Path, result: JobResult) -> None:
    # It brings the planner with it, which the jobs' processes may not need.
    from cmbot.archive import json_bytes, write_file

    data = {"format": _FORMAT, **asdict(result)}
    del data["resumed"]
    write_file(directory / f"{result.name}.json", json_bytes(data, indent=1))
