"""What is refused of knots and tables, and the digits that numbers have in them."""

import io
import zipfile
from decimal import Decimal
from itertools import chain
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, strategies as st
from hypothesis.extra import numpy as arrays
from plan_folders import npz

from cmbot.archive.knots import read_knots
from cmbot.archive.tables import columns, read_motion, table_csv
from cmbot.common.errors import ArchiveError
from cmbot.trajectory import LARGEST


def knots_with(**changes):
    """Function of the good knots that returns the file with some of them changed."""

    def content(knots):
        arrays = {name: change(knots[name]) for name, change in changes.items()}
        return npz(**{**{name: knots[name] for name in knots.files}, **arrays})

    return content


def in_place(index, value):
    def change(array):
        array = array.copy()
        array[index] = value
        return array

    return change


def member_without_header(knots):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in knots.files:
            archive.writestr(f"{name}.npy", b"0123456789")
    return file.getvalue()


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (lambda knots: b"", ""),
        (lambda knots: b"not a zip file", ""),
        (lambda knots: npz(**knots)[:5000], ""),
        (lambda knots: npz(t=knots["t"], q=knots["q"]), ""),
        (lambda knots: npz(**knots, extra=knots["a"]), ""),
        (knots_with(q=lambda q: q.astype(object)), "q"),
        (member_without_header, "t"),
        (knots_with(q=lambda q: q.astype(np.float32)), "q"),
        (knots_with(q=lambda q: q.astype(str)), "q"),
        (knots_with(q=lambda q: q[:-1]), "q"),
        (knots_with(v=lambda v: v[:, :6]), "v"),
        (knots_with(a=in_place((3, 2), np.nan)), "a"),
        (knots_with(t=in_place(3, 0.0)), "t"),
        (knots_with(t=in_place(3, np.inf)), "t"),
        (knots_with(q=lambda q: q[:, :6], v=lambda v: v[:, :6], a=lambda a: a[:, :6]), "q"),
    ],
)
def test_damaged_knots(saved_triangle, content, key):
    with np.load(saved_triangle / "job.npz") as knots:
        damaged = content(knots)
    with pytest.raises(ArchiveError) as caught:
        read_knots(damaged, "FILE", 7)
    assert (caught.value.source, caught.value.key) == ("FILE", key)


def test_lone_arrays_and_pickles_are_not_opened(saved_triangle, tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "sprung",))

    lone = io.BytesIO()
    np.save(lone, np.zeros(3))
    with np.load(saved_triangle / "job.npz") as knots:
        pickled = npz(**{**knots, "q": np.array([Trap()], dtype=object)})
    for content, words in ((lone.getvalue(), "not a zip file"), (pickled, "FILE: q: got one of object")):
        with pytest.raises(ArchiveError, match=words):
            read_knots(content, "FILE", 7)
    assert not (tmp_path / "sprung").exists()


def cell(row, column, value):
    def change(lines):
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return change


@pytest.mark.parametrize(
    ("change", "key"),
    [
        (lambda lines: [], "line 1"),
        (lambda lines: lines[1:], "line 1"),
        (lambda lines: [lines[0].replace("tau1", "torque1"), *lines[1:]], "line 1"),
        (lambda lines: lines[:1], "t"),
        (lambda lines: lines[:2], "t"),
        (lambda lines: [*lines[:5], *lines[6:4:-1], *lines[7:]], "t"),
        (lambda lines: [*lines[:-1], lines[-1][:40]], "line 2002"),
        (cell(3, 2, "fast"), "line 4, q2"),
        (cell(3, 2, ""), "line 4, q2"),
        (cell(3, 2, "nan"), "line 4, q2"),
        (cell(3, 2, "1e300"), "line 4, q2"),
        (cell(3, -1, "nan"), "line 4, clearance"),
        (cell(3, -1, "-inf"), "line 4, clearance"),
        (cell(3, -2, "inf"), "line 4, tool_z"),
        (cell(3, 0, "nan"), "t"),
        (cell(3, 2, "é"), ""),
    ],
)
def test_damaged_tables(saved_triangle, change, key):
    lines = (saved_triangle / "baseline.csv").read_text().splitlines()
    with pytest.raises(ArchiveError) as caught:
        read_motion("\n".join([*change(lines), ""]).encode(), "FILE", 7)
    assert (caught.value.source, caught.value.key) == ("FILE", key)


def test_nothing_but_a_clearance_may_be_infinite():
    names = columns(1, compensated=True)
    table = np.zeros((2, len(names)))
    table[:, names.index("clearance")] = np.inf
    assert table_csv(names, table, "FILE").count(b"inf") == 2
    table[1, -1] = np.inf
    with pytest.raises(ArchiveError, match="FILE: line 3, expected_tool_z: got inf"):
        table_csv(names, table, "FILE")


@given(arrays.arrays(np.float64, st.tuples(st.integers(0, 6), st.integers(1, 6))))
# Sizes at which the form changes.
@example(np.outer([1.0, -1.0, 1 + 2**-52, 1 - 2**-53], 10.0 ** np.arange(-30, 30)))
def test_every_number_has_the_digits_of_its_repr(table: np.ndarray) -> None:
    """They read back as the same bits, also the sign of zero."""
    table = table[np.isfinite(table).all(axis=1) & (np.abs(table) <= LARGEST).all(axis=1)]
    names = tuple(f"column_{k}" for k in range(table.shape[1]))
    header, *lines = table_csv(names, table, "FILE").decode().splitlines()
    assert header == ",".join(names)
    cells = [line.split(",") for line in lines]
    read = np.array([list(map(float, row)) for row in cells]).reshape(table.shape)
    assert read.tobytes() == np.ascontiguousarray(table).tobytes()
    for cell, number in zip(chain.from_iterable(cells), table.ravel().tolist(), strict=True):
        digits, shortest = (Decimal(text).normalize().as_tuple().digits for text in (cell, repr(number)))
        assert digits == shortest


@given(arrays.arrays(np.float64, (4, 3), elements=st.floats(-1e6, 1e6)))
def test_numbers_of_some_digits_are_no_further_off(table: np.ndarray) -> None:
    """Nine digits, and nine after the point; the others have their own number."""
    text = table_csv(("t", "q", "clearance"), table, "FILE", (None, 9, 9), ["a", "b", "c", "c"]).decode()
    header, *rows = text.splitlines()
    assert header == "t,q,clearance,segment"
    assert [row.rsplit(",", 1)[1] for row in rows] == ["a", "b", "c", "c"]
    read = np.array([list(map(float, row.split(",")[:3])) for row in rows])
    np.testing.assert_array_equal(read[:, 0], table[:, 0])
    for column in (1, 2):
        allowed = 1e-9 * np.maximum(1.0, 10 * np.abs(table[:, column]))
        assert (np.abs(read - table)[:, column] <= allowed).all()
        for row in rows:
            number = Decimal(row.split(",")[column]).as_tuple()
            assert len(number.digits) <= 9
            assert number.exponent >= -9
