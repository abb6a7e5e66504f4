"""A campaign: many scenes planned on several processes, and a table of their results."""

from __future__ import annotations

import json
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from cmbot.archive import PLAN_FILE, claim, json_bytes, write_file
from cmbot.campaigns.campaign_file import CampaignFile, Entry, read_campaign
from cmbot.campaigns.overview import overview_page
from cmbot.campaigns.planned import PLAN_SCENE
from cmbot.campaigns.results import given_cells, parquet, plan_place, require_pyarrow, result_row
from cmbot.campaigns.runner import require_dask, task_results
from cmbot.campaigns.task import Task, TaskResult
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.reading.validation import given_path, plain, shown
from cmbot.common.representation import ShortRepr
from cmbot.planning import robot_of
from cmbot.scene import RobotFile, Scene, Stance
from cmbot.version import versions
from cmbot.views import REPORT

OVERVIEW, RESULTS, _MARK, _TASKS = "index.html", "results.parquet", "campaign.json", "jobs"
_RESULT_FORMAT = "cmbot-campaign-result/1"
_MAX_ATTEMPTS = 2


@dataclass(frozen=True, kw_only=True)
class CampaignProgress:
    """How far a campaign is.

    Attributes
    ----------
    done, total : int
        Jobs; those that were up to date count as done.
    resumed : int
        Of those done, the ones that were up to date.
    ends : mapping of str to int
        How many ended how.
    """

    done: int
    total: int
    resumed: int
    ends: Mapping[str, int]


@dataclass(frozen=True, kw_only=True)
class Campaign(ShortRepr):
    """What a campaign came to.

    Attributes
    ----------
    name : str
    directory : Path
        With ``results.parquet``, ``index.html`` and the plan directories.
    rows : tuple of mapping
        A row for each job, as in the table: ``name``, ``ended``, ``reason``, ``plan``, figures.
    kept : Counter of str
        How many results of earlier calls were kept, by how they had ended.
    seconds : float, s
        Wall time of this call.
    """

    name: str
    directory: Path
    rows: tuple[Mapping[str, Any], ...]
    kept: Counter[str]
    seconds: float

    @property
    def ends(self) -> Counter[str]:
        """How many jobs ended how, the most frequent first."""
        return Counter(dict(Counter(str(row["ended"]) for row in self.rows).most_common()))


def campaign(
    file: str | Path,
    output: str | Path | None = None,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    security: object | None = None,
    pages: bool = False,
    again: bool = False,
    progress: Callable[[CampaignProgress], None] | None = None,
) -> Campaign:
    """Plan many scenes; go on where an earlier call stopped.

    A job whose scene, robot and versions are those of its result is not planned again, however it ended. One
    that crashes, hangs or finds no memory costs itself alone; it is tried twice, and again with other limits.
    When the call is interrupted, the table has the jobs that have ended.

    Parameters
    ----------
    file : str or Path
        A campaign file, a CSV table of jobs, or a folder of scene files.
    output : str or Path, optional
        The campaign's folder; left out: ``out/NAME``.
    workers : int
        Processes on this machine.
    scheduler : str, optional
        Address of a dask scheduler, whose workers are used instead; they see the same files.
    security : distributed.Security, optional
        How that scheduler is spoken to; left out: as dask is configured.
    pages : bool
        Write replay and report of every plan; one without them is planned again.
    again : bool
        Plan those again that were not planned.
    progress : callable, optional
        Called with a `CampaignProgress` as jobs end.

    Raises
    ------
    InputError
        When the campaign, a scene or a robot in it is wrong, or an argument: nothing is planned then.
    ArchiveError
        When the folder holds another campaign or something else, another process is writing there, or the
        system refuses.
    MissingExtra
        When dask or pyarrow is not installed.

    Examples
    --------
    >>> done = cmbot.campaign("bridge.yaml", "out/bridge", workers=2)  # doctest: +SKIP
    >>> dict(done.ends)  # doctest: +SKIP
    {'planned': 58, 'no plan': 2}
    """
    begin = time.perf_counter()
    _require_arguments(workers, scheduler)
    given, entries = read_campaign(file)
    name = str(given.name)
    directory = Path("out") / name if output is None else given_path(output, "campaign", "output", "a folder")
    rows = dict[str, dict[str, Any]]()

    def noted() -> Iterator[Entry]:
        for entry in entries:
            rows[entry.name] = given_cells(entry)
            yield entry

    tasks = deque(_tasks(given, noted(), directory, pages=pages))
    require_dask()
    require_pyarrow()
    ends, kept = Counter[str](), Counter[str]()
    with claim(directory):
        _require_own(directory, name)
        write_file(directory / _MARK, json_bytes({"format": _RESULT_FORMAT, "name": name}))
        results = task_results(
            # Those that have ended are not held.
            (tasks.popleft() for _ in range(len(tasks))),
            directory / _TASKS,
            workers=workers,
            scheduler=scheduler,
            security=security,
            attempts=_MAX_ATTEMPTS,
            accept=partial(_is_whole, directory=directory, pages=pages, again=again),
        )
        try:
            with closing(results):
                for result in results:
                    row = result_row(rows[result.name], result, plan_place(result.name))
                    rows[result.name] = row
                    ends[row["ended"]] += 1
                    kept[row["ended"]] += result.resumed
                    if progress is not None:
                        done, resumed = ends.total(), kept.total()
                        progress(
                            CampaignProgress(done=done, total=len(rows), resumed=resumed, ends=dict(ends))
                        )
        except (KeyboardInterrupt, SystemExit):
            # Those that are kept come first: before anything new the table may be of more than has been read.
            if ends.total() > kept.total():
                _write(directory, name, [row for row in rows.values() if "ended" in row])
            raise
        found = tuple(rows.values())
        _write(directory, name, found)
    seconds = time.perf_counter() - begin
    return Campaign(name=name, directory=directory, rows=found, kept=+kept, seconds=seconds)


def _write(directory: Path, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    write_file(directory / RESULTS, parquet(rows))
    write_file(directory / OVERVIEW, overview_page(name, rows, directory).encode())


def _require_arguments(workers: object, scheduler: object) -> None:
    if not (isinstance(workers, int) and workers >= 1):
        raise InputError("cmbot.campaign", "workers", shown(workers), "a whole number from 1 on")
    if not (scheduler is None or isinstance(scheduler, str)):
        expected = "the address of a dask scheduler, tcp://HOST:PORT, or None"
        raise InputError("cmbot.campaign", "scheduler", shown(scheduler), expected)


def _tasks(given: CampaignFile, entries: Iterable[Entry], directory: Path, *, pages: bool) -> Iterator[Task]:
    known = {name: version for name, version in versions().items() if name != "python"}
    robots = _Robots()
    for entry in entries:
        yield Task(
            name=entry.name,
            function=PLAN_SCENE,
            # As text a scene takes a tenth of the memory: all jobs of the campaign wait at once.
            arguments={"scene": json.dumps(plain(entry.scene, entry.scene.source))},
            unkeyed={"directory": str(directory.resolve() / plan_place(entry.name)), "pages": pages},
            inputs={**known, "scene": entry.scene.content_hash, "robot": robots.hash_of(entry.scene)},
            time_limit=given.time_limit_s,
            memory_limit=given.memory_limit_mb * 1_000_000,
        )


class _Robots:
    """Hashes of robots, each loaded once."""

    def __init__(self) -> None:
        self._hashes = dict[tuple[RobotFile, Stance | None], str]()

    def hash_of(self, scene: Scene) -> str:
        # What it carries is in no file of the robot's; jobs often differ in it.
        empty = scene.robot.changed(payload_kg=0.0), scene.stance
        if empty not in self._hashes:
            self._hashes[empty] = robot_of(scene).content_hash
        return self._hashes[empty]


def _require_own(directory: Path, name: str) -> None:
    """Refuse a folder that holds something else than the campaign of this name."""
    mark = directory / _MARK
    if not mark.is_file():
        if directory.is_dir() and any(directory.iterdir()):
            expected = "a new folder, or that of a campaign, which goes on"
            raise ArchiveError(str(directory), "", "a folder with other files in it", expected)
        return
    try:
        found = json.loads(mark.read_text(encoding="utf-8"))["name"]
    except (OSError, ValueError, LookupError, TypeError):
        found = None
    if found != name:
        expected = f"{name!r}, whose results these would replace: take another folder"
        raise ArchiveError(str(mark), "name", shown(found), expected)


def _is_whole(result: TaskResult, directory: Path, *, pages: bool, again: bool) -> bool:
    """Whether a result of an earlier call holds: its plan is there, or it has none and that is taken."""
    planned = isinstance(result.value, dict) and result.value.get("ended") == "planned"
    needed = (PLAN_FILE, REPORT) if pages else (PLAN_FILE,)
    place = directory / plan_place(result.name)
    return all((place / name).is_file() for name in needed) if planned else not again
