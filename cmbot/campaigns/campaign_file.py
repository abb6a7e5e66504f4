"""What a campaign plans: variants of a scene in a table, each scene of a folder, or both."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cmbot.campaigns.task import require_task_name
from cmbot.common.errors import InputError, SceneError
from cmbot.common.input_files import read_csv
from cmbot.common.validation import FileModel, given_path, refusal, shown, validated
from cmbot.common.yaml_reader import lines_named, read_yaml, yaml_value
from cmbot.scene import Scene, changed_content, is_within, scene_from_data, scene_path

__all__ = ["CampaignFile", "Entry", "EntryFile", "read_campaign"]

_LARGEST_TABLE = 100_000_000
_MOST_ENTRIES = 1_000_000
# Columns of a table that are no keys of a scene.
_OWN_COLUMNS = ("name", "at_m", "scene")

_Text = Annotated[str, Field(min_length=1, max_length=1000)]
_Values = dict[_Text, Any]


class EntryFile(FileModel):
    """A job of a campaign: a variant of a scene."""

    name: _Text
    """Of the job and of its plan directory."""
    at_m: float | None = None
    """Where it is along the rail, m: its place on the map."""
    scene: _Text | None = None
    """In place of the campaign's scene."""
    set: _Values = Field(default_factory=dict)
    """Values by the keys of the scene file, such as ``robot.payload_kg`` or ``tool_path.legs[0].by``."""


class CampaignFile(FileModel):
    """Many jobs: a scene with what varies in it. Paths are relative to the file."""

    format: Literal["cmbot-campaign/1"]
    name: _Text | None = None
    """Of the campaign and of its folder; left out: the file's name."""
    scene: _Text | None = None
    """A scene file or the name of a shipped scene, of which the jobs are variants."""
    set: _Values = Field(default_factory=dict)
    """What all jobs set in the scene, before their own."""
    jobs: tuple[EntryFile, ...] = ()
    table: _Text | None = None
    """A CSV file of further jobs: columns ``name``, ``at_m``, ``scene`` and keys of the scene file."""
    folder: _Text | None = None
    """A folder whose scene files (``*.yaml``) are further jobs."""
    time_limit_s: Annotated[float, Field(gt=0, le=86400)] = 300.0
    """Wall time of a job, after which its process is killed."""
    memory_limit_mb: Annotated[int, Field(ge=500, le=1_000_000)] = 4000
    """Address space of a job's process."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.jobs and self.table is None and self.folder is None:
            raise refusal("one of jobs, table and folder", got="none of them")
        return self


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A job of a campaign.

    Attributes
    ----------
    name : str
    scene : Scene
        Named after the entry.
    at_m : float or None, m
        Along the rail.
    values : mapping
        What it sets in the campaign's scene, by key.
    """

    name: str
    scene: Scene
    at_m: float | None
    values: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class _Source:
    """Where an entry stands: in a list of a file, or in a line of a table."""

    file: str
    prefix: str = ""
    line: int | None = None

    def error(self, error: InputError, values: Iterable[str] = ()) -> InputError:
        """An error about an entry, named by where that stands; `values` are the keys that it sets."""
        key = f"{self.prefix}{error.key}"
        if isinstance(error, SceneError) and self.prefix:
            within = is_within(error.key, values)
            key = f"{self.prefix}set.{error.key}" if within else f"{self.prefix}scene: {error.key}"
        return type(error)(self.file, key, error.got, error.expected, error.choices, line=self.line)


def read_campaign(path: str | Path) -> tuple[CampaignFile, Iterator[Entry]]:
    """Read a campaign; its entries are read and checked one after the other, as they are asked for.

    Parameters
    ----------
    path : str or Path
        A campaign file, a CSV table with a column ``scene``, or a folder of scene files.

    Raises
    ------
    InputError
        For the first thing that is wrong; a `SceneError` where that is a job's scene.
    """
    kind = "a campaign file, a CSV table or a folder of scenes"
    path = given_path(path, "cmbot.campaign", "file", kind)
    if path.is_dir():
        file = CampaignFile(format="cmbot-campaign/1", name=path.resolve().name, folder=str(path.resolve()))
    elif path.suffix.lower() == ".csv":
        file = CampaignFile(format="cmbot-campaign/1", name=path.stem, table=str(path.resolve()))
    else:
        with lines_named(path):
            file = validated(CampaignFile, read_yaml(path, InputError, kind), str(path), InputError)
        file = file.model_copy(update={"name": file.name or path.stem})
    with lines_named(path):
        require_task_name(str(file.name), str(path), "name")
    return file, _entries(file, path)


def _entries(file: CampaignFile, path: Path) -> Iterator[Entry]:
    folder = path if path.is_dir() else path.parent
    templates = _Templates(folder, str(path))
    seen = set[str]()
    with lines_named(path):
        for given, source in _given(file, path, folder):
            if len(seen) == _MOST_ENTRIES:
                raise InputError(str(path), "", "more jobs", f"at most {_MOST_ENTRIES:,} of them")
            try:
                _require_name(given.name, seen)
                entry = templates.entry(given, file)
            except InputError as error:
                raise source.error(error, given.set) from error
            seen.add(given.name)
            yield entry
        if not seen:
            raise InputError(str(path), "", "a campaign without jobs", "at least one job")


def _require_name(name: str, seen: Collection[str]) -> None:
    require_task_name(name, "", "name")
    if name in seen:
        raise InputError("", "name", shown(name), "a name that no other job has")


def _given(file: CampaignFile, path: Path, folder: Path) -> Iterator[tuple[EntryFile, _Source]]:
    """Yield the entries of the file, then of its table, then of its folder."""
    for k, entry in enumerate(file.jobs):
        yield entry, _Source(file=str(path), prefix=f"jobs[{k}].")
    if file.table is not None:
        if path.suffix.lower() != ".csv" and not (folder / file.table).exists():
            got = f"no such file {shown(file.table)}"
            raise InputError(str(path), "table", got, "a CSV table of jobs, relative to the campaign file")
        yield from _rows(folder / file.table, file.scene)
    if file.folder is not None:
        where = folder / file.folder
        if not where.is_dir():
            raise InputError(
                str(path), "folder", f"no such folder {shown(file.folder)}", "a folder of scenes"
            )
        for scene in sorted(where.glob("*.yaml")):
            yield EntryFile(name=scene.stem, scene=str(scene.resolve())), _Source(file=str(scene))


def _rows(table: Path, scene: str | None) -> Iterator[tuple[EntryFile, _Source]]:
    rows = read_csv(table, InputError, kind="a CSV table of jobs", largest=_LARGEST_TABLE)
    heading = [name.strip() for name in rows[0]] if rows else []
    if "name" not in heading or len(set(heading)) < len(heading) or "" in heading:
        expected = "a line of different columns, among them name"
        raise InputError(str(table), "", shown(",".join(heading)), expected, line=1)
    if scene is None and "scene" not in heading:
        raise InputError(str(table), "", "no column scene", "one, or a campaign file with a scene", line=1)
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) != len(heading):
            raise InputError(str(table), "", f"{len(row)} cells", f"{len(heading)} as in line 1", line=line)
        cells = {name: cell.strip() for name, cell in zip(heading, row, strict=True)}
        source = _Source(file=str(table), line=line)
        try:
            # An empty cell leaves a key as the scene has it.
            values = {
                key: yaml_value(cell, "", InputError)
                for key, cell in cells.items()
                if cell and key not in ("name", "scene")
            }
            data = {name: cells[name] for name in ("name", "scene") if cells.get(name)}
            data |= {"at_m": values.pop("at_m")} if "at_m" in values else {}
            yield validated(EntryFile, {**data, "set": values}, "", InputError), source
        except InputError as error:
            raise source.error(error) from error


class _Templates:
    """The scenes that entries are variants of, each read once."""

    def __init__(self, folder: Path, source: str) -> None:
        self._folder, self._source = folder, source
        self._read = dict[str, tuple[dict[str, Any], Path]]()

    def entry(self, given: EntryFile, file: CampaignFile) -> Entry:
        """The entry with its scene; a `SceneError` names a key of that."""
        named = given.scene or file.scene
        if named is None:
            raise InputError("", "scene", "nothing", "a scene, here or for the whole campaign")
        if named not in self._read:
            self._read[named] = self._template(named)
        data, folder = self._read[named]
        values = {**file.set, **given.set}
        content = changed_content(data, values) | {"name": given.name}
        scene = scene_from_data(content, folder, self._source)
        return Entry(name=given.name, scene=scene, at_m=given.at_m, values=values)

    def _template(self, named: str) -> tuple[dict[str, Any], Path]:
        beside = self._folder / named
        path = scene_path(beside) if beside.is_file() else scene_path(named)
        return read_yaml(path, SceneError), path.parent
