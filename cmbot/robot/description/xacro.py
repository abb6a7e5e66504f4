"""Xacro, the macro language of URDFs: what it expands to, by the optional package xacrodoc."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from xml.parsers.expat import ExpatError

from cmbot.common.errors import MissingExtra, ModelError, one_line
from cmbot.common.validation import hint, shown
from cmbot.robot.description.packages import find_copy, find_package

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_ELEMENT = re.compile(rb"<xacro:\w")
_NAME = re.compile(rb"<robot\b[^>]*?\bname\s*=\s*[\"']([^\"'$]+)[\"']")
_MISSING = re.compile(r"Package not found: ([\w.\-]+)")
_LACKING = re.compile(r"Undefined substitution argument (\S+)")
_LINK, _MACRO = re.compile(r"<link\b"), re.compile(rb"<xacro:macro\b")
# As many packages as a robot's description may name; files that are named as using macros, and their size.
_MOST_PACKAGES, _MOST_USERS, _LARGEST_USER = 100, 3, 1_000_000


def is_xacro(content: bytes) -> bool:
    """Return whether the XML has elements of xacro; its namespace alone is left over in many URDFs."""
    return _ELEMENT.search(content) is not None and _ELEMENT.search(_COMMENT.sub(b"", content)) is not None


def expand_xacro(
    path: Path, content: bytes, package_dirs: Sequence[Path] = (), arguments: Mapping[str, str] | None = None
) -> bytes:
    """Return the URDF that a xacro file expands to.

    ``$(find …)`` is answered by `find_package`, without ROS, and by `find_copy`.

    Parameters
    ----------
    path : Path
    content : bytes
        Of that file.
    package_dirs : sequence of Path
    arguments : mapping of str to str, optional
        Values of its arguments; others have their defaults.

    Raises
    ------
    MissingExtra
        When xacrodoc is not installed.
    ModelError
        When it does not expand, such as for a package that is not found or an argument without a value, or
        has macros alone.
    """
    try:
        import xacrodoc  # noqa: F401
    except ImportError as error:
        missing = MissingExtra("xacrodoc", "xacro")
        missing.add_hint(
            f"{path.name} is xacro, not yet a URDF: xacro {path.name} > robot.urdf expands it too"
        )
        raise missing from error
    given = _Arguments(arguments or {})
    expanded = _expanded(path, content, package_dirs, given)
    for argument in arguments or {}:
        if argument not in given.sought:
            choices = sorted(given.sought)
            expected = f"an argument that the file has{hint(argument, choices)}"
            raise ModelError(str(path), f"xacro.{argument}", "no argument of it", expected, choices)
    if _LINK.search(expanded) is None and _MACRO.search(content) is not None:
        users = ", ".join(_users(path)) or "such a file, with its ending .urdf.xacro or .xacro"
        raise ModelError(
            str(path), "", "macros alone, which no one calls", f"the file that calls them: {users}"
        )
    return expanded.encode()


def _expanded(path: Path, content: bytes, package_dirs: Sequence[Path], given: _Arguments) -> str:
    """What a file expands to; refused where it does not."""
    import xacro
    from xacrodoc import XacroDoc, packages

    # xacro raises Python's own errors for what it does not check, such as a missing attribute.
    failures = (
        *(xacro.XacroException, packages.PackageNotFoundError, ExpatError),
        *(OSError, ValueError, RuntimeError, AttributeError, LookupError, TypeError),
    )
    name = _NAME.search(content)
    known: dict[str, str] = {}
    for _ in range(_MOST_PACKAGES):
        # A failure leaves behind the files that were open.
        xacro.init_stacks(None)
        packages.reset()
        packages.update_package_cache(known)
        try:
            document = XacroDoc.from_includes(
                [str(path.resolve())],
                name=name[1].decode(errors="replace") if name else path.name.partition(".")[0],
                resolve_packages=False,
                subargs=given,
            )
            # What xacro makes need not be XML.
            return str(document.to_urdf_string())
        except RecursionError as error:
            included = next((file for file in xacro.filestack if xacro.filestack.count(file) > 1), None)
            got = "xacro that is nested too deep, such as a macro that calls itself"
            if included is not None:
                got = f"xacro in which {Path(included).name} includes itself, perhaps through other files"
            expected = "files and macros that do not lead back to themselves"
            raise ModelError(str(path), "", got, expected) from error
        except failures as error:
            text, open_files = one_line(error), [path, *map(Path, filter(None, xacro.filestack))]
            if lacking := _LACKING.search(text):
                expected = "a value of this argument of xacro, which has no default"
                if near := get_close_matches(lacking[1], list(given), n=1):
                    expected = f"{expected}; given is {near[0]}"
                raise ModelError(str(path), f"xacro.{lacking[1]}", "nothing", expected) from error
            wanted = _MISSING.search(text)
            place = _package(wanted[1], path, open_files, package_dirs) if wanted else None
            if wanted is None or place is None or wanted[1] in known:
                where = f" in {open_files[-1].name}" if open_files[-1].name != path.name else ""
                got = f"xacro that does not expand{where} ({shown(text)[1:-1]})"
                expected = "xacro that expands, its arguments given where they have no defaults, or a URDF"
                raise ModelError(str(path), "", got, expected) from error
            known[wanted[1]] = str(place)
    raise ModelError(str(path), "", "xacro of too many packages", f"at most {_MOST_PACKAGES}")


class _Arguments(dict[str, str]):
    """Values of arguments; keeps the names that xacro looks up, to declare an argument or for its value."""

    def __init__(self, values: Mapping[str, str]) -> None:
        super().__init__(values)
        self.sought = set[str]()

    def __contains__(self, name: object) -> bool:
        self.sought.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.sought.add(name)
        return super().__getitem__(name)


def _package(name: str, path: Path, files: Iterable[Path], package_dirs: Sequence[Path]) -> Path:
    """The folder of a package that one of `files` names; refused where there is none."""
    folder = path.resolve().parent
    place = find_package(name, folder, package_dirs)
    if place is None:
        inside = re.compile(rb"\$\(find\s+" + re.escape(name.encode()) + rb"\s*\)/([^\s\"'$<>]+)")
        contents = (file.read_bytes() for file in dict.fromkeys(files) if file.is_file())
        named = [found.decode(errors="replace") for content in contents for found in inside.findall(content)]
        place = find_copy(named, folder, package_dirs)
    if place is None:
        expected = "a package in package_dirs, beside the file or above it, or one that ROS knows"
        raise ModelError(str(path), f"$(find {name})", "no such package", expected)
    return place


def _users(path: Path) -> list[str]:
    """Names of files of xacro beside one of macros that include it, relative to its folder."""
    folder, users = path.resolve().parent, list[str]()
    for place in (folder, folder.parent / "robots", folder.parent / "urdf"):
        for file in sorted(place.glob("*.xacro")) if place.is_dir() else ():
            included = file.stat().st_size <= _LARGEST_USER and path.name.encode() in file.read_bytes()
            if included and file.name != path.name and file.name not in users:
                users.append(file.name)
    return users[:_MOST_USERS]
