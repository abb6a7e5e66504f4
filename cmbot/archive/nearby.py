"""Which plan directory may have been meant."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from cmbot.archive.folder import PLAN_FILE

__all__ = ["plans_nearby"]

# Where the command line puts plans when it is not told.
_USUAL = Path("out")
_MOST_NAMED = 3


def plans_nearby(folder: Path) -> str:
    """Return a question that names the plan directories that may have been meant.

    Those in `folder`, that of its name in ``out``, or those here and there whose names are nearly the same.
    It is empty where there are none, or `folder` is one itself.
    """
    try:
        if (folder / PLAN_FILE).exists():
            return ""
        below = sorted(path.parent for path in folder.glob(f"*/{PLAN_FILE}"))
        usual = _USUAL / folder
        found = below or ([usual] if (usual / PLAN_FILE).is_file() else [])
        found = found or [*_of_a_like_name(folder), *_of_a_like_name(usual)]
    except OSError:  # a folder that may not be entered, a name that is too long
        return ""
    if not found:
        return ""
    more = " or another one there" if len(found) > _MOST_NAMED else ""
    return f"; did you mean {' or '.join(map(str, found[:_MOST_NAMED]))}{more}?"


def _of_a_like_name(folder: Path) -> list[Path]:
    """The plan directory beside a folder that is not there, if their names are nearly the same."""
    if folder.exists():
        return []
    names = [path.parent.name for path in folder.parent.glob(f"*/{PLAN_FILE}")]
    return [folder.parent / name for name in get_close_matches(folder.name, names, n=1)]
