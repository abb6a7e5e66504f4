"""What a campaign plans: variants of a scene in a table, each scene of a folder, or both."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from cmbot.campaigns.task import require_task_name
from cmbot.common.errors import InputError, SceneError
from cmbot.common.reading.input_files import is_file, is_folder, read_csv
from cmbot.common.reading.validation import FileModel, counted, given_path, hint, refusal, shown, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml, yaml_value
from cmbot.scene import Scene, changed_content, is_within, scene_from_data, scene_path, shipped_scenes

_MAX_TABLE_BYTES = 100_000_000
_MAX_ENTRIES = 1_000_000

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
    memory_limit_mb: Annotated[int, Field(ge=1000, le=1_000_000)] = 4000
    """Address space of a job's process, of which it uses a part."""

    def _check(self) -> None:
        if not self.jobs and self.table is None and self.folder is None:
            raise refusal("one of jobs, table and folder", got="none of them")


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

    def error(self, error: InputError, key: str | None = None) -> InputError:
        """An error about an entry, named by where that stands; by its `key` there where that is another."""
        named = f"{self.prefix}{error.key if key is None else key}"
        return type(error)(self.file, named, error.got, error.expected, error.choices, line=self.line)


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
    if is_folder(path):
        file = CampaignFile(format="cmbot-campaign/1", name=path.resolve().name, folder=".")
    elif path.suffix.lower() == ".csv":
        file = CampaignFile(format="cmbot-campaign/1", name=path.stem, table=path.name)
    else:
        with lines_named(path):
            file = validated(CampaignFile, read_yaml(path, InputError, kind), str(path), InputError)
        file = file.changed(name=file.name or path.stem)
    with lines_named(path):
        require_task_name(str(file.name), str(path), "name")
    return file, _entries(file, path)


def _entries(file: CampaignFile, path: Path) -> Iterator[Entry]:
    folder = path if is_folder(path) else path.parent
    templates = _Templates(file, str(path), folder)
    seen = set[str]()
    with lines_named(path):
        for given, source in _given(file, path, folder):
            if len(seen) == _MAX_ENTRIES:
                raise InputError(str(path), "", "more jobs", f"at most {_MAX_ENTRIES:,} of them")
            try:
                _require_name(given.name, seen)
            except InputError as error:
                raise source.error(error) from error
            seen.add(given.name)
            yield templates.entry(given, source)
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
        if path.suffix.lower() != ".csv" and not is_file(folder / file.table):
            got = f"no such file {shown(file.table)}"
            raise InputError(str(path), "table", got, "a CSV table of jobs, relative to the campaign file")
        yield from _rows(folder / file.table, file.scene)
    if file.folder is not None:
        where = folder / file.folder
        if not is_folder(where):
            raise InputError(
                str(path), "folder", f"no such folder {shown(file.folder)}", "a folder of scenes"
            )
        for scene in sorted(where.glob("*.yaml")):
            named = str(Path(file.folder, scene.name))
            yield EntryFile(name=scene.stem, scene=named), _Source(file=str(scene))


def _rows(table: Path, scene: str | None) -> Iterator[tuple[EntryFile, _Source]]:
    rows = read_csv(table, InputError, kind="a CSV table of jobs", largest=_MAX_TABLE_BYTES)
    heading = [name.strip() for name in rows[0]] if rows else []
    if "name" not in heading or len(set(heading)) < len(heading) or "" in heading:
        expected = "a line of different columns with commas between them, among them name"
        raise InputError(str(table), "", shown(",".join(heading)), expected, line=1)
    if scene is None and "scene" not in heading:
        raise InputError(str(table), "", "no column scene", "one, or a campaign file with a scene", line=1)
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) != len(heading):
            raise InputError(
                str(table), "", counted(len(row), "cell"), f"{len(heading)} as in line 1", line=line
            )
        by_name = {name: cell.strip() for name, cell in zip(heading, row, strict=True)}
        source = _Source(file=str(table), line=line)
        try:
            # An empty cell leaves a key as the scene has it.
            values = {
                key: yaml_value(cell, "", InputError)
                for key, cell in by_name.items()
                if cell and key not in ("name", "scene")
            }
            data = {name: by_name[name] for name in ("name", "scene") if by_name.get(name)}
            data |= {"at_m": values.pop("at_m")} if "at_m" in values else {}
            yield validated(EntryFile, {**data, "set": values}, "", InputError), source
        except InputError as error:
            raise source.error(error) from error


class _Templates:
    """The scenes that entries are variants of, each read once."""

    def __init__(self, file: CampaignFile, source: str, folder: Path) -> None:
        self._file, self._source, self._folder = file, source, folder
        self._read = dict[str, tuple[dict[str, Any], Path]]()

    def entry(self, given: EntryFile, source: _Source) -> Entry:
        """The entry with its scene; what is wrong is named by where it stands."""
        data, path = self._template(given, source)
        values = {**self._file.set, **given.set}
        try:
            content = changed_content(data, values) | {"name": given.name}
            scene = scene_from_data(content, path.parent, self._source)
        except SceneError as error:
            raise self._named(error, given, source, data, path) from error
        return Entry(name=given.name, scene=scene, at_m=given.at_m, values=values)

    def _named(
        self, error: SceneError, given: EntryFile, source: _Source, data: dict[str, Any], path: Path
    ) -> InputError:
        """An error in what an entry or the campaign sets, in the scene file, or in how these go together."""
        if is_within(error.key, given.set):
            return source.error(error, f"set.{error.key}" if source.prefix else error.key)
        if is_within(error.key, self._file.set):
            return _Source(file=self._source).error(error, f"set.{error.key}")
        try:
            with lines_named(path):
                scene_from_data(data, path.parent, str(path))
        except SceneError as own:
            if own.key == error.key:
                return own
        return source.error(error, f"scene: {error.key}")

    def _template(self, given: EntryFile, source: _Source) -> tuple[dict[str, Any], Path]:
        named = given.scene or self._file.scene
        if named is None:
            raise source.error(InputError("", "scene", "nothing", "a scene, here or for the whole campaign"))
        if named not in self._read:
            path = self._folder / named
            if not is_file(path):
                if named not in (names := shipped_scenes()):
                    expected = f"a scene file beside {self._source}, or a shipped scene{hint(named, names)}"
                    missing = SceneError("", "scene", f"no such file {shown(named)}", expected)
                    raise (source if given.scene else _Source(file=self._source)).error(missing)
                path = scene_path(named)
            self._read[named] = read_yaml(path, SceneError), path
        return self._read[named]
