"""Which plan directory may have been meant."""

from __future__ import annotations

from pathlib import Path

from cmbot.archive.folder import PLAN_FILE

__all__ = ["plans_nearby"]

# Where the command line puts plans when it is not told.
_USUAL = Path("out")
_MOST_NAMED = 3


def plans_nearby(folder: Path) -> str:
    """Return a question that names the plan directories in `folder`, or that of its name in ``out``.

    It is empty where there are none, or `folder` is one itself.
    """
    try:
        if (folder / PLAN_FILE).exists():
            return ""
        below = sorted(path.parent for path in folder.glob(f"*/{PLAN_FILE}"))
        usual = _USUAL / folder
        found = below or ([usual] if (usual / PLAN_FILE).is_file() else [])
    except OSError:  # a folder that may not be entered, a name that is too long
        return ""
    if not found:
        return ""
    more = " or another one there" if len(found) > _MOST_NAMED else ""
    return f"; did you mean {' or '.join(map(str, found[:_MOST_NAMED]))}{more}?"
