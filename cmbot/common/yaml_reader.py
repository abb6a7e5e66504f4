"""Reads a YAML 1.2 file into plain data, and refuses whatever could mean something else than it seems to."""

from __future__ import annotations

import math
import stat
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, ScalarEvent, StreamEndEvent
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from cmbot.common.errors import InputError
from cmbot.common.validation import key_path, shown

__all__ = ["LARGEST_FILE", "read_yaml", "yaml_value"]

LARGEST_FILE = 5_000_000
"""Size in bytes above which a file is refused."""

_DEEPEST = 50
_TEXT = "tag:yaml.org,2002:str"
_PLAIN_TYPES = (str, int, float, type(None))  # bool is an int

_Path = tuple[str | int, ...]


class _RefusedError(Exception):
    """Something stands in the file that we do not accept; `read_yaml` says in which file."""

    def __init__(self, key: _Path, got: str, expected: str, mark: Any) -> None:
        super().__init__(got)
        self.key = key_path(key)
        self.got = f"{got} ({_place(mark)})"
        self.expected = expected


def read_yaml(path: str | Path, error_type: type[InputError]) -> dict[str, Any]:
    """Return the content of a YAML file as plain mappings, lists, text, numbers, booleans and None.

    Parameters
    ----------
    path : str or Path
        The file, at most 5 MB of UTF-8.
    error_type : type
        What to raise: `SceneError`, `ModelError`, …

    Raises
    ------
    InputError
        Of `error_type`: the file cannot be read, is no valid YAML, is no mapping, or uses what could be
        misread: doubled keys, anchors and aliases, tags, directives, several documents, keys that are
        no text, dates, numbers that are not finite, nesting deeper than 50 levels.
    """
    source = str(path)
    data = yaml_value(_read_text(Path(path), source, error_type), source, error_type)
    if data is None:
        raise error_type(source, "", "an empty file", "a mapping of keys to values")
    if not isinstance(data, dict):
        raise error_type(source, "", shown(data), "a mapping of keys to values")
    return data


def yaml_value(text: str, source: str, error_type: type[InputError]) -> Any:
    """Return what a YAML text says: a mapping, a list, text, a number, true, false, or None for nothing.

    Raises
    ------
    InputError
        Of `error_type`, as `read_yaml`; `source` is named as the place where it stands.
    """
    yaml = YAML(typ="safe", pure=True)
    yaml.Composer = _StrictComposer
    try:
        node = yaml.compose(text)
        return None if node is None else _data(yaml, node, ())
    except _RefusedError as error:
        raise error_type(source, error.key, error.got, error.expected) from error
    except MarkedYAMLError as error:
        raise error_type(source, "", _syntax_problem(error), "valid YAML 1.2") from error
    except ReaderError as error:
        got = f"a control character (U+{error.character:04X}, at position {error.position + 1})"
        raise error_type(source, "", got, "printable text") from error
    except (YAMLError, ValueError) as error:
        raise error_type(source, "", shown(str(error)), "valid YAML 1.2") from error


def _read_text(path: Path, source: str, error_type: type[InputError]) -> str:
    try:
        status = path.stat()
        if stat.S_ISDIR(status.st_mode):
            raise error_type(source, "", "a folder", "a file")
        if not stat.S_ISREG(status.st_mode):  # reading a pipe or a device may never end
            raise error_type(source, "", "something that is not a regular file", "a file")
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except FileNotFoundError as error:
        raise error_type(source, "", "no such file", "a file that exists") from error
    except OSError as error:
        got = f"a file that cannot be read ({error.strerror})"
        raise error_type(source, "", got, "a readable file") from error
    if len(content) > LARGEST_FILE:
        raise error_type(source, "", "a larger file", f"at most {LARGEST_FILE // 1_000_000} MB")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        got = f"a byte that is not UTF-8 (byte {error.start})"
        raise error_type(source, "", got, "text in UTF-8") from error


class _StrictComposer(Composer):
    """Composes one document and refuses what the plain data would no longer show."""

    def __init__(self, loader: Any = None) -> None:
        super().__init__(loader)
        self._steps: list[str | int] = []

    def get_single_node(self) -> Any:
        self.parser.get_event()  # start of the stream
        document = None
        if not self.parser.check_event(StreamEndEvent):
            document = self.compose_document()
        event = self.parser.get_event()
        if not isinstance(event, StreamEndEvent):
            raise _RefusedError((), "a second document", "one document", event.start_mark)
        return document

    def compose_document(self) -> Any:
        event = self.parser.peek_event()
        if event.version is not None or event.tags:
            raise _RefusedError((), "a % directive", "YAML 1.2 without directives", event.start_mark)
        return super().compose_document()

    def compose_node(self, parent: Any, index: Any) -> Any:
        step = index.value if isinstance(index, ScalarNode) else index
        nested = isinstance(step, str | int)  # neither the root nor a key
        if nested:
            self._steps.append(step)
        self._check(self.parser.peek_event(), is_key=parent is not None and not nested)
        node = super().compose_node(parent, index)
        if nested:
            self._steps.pop()
        return node

    def _check(self, event: Any, *, is_key: bool) -> None:
        key = tuple(self._steps)
        if len(key) > _DEEPEST:
            raise _RefusedError(key[:3], "nesting too deep", f"at most {_DEEPEST} levels", event.start_mark)
        if isinstance(event, AliasEvent):
            raise _RefusedError(key, f"the alias *{event.anchor}", "the value itself", event.start_mark)
        if event.anchor is not None:
            raise _RefusedError(key, f"the anchor &{event.anchor}", "no anchor", event.start_mark)
        if event.tag is not None:
            raise _RefusedError(key, f"the tag {event.tag}", "no tag", event.start_mark)
        if is_key and not isinstance(event, ScalarEvent):
            raise _RefusedError(key, "a list or mapping as key", "a key that is text", event.start_mark)


def _data(yaml: YAML, node: Node, path: _Path) -> Any:
    if isinstance(node, MappingNode):
        return _mapping(yaml, node, path)
    if isinstance(node, SequenceNode):
        return [_data(yaml, item, (*path, index)) for index, item in enumerate(node.value)]
    return _scalar(yaml, node, path)


def _mapping(yaml: YAML, node: MappingNode, path: _Path) -> dict[str, Any]:
    mapping: dict[str, Any] = {}
    for key, value in node.value:
        if str(key.tag) != _TEXT:
            got = f"the key {shown(key.value)}"
            raise _RefusedError(path, got, "a key that is text", key.start_mark)
        inner = (*path, key.value)
        if key.value in mapping:
            raise _RefusedError(inner, "the same key again", "each key once", key.start_mark)
        mapping[key.value] = _data(yaml, value, inner)
    return mapping


def _scalar(yaml: YAML, node: Node, path: _Path) -> Any:
    try:
        value = yaml.constructor.construct_object(node)
    except ValueError as error:  # such as a date with a 13th month, or an integer of ten thousand digits
        got = shown(node.value)
        raise _RefusedError(path, got, "a number or text in quotes", node.start_mark) from error
    if not isinstance(value, _PLAIN_TYPES):
        got = f"the {type(value).__name__} {shown(node.value)}"
        raise _RefusedError(path, got, "text in quotes", node.start_mark)
    if isinstance(value, float) and not math.isfinite(value):
        raise _RefusedError(path, shown(node.value), "a finite number", node.start_mark)
    return value


def _syntax_problem(error: MarkedYAMLError) -> str:
    parts = [" ".join(str(part).split()) for part in (error.context, error.problem) if part]
    problem = ", ".join(parts) or "a syntax error"
    mark = error.problem_mark or error.context_mark
    return f"{problem} ({_place(mark)})" if mark else problem


def _place(mark: Any) -> str:
    return f"line {mark.line + 1}, column {mark.column + 1}"
