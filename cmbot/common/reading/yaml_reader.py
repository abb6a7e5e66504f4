"""Reads a YAML 1.2 file into plain data; what could be misread is refused. Writes such data."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from functools import lru_cache
from io import StringIO
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    MappingEndEvent,
    MappingStartEvent,
    ScalarEvent,
    SequenceEndEvent,
    StreamEndEvent,
)
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.reader import ReaderError
from ruamel.yaml.representer import SafeRepresenter

from cmbot.common.errors import InputError
from cmbot.common.reading.input_files import read_input
from cmbot.common.reading.validation import key_path, shown

LARGEST_FILE = 2_000_000
"""Size in bytes above which a file is refused."""

_DEEPEST, _YAML_WIDTH = 50, 120
_PLAIN_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_./\-]*")
# How ruamel.yaml says what it misses, with tokens of its own; messages of cmbot have these words elsewhere.
_RUAMEL_EXPECTED = re.compile(r"expected (.+?),? but (?:got|found) (.+)|could not find expected (.+)")
_TOKENS = {
    "<block end>": "the end of the block above",
    "'?'": "a key",
    "'<block mapping start>'": "a key that is indented otherwise",
}
_XML_START = re.compile(r"\s*<[?!A-Za-z]")
# 2,000 legs and 1,000 obstacles have half as many; each takes some 50 microseconds.
_MAX_YAML_VALUES = 100_000
_STRING_TAG = "tag:yaml.org,2002:str"
_PLAIN_TYPES = (str, int, float, type(None))  # bool is an int

_Path = tuple[str | int, ...]


def read_yaml(path: str | Path, error_type: type[InputError], kind: str = "a file") -> dict[str, Any]:
    """Return the content of a YAML file as plain mappings, lists, text, numbers, booleans and None.

    Parameters
    ----------
    path : str or Path
        The file, at most 2 MB of UTF-8.
    error_type : type
        What to raise: `SceneError`, `ModelError`, …
    kind : str
        What the file should be, for messages.

    Raises
    ------
    InputError
        Of `error_type`: the file cannot be read, is no valid YAML, is no mapping, or uses what could be
        misread: doubled keys, anchors and aliases, tags, directives, several documents, keys that are
        no text, dates, numbers that are not finite, nesting deeper than 50 levels, more than 100,000 keys
        and values.
    """
    source = str(path)
    text = _read_text(Path(path), source, error_type, kind)
    if _XML_START.match(text):
        error = error_type(source, "", "XML, such as a URDF", "a YAML file of keys and values")
        error.holds = "xml"
        raise error
    data = _parsed(text, source, error_type)
    if data is None:
        raise error_type(source, "", "an empty file", "a mapping of keys to values")
    if not isinstance(data, dict):
        raise error_type(source, "", shown(data), "a mapping of keys to values")
    return data


def yaml_value(text: str, source: str, error_type: type[InputError]) -> Any:
    """Return the content of a short YAML text, None for nothing, as `read_yaml` does.

    Raises
    ------
    InputError
        Of `error_type`, with `source` as its source.
    """
    try:
        return _parsed(text, source, error_type)
    except InputError as error:
        error.set_line(None)
        raise


def yaml_text(data: Mapping[str, Any]) -> str:
    """Return plain data as YAML that `read_yaml` reads: blocks in their order, short lists on a line each."""
    yaml: Any = YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.sort_base_mapping_type_on_output, yaml.width = None, False, _YAML_WIDTH
    yaml.allow_unicode, yaml.Representer = True, _Representer
    text = StringIO()
    # Through JSON: lists for tuples, and no object that is there twice, which would become an alias.
    yaml.dump(json.loads(json.dumps(data)), text)
    return text.getvalue()


class _Representer(SafeRepresenter):
    """Writes text that is more than a word in quotes: not all that is written plain is read as it was."""

    def represent_str(self, data: str) -> Any:
        return self.represent_scalar(_STRING_TAG, data, style=None if _PLAIN_WORD.fullmatch(data) else '"')


_Representer.add_representer(str, _Representer.represent_str)


def _parsed(text: str, source: str, error_type: type[InputError]) -> Any:
    # The files of a robot are read again each time that it is loaded.
    return deepcopy(_parsed_once(text, source, error_type))  # type: ignore[arg-type]  # an Any of mypy's


@lru_cache(maxsize=8)
def _parsed_once(text: str, source: str, error_type: type[InputError]) -> Any:
    try:
        return _Document(text, source, error_type).read()
    except InputError:
        raise
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = None if mark is None else mark.line + 1
        raise error_type(source, "", _syntax_problem(error), "valid YAML 1.2", line=line) from error
    except ReaderError as error:
        got = f"a control character (U+{error.character:04X}, at position {error.position + 1})"
        raise error_type(source, "", got, "printable text") from error
    except (YAMLError, ValueError) as error:
        raise error_type(source, "", shown(str(error)), "valid YAML 1.2") from error


@contextmanager
def lines_named(path: str | Path) -> Iterator[None]:
    """Add to an `InputError` that names a key of a YAML file the line of that key.

    Parameters
    ----------
    path : str or Path
        The file, as the error names it.
    """
    try:
        yield
    except InputError as error:
        name_line(error, path)
        raise


def name_line(error: InputError, path: str | Path) -> None:
    """Add to an error that names a key of a YAML file the line of that key: see `lines_named`."""
    if error.source == str(path) and error.key and error.line is None:
        error.set_line(line_of(Path(path), error.key))


def line_of(path: Path, key: str) -> int | None:
    """Return the line of a key in a file, or of the block in which it is missing; None without either."""
    try:
        document = _Document(_read_text(path, str(path), InputError), str(path), InputError)
        document.read()
    except (InputError, YAMLError, ValueError):
        return None
    lines = {key_path(steps): line for steps, line in document.lines.items()}
    while key and key not in lines:
        key = key.rpartition("[" if key.endswith("]") else ".")[0]
    return lines.get(key)


def _read_text(path: Path, source: str, error_type: type[InputError], kind: str = "a file") -> str:
    content = read_input(path, error_type, kind=kind, largest=LARGEST_FILE)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        got = f"a byte that is not UTF-8 (byte {error.start})"
        raise error_type(source, "", got, "text in UTF-8") from error


class _Document:
    """Plain data from the events of one YAML document; refuses what the data would no longer show."""

    def __init__(self, text: str, source: str, error_type: type[InputError]) -> None:
        self._source, self._error_type = source, error_type
        self._values = 0
        self._yaml = YAML(typ="safe", pure=True)
        self._events: Iterator[Any] = self._yaml.parse(text)
        self.lines: dict[_Path, int] = {}
        """Of every key and item."""

    def read(self) -> Any:
        next(self._events)  # start of the stream
        start = next(self._events)
        if isinstance(start, StreamEndEvent):
            return None
        if start.version is not None or start.tags:
            raise self._refused((), "a % directive", "YAML 1.2 without directives", start.start_mark)
        data = self._data(next(self._events), ())
        next(self._events)  # end of the document
        end = next(self._events)
        if not isinstance(end, StreamEndEvent):
            raise self._refused((), "a second document", "one document", end.start_mark)
        return data

    def _data(self, event: Any, path: _Path) -> Any:
        self._check(event, path)
        if isinstance(event, ScalarEvent):
            return self._scalar(event, path)
        if isinstance(event, MappingStartEvent):
            return self._mapping(path)
        items: list[Any] = []
        while not isinstance(event := next(self._events), SequenceEndEvent):
            step = (*path, len(items))
            self.lines[step] = event.start_mark.line + 1
            items.append(self._data(event, step))
        return items

    def _mapping(self, path: _Path) -> dict[str, Any]:
        mapping: dict[str, Any] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            self._check(event, path)
            if not isinstance(event, ScalarEvent):
                raise self._refused(path, "a list or mapping as key", "a key that is text", event.start_mark)
            key = event.value
            if str(self._node(event).tag) != _STRING_TAG:
                raise self._refused(path, f"the key {shown(key)}", "a key that is text", event.start_mark)
            if key in mapping:
                raise self._refused((*path, key), "the same key again", "each key once", event.start_mark)
            self.lines[*path, key] = event.start_mark.line + 1
            mapping[key] = self._data(next(self._events), (*path, key))
        return mapping

    def _scalar(self, event: Any, path: _Path) -> Any:
        got = shown(event.value)
        try:
            value = self._yaml.constructor.construct_object(self._node(event))
        except ValueError as error:  # such as a date with a 13th month, or an integer of ten thousand digits
            raise self._refused(path, got, "a number or text in quotes", event.start_mark) from error
        if not isinstance(value, _PLAIN_TYPES):
            got = f"the {type(value).__name__} {got}"
            raise self._refused(path, got, "text in quotes", event.start_mark)
        if isinstance(value, float) and not math.isfinite(value):
            raise self._refused(path, got, "a finite number", event.start_mark)
        return value

    def _node(self, event: Any) -> ScalarNode:
        tag = self._yaml.resolver.resolve(ScalarNode, event.value, event.implicit)
        return ScalarNode(tag, event.value, event.start_mark, event.end_mark, style=event.style)

    def _check(self, event: Any, path: _Path) -> None:
        mark = event.start_mark
        self._values += 1
        if self._values > _MAX_YAML_VALUES:
            raise self._refused(path[:3], "more values", f"at most {_MAX_YAML_VALUES} in a file", mark)
        if len(path) > _DEEPEST:
            raise self._refused(path[:3], "nesting too deep", f"at most {_DEEPEST} levels", mark)
        if isinstance(event, AliasEvent):
            raise self._refused(path, f"the alias *{event.anchor}", "the value itself", mark)
        if event.anchor is not None:
            raise self._refused(path, f"the anchor &{event.anchor}", "no anchor", mark)
        if event.tag is not None:
            raise self._refused(path, f"the tag {shown(str(event.tag))}", "no tag", mark)

    def _refused(self, path: _Path, got: str, expected: str, mark: Any) -> InputError:
        return self._error_type(self._source, key_path(path), got, expected, line=mark.line + 1)


def _syntax_problem(error: MarkedYAMLError) -> str:
    context, problem = (" ".join(str(part or "").split()) for part in (error.context, error.problem))
    if missed := _RUAMEL_EXPECTED.fullmatch(problem):
        expected, got, alone = missed.groups()
        where = f"{_TOKENS.get(got, got)} where {_TOKENS.get(expected, expected)} should be"
        problem = f"no {alone}" if alone else where
    problem = ", ".join(filter(None, (problem.removeprefix("found "), context))) or "a syntax error"
    mark = error.problem_mark or error.context_mark
    return f"{problem} (column {mark.column + 1})" if mark else problem
