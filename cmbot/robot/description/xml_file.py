"""The XML of a URDF or an SRDF: no document type, so no entities, and of bounded size and depth."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree

from cmbot.common.errors import ModelError
from cmbot.common.reading.input_files import read_input
from cmbot.common.reading.validation import shown
from cmbot.robot.description.xacro import expand_xacro, is_xacro

# Readers of XML trees call themselves for each level.
_MAX_DEPTH = 50
# The parser is stopped after the piece in which a refusal is found.
_SCENE_FORMAT = re.compile(rb"^[\"' {]*format[\"']?: *[\"']?cmbot-scene/", re.MULTILINE)
_BYTES_PER_READ = 1 << 16


def urdf_content(
    path: Path,
    package_dirs: Sequence[Path] = (),
    kind: str = "a URDF",
    arguments: Mapping[str, str] | None = None,
) -> bytes:
    """Return the bytes of a URDF or an SRDF; of one that is written in xacro, what it expands to.

    Parameters
    ----------
    path : Path
    package_dirs : sequence of Path
        Where the packages that xacro names are sought first, see `find_package`.
    kind : str
        What errors call it.
    arguments : mapping of str to str, optional
        Of xacro.

    Raises
    ------
    ModelError
        When the file is missing, no regular file, larger than 20 MB or unreadable, or does not expand.
    MissingExtra
        When it is xacro, and the extra that expands it is not installed.
    """
    content = read_input(path, ModelError, kind=f"{kind} file")
    if is_xacro(content):
        return expand_xacro(path, content, package_dirs, arguments)
    for name in arguments or ():
        raise ModelError(str(path), f"xacro.{name}", "a file without xacro", "no arguments of xacro with it")
    return content


def parse_urdf(path: Path, kind: str = "a URDF", package_dirs: Sequence[Path] = ()) -> ElementTree.Element:
    """Parse a URDF or, as an error names its `kind`, an SRDF into its XML tree; xacro is expanded.

    Raises
    ------
    ModelError
        When the file is missing, no regular file, empty, larger than 20 MB, unreadable, no XML, has a
        document type (and so could have entities), elements deeper than 50, or a root element other than
        ``<robot>``; or when it is xacro that does not expand.
    MissingExtra
        When it is xacro, and the extra that expands it is not installed.
    """
    return read_urdf(path, kind, package_dirs)[1]


def read_urdf(
    path: Path,
    kind: str = "a URDF",
    package_dirs: Sequence[Path] = (),
    arguments: Mapping[str, str] | None = None,
) -> tuple[bytes, ElementTree.Element]:
    """Return what `urdf_content` and what `parse_urdf` returns, of one reading.

    Raises
    ------
    ModelError, MissingExtra
        As `parse_urdf`.
    """
    content, source = urdf_content(path, package_dirs, kind, arguments), str(path)
    if not content:
        raise ModelError(source, "", "an empty file", f"{kind} file")
    parser = ElementTree.XMLParser(target=_Builder(source, kind))
    try:
        for start in range(0, len(content), _BYTES_PER_READ):
            parser.feed(content[start : start + _BYTES_PER_READ])
        root: ElementTree.Element = parser.close()
    except ModelError:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two: unknown encodings
        scene = _SCENE_FORMAT.search(content) is not None
        got = "a scene file" if scene else f"text that is not well-formed XML ({error})"
        raise ModelError(source, "", got, f"{kind} file") from error
    if root.tag != "robot":
        raise ModelError(source, "", shown(f"<{root.tag}>")[1:-1], f"{kind}, whose root element is <robot>")
    return content, root


class _Builder(ElementTree.TreeBuilder):
    """The tree of the elements; refuses what its readers or its memory could not hold."""

    def __init__(self, source: str, kind: str) -> None:
        super().__init__()
        self._source, self._kind, self._depth = source, kind, 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> NoReturn:
        del name, pubid, system
        raise ModelError(self._source, "", "a document type (<!DOCTYPE …>)", f"{self._kind} without one")

    def start(self, tag: str, attrs: dict[str, str]) -> ElementTree.Element:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            raise ModelError(self._source, "", "nesting too deep", f"at most {_MAX_DEPTH} levels of elements")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)
