"""A folder for a reproduction: both plan directories, and the comparison as Markdown and as JSON."""

from __future__ import annotations

from pathlib import Path

from cmbot.archive import add_file, require_free, save, save_tracking, write_file
from cmbot.archive.strict_json import json_bytes
from cmbot.common.errors import ArchiveError
from cmbot.reproduction.experiment import Reproduction
from cmbot.reproduction.paper import PAPER
from cmbot.reproduction.report import as_json, markdown
from cmbot.views import pages

__all__ = ["require_room", "save_reproduction"]

_PAGE, _FIGURES = "reproduce.md", "reproduce.json"


def require_room(directory: str | Path, *, force: bool = False) -> None:
    """Refuse a folder in which `save_reproduction` would find something in the way.

    Parameters
    ----------
    directory : str or Path
    force : bool
        An earlier reproduction may be there.

    Raises
    ------
    ArchiveError
        When something is in the way.
    """
    folder = Path(directory)
    for paper in PAPER:
        require_free(folder / paper.scene, force=force)
    for name in (_PAGE, _FIGURES):
        if (folder / name).exists() and not force:
            expected = "a new folder; --force (in Python force=True) replaces a reproduction"
            raise ArchiveError(str(folder / name), "", "a file that is already there", expected)


def save_reproduction(
    reproduction: Reproduction, directory: str | Path, *, force: bool = False
) -> tuple[Path, Path]:
    """Write both plan directories with their tracking errors and pages, then the comparison.

    Each file and each plan directory appears whole or not at all.

    Parameters
    ----------
    reproduction : Reproduction
    directory : str or Path
        Made as needed.
    force : bool
        Replace an earlier reproduction.

    Returns
    -------
    tuple of Path
        Of ``reproduce.md`` and ``reproduce.json``.

    Raises
    ------
    ArchiveError
        When something is in the way, or the system refuses.
    """
    folder = Path(directory)
    require_room(folder, force=force)
    for experiment in reproduction.experiments:
        target = folder / experiment.paper.scene
        save(experiment.planned.plan, target, force=force)
        save_tracking(experiment.planned.equilibrium, target)
        for name, page in pages(experiment.planned.plan, experiment.planned.equilibrium).items():
            add_file(target, name, page)
    write_file(folder / _FIGURES, json_bytes(as_json(reproduction), indent=2))
    write_file(folder / _PAGE, markdown(reproduction).encode())
    return folder / _PAGE, folder / _FIGURES
