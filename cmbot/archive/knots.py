"""A trajectory's knots as a NumPy .npz file: enough to rebuild the quintics exactly; nothing is pickled."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import Any

import numpy as np

from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.validation import counted, shown
from cmbot.planning import QuinticTrajectory

__all__ = ["knots_npz", "read_knots"]

# What np.load raises for a file that is damaged or no .npz at all.
_DAMAGED = (
    EOFError,
    KeyError,
    MemoryError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


def knots_npz(trajectory: QuinticTrajectory) -> bytes:
    """Return the knots as such a file."""
    file = io.BytesIO()
    np.savez(file, t=trajectory.t, q=trajectory.q, v=trajectory.v, a=trajectory.a)
    return file.getvalue()


def read_knots(content: bytes, source: str, dof: int) -> QuinticTrajectory:
    """Return the trajectory whose knots are in a file's `content`.

    Parameters
    ----------
    content : bytes
    source : str
        The file, for messages.
    dof : int
        Number of the arm's joints.

    Raises
    ------
    ArchiveError
        When the file is damaged, holds other arrays, or no trajectory can be made of them.
    """
    knots = _arrays(content, source)
    if sorted(knots) != ["a", "q", "t", "v"]:
        raise ArchiveError(source, "", f"the arrays {', '.join(sorted(knots))}", "the arrays t, q, v, a")
    for name, array in knots.items():
        # A member without NumPy's header comes as bytes.
        if not isinstance(array, np.ndarray) or array.dtype != np.float64:
            got = getattr(array, "dtype", "no array")
            raise ArchiveError(source, name, got, "an array of float64")
    try:
        trajectory = QuinticTrajectory(**knots)
    except InputError as error:
        raise ArchiveError(source, error.key, error.got, error.expected) from error
    if trajectory.q.shape[1] != dof:
        raise ArchiveError(source, "q", counted(trajectory.q.shape[1], "joint"), counted(dof, "joint"))
    return trajectory


def _arrays(content: bytes, source: str) -> dict[str, Any]:
    try:
        file = np.load(io.BytesIO(content), allow_pickle=False)
        if isinstance(file, np.lib.npyio.NpzFile):
            return {name: file[name] for name in file.files}
    except _DAMAGED as error:
        raise ArchiveError(
            source, "", f"a damaged file ({shown(str(error))})", "a NumPy .npz file"
        ) from error
    raise ArchiveError(source, "", "a lone array", "a NumPy .npz file")
