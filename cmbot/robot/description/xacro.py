"""Xacro, the macro language of URDFs: what it expands to, by the optional package xacrodoc."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.parsers.expat import ExpatError

from cmbot.common.errors import MissingExtra, ModelError, one_line
from cmbot.common.validation import shown
from cmbot.robot.description.packages import find_package

__all__ = ["expand_xacro", "is_xacro"]

_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_ELEMENT = re.compile(rb"<xacro:\w")
_NAME = re.compile(rb"<robot\b[^>]*?\bname\s*=\s*[\"']([^\"'$]+)[\"']")
_MISSING = re.compile(r"Package not found: ([\w.\-]+)")
# As many packages as a robot's description may name.
_MOST_PACKAGES = 100


def is_xacro(content: bytes) -> bool:
    """Return whether the XML has elements of xacro; its namespace alone is left over in many URDFs."""
    return _ELEMENT.search(content) is not None and _ELEMENT.search(_COMMENT.sub(b"", content)) is not None


def expand_xacro(path: Path, content: bytes, package_dirs: Sequence[Path] = ()) -> bytes:
    """Return the URDF that a xacro file expands to.

    Arguments of xacro have their defaults. ``$(find …)`` is answered by `find_package`, without ROS.

    Raises
    ------
    MissingExtra
        When xacrodoc is not installed.
    ModelError
        When it does not expand, such as for a package that is not found.
    """
    try:
        import xacro
        from xacrodoc import XacroDoc, packages
    except ImportError as error:
        missing = MissingExtra("xacrodoc", "xacro")
        missing.add_hint(
            f"{path.name} is xacro, not yet a URDF: xacro {path.name} > robot.urdf expands it too"
        )
        raise missing from error
    # xacro raises Python's own errors for what it does not check, such as a missing attribute.
    failures = (
        *(xacro.XacroException, packages.PackageNotFoundError, ExpatError),
        *(OSError, ValueError, RuntimeError, AttributeError, LookupError, TypeError),
    )
    name, folder = _NAME.search(content), path.resolve().parent
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
            )
            # What xacro makes need not be XML.
            expanded: str = document.to_urdf_string()
            return expanded.encode()
        except RecursionError as error:
            included = next((file for file in xacro.filestack if xacro.filestack.count(file) > 1), None)
            got = "xacro that is nested too deep, such as a macro that calls itself"
            if included is not None:
                got = f"xacro in which {Path(included).name} includes itself, perhaps through other files"
            expected = "files and macros that do not lead back to themselves"
            raise ModelError(str(path), "", got, expected) from error
        except failures as error:
            text = one_line(error)
            wanted = _MISSING.search(text)
            place = find_package(wanted[1], folder, package_dirs) if wanted else None
            if wanted and place is None:
                expected = "a package in package_dirs, beside the file or above it, or one that ROS knows"
                raise ModelError(str(path), f"$(find {wanted[1]})", "no such package", expected) from error
            if wanted is None or place is None or wanted[1] in known:
                got = f"xacro that does not expand ({shown(text)[1:-1]})"
                raise ModelError(
                    str(path), "", got, "xacro whose arguments have defaults, or a URDF"
                ) from error
            known[wanted[1]] = str(place)
    raise ModelError(str(path), "", "xacro of too many packages", f"at most {_MOST_PACKAGES}")
