"""Xacro, the macro language of URDFs: what it expands to, by the optional package xacrodoc.

Whoever wrote a description wrote a program: it runs in a process of its own (`xacro_child`), with limits of
time and memory, without the variables of the environment but those of ROS, and reads regular files below the
model's folder and below packages alone.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryFile
from threading import Timer
from typing import Any

from cmbot.common.errors import MissingExtra, ModelError, one_line, whole_sentences
from cmbot.common.reading.input_files import LARGEST_TEXT
from cmbot.common.reading.validation import hint
from cmbot.robot.description.packages import find_copy, find_package

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
# Of what xacro says; of a path that is longer the end is kept.
_MAX_CAUSE_CHARACTERS = 100
_ELEMENT = re.compile(rb"<xacro:\w")
ROBOT_NAME = re.compile(rb"<robot\b[^>]*?\bname\s*=\s*[\"']([^\"'$]+)[\"']")
_PACKAGE_NAME = re.compile(r"\w[\w.\-]*")
# What else a process says may be of files.
_LACKING_PACKAGE = re.compile(r"^ModuleNotFoundError: (No module named '[\w.]+')", re.M)
_LACKING = re.compile(r"Undefined substitution argument (\S+)")
_LINK, _MACRO = re.compile(r"<link\b"), re.compile(rb"<xacro:macro\b")
# As many packages as a robot's description may name; files that are named as using macros, and their size.
_MOST_PACKAGES, _MOST_USERS, _LARGEST_USER = 100, 3, 1_000_000
# Processor time and memory of an expansion, s and byte; how much longer it may wait.
_CPU_SECONDS, _MEMORY, _WAITS = 20, 1_000_000_000, 3
# Of a line of an answer: the result, in which each byte may be written as six.
_MAX_ANSWER_BYTES = 6 * LARGEST_TEXT + 1_000_000
_VARIABLES = ("HOME", "LANG", "PATH", "PYTHONHOME", "PYTHONPATH")


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
    if find_spec("xacrodoc") is None:
        missing = MissingExtra("xacrodoc", "xacro")
        missing.add_hint(
            f"{path.name} is xacro, not yet a URDF: xacro {path.name} > robot.urdf expands it too"
        )
        raise missing
    answer = _answered(path, content, package_dirs, arguments or {})
    if (expanded := answer.get("urdf")) is None:
        raise _refusal(path, answer, arguments or {})
    for argument in arguments or {}:
        if argument not in (choices := answer["sought"]):
            expected = f"an argument that the file has{hint(argument, choices)}"
            raise ModelError(str(path), f"xacro.{argument}", "no argument of it", expected, choices)
    if _LINK.search(expanded) is None and _MACRO.search(content) is not None:
        users = ", ".join(_users(path)) or "such a file, with its ending .urdf.xacro or .xacro"
        raise ModelError(
            str(path), "", "macros alone, which no one calls", f"the file that calls them: {users}"
        )
    # A half of a character, which UTF-8 cannot hold, is refused where the XML is read.
    return str(expanded).encode(errors="surrogatepass")


def _answered(
    path: Path, content: bytes, package_dirs: Sequence[Path], arguments: Mapping[str, str]
) -> dict[str, Any]:
    """The last answer of a process that expands a file; empty where it ended without one."""
    name, folder = ROBOT_NAME.search(content), path.resolve().parent
    task = {
        "path": str(path.resolve()),
        "name": name[1].decode(errors="replace") if name else path.name.partition(".")[0],
        "arguments": dict(arguments),
        "roots": [str(place) for place in (folder, *package_dirs)],
        "seconds": _CPU_SECONDS,
        "memory": _MEMORY,
        "largest": LARGEST_TEXT,
    }
    own = {key: value for key, value in os.environ.items() if key in _VARIABLES or key.startswith("ROS_")}
    # Without -P its folder would come first, and xacro.py there.
    words = [sys.executable, "-P", str(Path(__file__).with_name("xacro_child.py"))]
    pipe = subprocess.PIPE
    with (
        TemporaryFile() as said,
        subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=said, env=own) as process,
    ):
        timer = Timer(_CPU_SECONDS * _WAITS, process.kill)
        timer.start()
        try:
            answer = _conversation(process, task, path, package_dirs)
            # Its limits end it by a signal; with a status it failed, such as for want of a package.
            if not answer and (status := process.wait()) > 0:
                said.seek(0)
                lacking = _LACKING_PACKAGE.findall(said.read().decode(errors="replace"))
                return {"failed": [f"its process ended with status {status}", *lacking][-1]}
            return answer
        finally:
            timer.cancel()
            process.kill()


def _conversation(
    process: subprocess.Popen[bytes], task: dict[str, Any], path: Path, package_dirs: Sequence[Path]
) -> dict[str, Any]:
    """Tell a process its task, then where packages are, until it has an answer."""
    if process.stdin is None or process.stdout is None:
        return {}
    say: object = task
    for _ in range(_MOST_PACKAGES + 1):
        try:
            process.stdin.write(json.dumps(say).encode() + b"\n")
            process.stdin.flush()
            answer = json.loads(process.stdout.readline(_MAX_ANSWER_BYTES))
        except (BrokenPipeError, ValueError):  # it was ended
            return {}
        if "find" not in answer:
            return dict(answer)
        files = [path, *map(Path, answer["files"])]
        say = str(_package(answer["find"], path, files, package_dirs))
    raise ModelError(str(path), "", "xacro of too many packages", f"at most {_MOST_PACKAGES}")


def _refusal(path: Path, answer: Mapping[str, Any], arguments: Mapping[str, str]) -> ModelError:
    """Why a file does not expand."""
    files = [str(path), *answer.get("files", ())]
    if "failed" not in answer:
        got = f"xacro that takes more than {_CPU_SECONDS} s"
        expected = "a description that needs no more"
        if "nested" in answer:
            included = next((file for file in files[1:] if files[1:].count(file) > 1), None)
            got = "xacro that is nested too deep, such as a macro that calls itself"
            if included is not None:
                got = f"xacro in which {Path(included).name} includes itself, perhaps through other files"
            expected = "files and macros that do not lead back to themselves"
        elif "large" in answer:
            got = f"xacro that takes more than {answer['large']}"
        return ModelError(str(path), "", got, expected)
    text = one_line(answer["failed"])
    if lacking := _LACKING.search(text):
        expected = "a value of this argument of xacro, which has no default"
        if near := get_close_matches(lacking[1], list(arguments), n=1):
            expected = f"{expected}; given is {near[0]}"
        return ModelError(str(path), f"xacro.{lacking[1]}", "nothing", expected)
    last = Path(files[-1]).name
    where = f" in {last}" if last != path.name else ""
    got = f"xacro that does not expand{where} ({whole_sentences(text, _MAX_CAUSE_CHARACTERS)})"
    expected = "xacro that expands, its arguments given where they have no defaults, or a URDF"
    return ModelError(str(path), "", got, expected)


def _package(name: str, path: Path, files: Iterable[Path], package_dirs: Sequence[Path]) -> Path:
    """The folder of a package that one of `files` names; refused where there is none."""
    folder = path.resolve().parent
    place = find_package(name, folder, package_dirs) if _PACKAGE_NAME.fullmatch(name) else None
    if place is None and _PACKAGE_NAME.fullmatch(name):
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
