"""A job's knots as a NumPy .npz file, from which the quintics of every segment are built again."""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.lib import format as npy

from cmbot.archive.plan_file import SegmentFile
from cmbot.archive.records import PLAN_FILE
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import ArchiveError, InputError
from cmbot.common.reading.validation import counted, shown
from cmbot.planning import QuinticTrajectory
from cmbot.scene import Stroke

# Relative tolerance of times.
_SAME_T = 1e-9
_KNOT_ARRAYS = ("t", "q", "v", "a")
# Several times as many as a scene may have via-points.
_MOST_KNOTS = 100_000
# Beside its arrays a file has their names and places, bytes.
_MOST_BESIDE = 1000
# Of the header of a member: how it begins, its size, and where the sizes of its name and its fields are.
_ZIP_MEMBER, _HEADER, _SIZES_AT = b"PK\x03\x04", 30, 26
# Begins an entry of the directory at a zip file's end; few numbers contain it by chance.
_ZIP_ENTRY, _MOST_ENTRIES = b"PK\x01\x02", 100
# What zipfile raises for a file that is damaged or no .zip at all.
_ZIP_ERRORS = (
    EOFError,
    KeyError,
    NotImplementedError,
    OSError,
    RuntimeError,
    ValueError,
    zipfile.BadZipFile,
    zlib.error,
)


def knots_npz(trajectory: QuinticTrajectory) -> bytes:
    """Return a trajectory's knots as .npz: they define the quintics exactly; nothing is pickled."""
    file = io.BytesIO()
    np.savez(file, t=trajectory.t, q=trajectory.q, v=trajectory.v, a=trajectory.a)
    return file.getvalue()


def segment_trajectories(
    segments: Sequence[SegmentFile],
    times: FloatArray,
    content: bytes,
    source: str,
    dof: int,
    strokes: Sequence[Stroke],
) -> tuple[QuinticTrajectory, ...]:
    """Return the trajectory of each segment of a job, on its own clock, from the `content` of ``job.npz``.

    Segments begin and end at `times`, s, one more than there are segments.

    Raises
    ------
    ArchiveError
        When it is damaged, or its times are not those of the segments and of the strokes' via-points.
    """
    whole = read_knots(content, source, dof)
    require_times(whole.t, times[-1], source, PLAN_FILE)
    trajectories, remaining = [], iter(strokes)
    for segment, *pair in zip(segments, times, times[1:], strict=False):
        ends = np.array(pair)
        first, end = (int(np.abs(whole.t - each).argmin()) for each in ends)
        if end <= first or (np.abs(whole.t[[first, end]] - ends) > _SAME_T * np.maximum(ends, 1.0)).any():
            expected = f"knots at {ends[0]:g} and {ends[1]:g} s ({segment.name})"
            raise ArchiveError(source, "t", "no knot where a segment begins or ends", expected)
        part = slice(first, end + 1)
        own = replace(
            whole, t=whole.t[part] - whole.t[first], q=whole.q[part], v=whole.v[part], a=whole.a[part]
        )
        if segment.kind == "stroke":
            stroke = next(remaining)
            require_times(own.t, stroke.path.duration, source, "the scene")
            if own.t.shape == stroke.via_times.shape and np.allclose(
                own.t, stroke.via_times, _SAME_T, _SAME_T
            ):
                # The sums on the job's clock are rounded.
                own = replace(own, t=stroke.via_times)
        trajectories.append(own)
    return tuple(trajectories)


def require_times(t: FloatArray, duration: float, source: str, whose: str) -> None:
    """Refuse times `t` (N,) of the file `source` that do not run from 0 to `duration`, s, as `whose` do."""
    if t[0] != 0.0 or abs(t[-1] - duration) > _SAME_T * duration:
        expected = f"0 to {duration:.12g} s, as in {whose}"
        raise ArchiveError(source, "t", f"{t[0]:g} to {t[-1]:.12g} s", expected)


def read_knots(content: bytes, source: str, dof: int) -> QuinticTrajectory:
    """Return the trajectory of `dof` joints whose knots are in a file's `content`; `source` is for messages.

    An `ArchiveError` is raised when the file is damaged, holds other arrays, or they are no knots. Names,
    types and shapes are checked before numbers are unpacked.
    """
    if content.count(_ZIP_ENTRY) > _MOST_ENTRIES:  # zipfile makes an object of each
        raise ArchiveError(source, "", "many members", f"the arrays {', '.join(_KNOT_ARRAYS)}")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _require_members(archive, source, content)
            knots = {name: _array(archive, name, source, dof) for name in _KNOT_ARRAYS}
    except ArchiveError:
        raise
    except _ZIP_ERRORS as error:
        got = f"a damaged file ({shown(str(error))})"
        raise ArchiveError(source, "", got, "a NumPy .npz file") from error
    try:
        return QuinticTrajectory(**knots)
    except InputError as error:
        raise ArchiveError(source, error.key, error.got, error.expected) from error


def _require_members(archive: zipfile.ZipFile, source: str, content: bytes) -> None:
    names = archive.namelist()
    if sorted(names) != sorted(f"{name}.npy" for name in _KNOT_ARRAYS):
        got = shown(", ".join(names[: len(_KNOT_ARRAYS) + 1]))
        raise ArchiveError(source, "", f"the members {got}", f"the arrays {', '.join(_KNOT_ARRAYS)}")
    if (beside := len(content) - sum(member.compress_size for member in archive.infolist())) > _MOST_BESIDE:
        expected = f"the arrays alone, at most {_MOST_BESIDE} bytes beside them"
        raise ArchiveError(source, "", f"{beside} bytes beside its arrays", expected)
    # Some read the file from its beginning, and not by its directory: they would find what is in between.
    end = 0
    for member in sorted(archive.infolist(), key=lambda each: each.header_offset):
        sizes = struct.unpack_from("<HH", content, member.header_offset + _SIZES_AT)
        begin = member.header_offset + _HEADER
        if member.header_offset != end or content[begin : begin + sizes[0]] != member.filename.encode():
            break
        end = begin + sum(sizes) + member.compress_size
    if end != archive.start_dir or _ZIP_MEMBER in content[end:]:
        raise ArchiveError(source, "", "something between its arrays", "one after the other")


def _array(archive: zipfile.ZipFile, name: str, source: str, dof: int) -> FloatArray:
    """Return an array (n,) or (n, dof) of float64; of another one, only the header is unpacked."""
    expected = "an array of float64 in version 1.0 of NumPy's format, with one or two dimensions"
    with archive.open(f"{name}.npy") as member:
        try:
            version = npy.read_magic(member)
            shape, by_columns, kind = npy.read_array_header_1_0(member)
        except ValueError as error:
            raise ArchiveError(source, name, shown(str(error)), expected) from error
        if version != (1, 0) or kind != np.dtype("<f8") or len(shape) not in (1, 2):
            raise ArchiveError(source, name, f"one of {kind}, of shape {shape}", expected)
        if not 2 <= shape[0] <= _MOST_KNOTS or shape[1:] != (() if name == "t" else (dof,)):
            expected = f"2 to {_MOST_KNOTS} knots" + ("" if name == "t" else f" of {counted(dof, 'joint')}")
            raise ArchiveError(source, name, f"an array of shape {shape}", expected)
        size = 8 * math.prod(shape)
        numbers = member.read(size + 1)
        if len(numbers) != size:
            got = "fewer numbers" if len(numbers) < size else "more numbers"
            raise ArchiveError(source, name, got, f"an array of shape {shape}, as its header says")
    return np.frombuffer(numbers, kind).reshape(shape, order="F" if by_columns else "C")
