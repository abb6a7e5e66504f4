"""An excitation in the directory of its plan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from cmbot.archive.folder import read_folder
from cmbot.archive.places import add_results
from cmbot.archive.records import EXCITATION_FILE, PLAN_FILE, json_bytes, read_json
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import given_path, require_type, shown, validated
from cmbot.excitation import Excitation
from cmbot.version import __version__

_EXCITATION_FORMAT = "cmbot-excitation/1"


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


def load_excitation(directory: str | Path) -> Excitation | None:
    """Read the excitation beside a plan.

    Parameters
    ----------
    directory : str or Path

    Returns
    -------
    Excitation or None
        None where there is none.

    Raises
    ------
    InputError
        When `directory` is no path.
    ArchiveError
        When a file is missing, damaged or of another version.

    Examples
    --------
    >>> excitation = cmbot.load_excitation("out/triangle")
    """
    folder = given_path(directory, "cmbot.load_excitation", "directory", "the path of a plan directory")
    _, contents = read_folder(folder, PLAN_FILE, lambda hashes: {EXCITATION_FILE} & hashes.keys())
    if not contents:
        return None
    source = str(folder / EXCITATION_FILE)
    data = read_json(contents[EXCITATION_FILE], source)
    if data.get("format") != _EXCITATION_FORMAT:
        raise ArchiveError(source, "format", shown(data.get("format")), repr(_EXCITATION_FORMAT))
    return validated(Excitation, data, source, ArchiveError)


def excitation_json(excitation: Excitation) -> dict[str, Any]:
    """Return an excitation ready for JSON, SI units but where a key says otherwise."""
    content = TypeAdapter(Excitation).dump_python(excitation, mode="json")
    return {"format": _EXCITATION_FORMAT, "cmbot": __version__, "rms_mm": excitation.rms_mm, **content}
