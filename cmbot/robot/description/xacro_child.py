"""The process that expands xacro, which a stranger has written: it imports nothing of cmbot.

It reads a task, a line of JSON, from standard input, and answers with lines of JSON: ``{"find": NAME}`` asks
for the folder of a package, which it reads as the next line; the last one has what the file expands to, or
why it does not. Time, memory and the size of the result are bounded, and the files that may be read are
regular ones below the folders that it was given.
"""

from __future__ import annotations

import json
import os
import resource
import stat
import sys
from collections.abc import Callable
from errno import EACCES
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.parsers.expat import ExpatError

import xacro
from xacrodoc import XacroDoc, packages

# xacro imports it when it is first used: files elsewhere are refused then.
import_module("yaml")
# What no description needs: other programs and networks.
_REFUSED_EVENTS = ("subprocess.", "os.exec", "os.fork", "os.posix_spawn", "os.system", "socket.", "ctypes.")


def main() -> None:
    """Expand one file."""
    task = json.loads(sys.stdin.readline())
    resource.setrlimit(resource.RLIMIT_AS, (task["memory"], task["memory"]))
    resource.setrlimit(resource.RLIMIT_CPU, (task["seconds"], task["seconds"]))
    try:
        _answer(_expanded(task))
    except MemoryError:
        _answer({"large": f"{task['memory'] / 1e9:g} GB of memory"})


def _answer(content: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()


def _expanded(task: dict[str, Any]) -> dict[str, Any]:
    # xacro raises Python's own errors for what it does not check, such as a missing attribute.
    failures = (
        *(xacro.XacroException, packages.PackageNotFoundError, ExpatError),
        *(OSError, ValueError, RuntimeError, AttributeError, LookupError, TypeError),
    )
    roots = [os.path.realpath(root) for root in task["roots"]]

    def find(name: str) -> str:
        _answer({"find": name, "files": _open_files()})
        if (place := json.loads(sys.stdin.readline())) is None:
            raise packages.PackageNotFoundError(name)
        roots.append(os.path.realpath(place))
        return str(place)

    packages._finder.finder_funcs[:] = [(find, packages.PackageNotFoundError)]
    arguments = _Arguments(task["arguments"])
    sys.addaudithook(_guard(roots, task["largest"]))
    try:
        document = XacroDoc.from_includes(
            [task["path"]], name=task["name"], resolve_packages=False, subargs=arguments
        )
        text = str(document.to_urdf_string())
    except RecursionError:
        return {"nested": True, "files": _open_files()}
    except failures as error:
        # xacro makes its own error of that.
        if "MemoryError" in repr(getattr(error, "exc", None)):
            raise MemoryError from error
        return {"failed": str(error), "files": _open_files()}
    if len(text) > task["largest"]:
        return {"large": f"{task['largest'] / 1e6:g} MB of text"}
    return {"urdf": text, "sought": sorted(arguments.sought)}


def _open_files() -> list[str]:
    return [str(file) for file in xacro.filestack or () if file]


def _guard(roots: list[str], largest: int) -> Callable[[str, tuple[Any, ...]], None]:
    """Return what Python asks before it opens a file or does anything else outside of this process."""
    own = [os.path.realpath(place) for place in sys.path if place]

    def allow(event: str, arguments: tuple[Any, ...]) -> None:
        if event.startswith(_REFUSED_EVENTS):
            raise PermissionError(f"a call of {event}")
        if event != "open" or isinstance(arguments[0], int):
            return
        path = os.path.realpath(os.fsdecode(arguments[0]))
        if any(path.startswith(f"{place.rstrip(os.sep)}{os.sep}") for place in own):
            return  # a module
        if not any(path.startswith(f"{root.rstrip(os.sep)}{os.sep}") for root in roots):
            what = "a file outside of the folder of the model and of packages"
            raise PermissionError(EACCES, what, str(arguments[0]))
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode) or status.st_size > largest:
            what = f"a file that is not regular, or larger than {largest / 1e6:g} MB"
            raise PermissionError(EACCES, what, str(arguments[0]))

    return allow


class _Arguments(dict[str, str]):
    """Values of arguments; keeps the names that xacro looks up, to declare an argument or for its value."""

    def __init__(self, values: dict[str, str]) -> None:
        super().__init__(values)
        self.sought = set[str]()

    def __contains__(self, name: object) -> bool:
        self.sought.add(str(name))
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.sought.add(name)
        return super().__getitem__(name)


if __name__ == "__main__":
    main()
