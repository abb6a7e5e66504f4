"""An excitation in the directory of its plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cmbot.archive.names import EXCITATION_FILE
from cmbot.archive.places import add_results
from cmbot.archive.strict_json import json_bytes
from cmbot.common.validation import given_path, plain, require_type
from cmbot.excitation import Excitation
from cmbot.version import __version__

_FORMAT = "cmbot-excitation/1"


def save_excitation(
    excitation: Excitation,
    directory: str | Path,
    *,
    force: bool = False,
    added: Mapping[str, bytes | str] | None = None,
) -> tuple[Path, ...]:
    """Add an excitation to a plan directory, all files or none; ``plan.json`` takes their hashes.

    Parameters
    ----------
    excitation : Excitation
        Of the plan that was saved there.
    directory : str or Path
    force : bool
        Replace one that is there.
    added : mapping from str to bytes or str, optional
        Pages and plots that are added with it, by their names.

    Returns
    -------
    tuple of Path
        Of the files.

    Raises
    ------
    InputError
        When `excitation` is no Excitation, or `directory` no path.
    ArchiveError
        When `directory` is no plan directory, holds one already, a number is not finite, another process is
        writing there, or the system refuses.

    Examples
    --------
    >>> [path.name for path in cmbot.save_excitation(excitation, "out/triangle")]
    ['excitation.json']
    """
    expected = "an Excitation, as cmbot.excite returns it"
    require_type(excitation, Excitation, "cmbot.save_excitation", "excitation", expected)
    folder = given_path(directory, "cmbot.save_excitation", "directory", "the path of a plan directory")
    contents = {EXCITATION_FILE: json_bytes(excitation_json(excitation), indent=2)}
    return add_results(folder, contents, added, force=force)


def excitation_json(excitation: Excitation) -> dict[str, Any]:
    """Return an excitation ready for JSON, SI units but where a key says otherwise."""
    content = plain(excitation, "cmbot.save_excitation")
    return {"format": _FORMAT, "cmbot": __version__, "rms_mm": excitation.rms_mm, **content}
