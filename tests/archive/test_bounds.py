"""What a plan directory may cost: hashes are checked first, sizes and shapes before anything is unpacked."""

import io
import os
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from plan_folders import FILES, edit, refused, rewrite

from cmbot.archive import load_plan
from cmbot.archive.knots import read_knots
from cmbot.archive.records import read_json
from cmbot.common.errors import ArchiveError

MEGABYTE = 2**20


def compressed(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def members(*contents: tuple[str, bytes]) -> bytes:
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # the same name twice is what is tested
        for name, content in contents:
            archive.writestr(name, content)
    return file.getvalue()


def array(descr: str = "'<f8'", shape: str = "(3,)", numbers: bytes = bytes(24)) -> bytes:
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + numbers


def knots(t: bytes) -> bytes:
    rest = array(shape="(3, 1)")
    return members(("t.npy", t), ("q.npy", rest), ("v.npy", rest), ("a.npy", rest))


@pytest.mark.parametrize(
    ("content", "key", "word"),
    [
        (
            knots(array(shape="(40000000,)", numbers=bytes(100))),
            "t",
            "shape (40000000,), expected 2 to 100000",
        ),
        (knots(array(shape="(999999999999,)")), "t", "2 to 100000 knots"),
        (knots(array(numbers=bytes(32))), "t", "more numbers"),
        (knots(array(numbers=bytes(16))), "t", "fewer numbers"),
        (knots(array(numbers=bytes(40_000_000))), "t", "more numbers"),
        (knots(array(shape="(3, 1)")), "t", "shape (3, 1)"),
        (knots(array(shape="()", numbers=bytes(8))), "t", "one or two dimensions"),
        (knots(array(shape="(1,)", numbers=bytes(8))), "t", "2 to 100000 knots"),
        (knots(array(descr="'>f8'")), "t", "of float64"),
        (knots(array(descr="[('x', '<f8')]")), "t", "of float64"),
        (knots(array(descr="__import__('os')")), "t", "of float64"),
        (knots(b"\x93NUMPY\x02\x00" + bytes(30)), "t", "version 1.0"),
        (knots(b"\x93NUM"), "t", "version 1.0"),
        (knots(b"\x93NUMPY\x01\x00\xff\xff" + b" " * 65535), "t", "of float64"),
        (members(*((f"{k}.npy", b"") for k in range(90))), "", "the members '0.npy"),
        (members(*((f"{k}.npy", b"") for k in range(200))), "", "many members"),
        (members(*[("t.npy", array())] * 4), "", "the members 't.npy, t.npy"),
        (members(("../t.npy", array()), ("q.npy", b""), ("v.npy", b""), ("a.npy", b"")), "", "the members"),
    ],
)
def test_knots_are_checked_before_they_are_unpacked(content: bytes, key: str, word: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(ArchiveError) as caught:
            read_knots(content, "FILE", 1)
        assert tracemalloc.get_traced_memory()[1] < MEGABYTE
    finally:
        tracemalloc.stop()
    assert (caught.value.source, caught.value.key) == ("FILE", key)
    assert word in str(caught.value)
    assert len(str(caught.value)) < 250


def test_compressed_and_transposed_knots_are_read() -> None:
    t, q = np.arange(4.0), np.arange(8.0).reshape(2, 4).T
    trajectory = read_knots(compressed(t=t, q=q, v=q, a=q), "FILE", 2)
    np.testing.assert_array_equal(trajectory.q, q)
    np.testing.assert_array_equal(trajectory.t, t)


def test_values_in_messages_are_short(short_folder: Path) -> None:
    n = 50_000
    content = compressed(t=np.zeros(n), q=np.zeros((n, 7)), v=np.zeros((n, 7)), a=np.zeros((n, 7)))
    rewrite(short_folder, "job.npz", content)
    assert len(str(refused(short_folder, "job.npz", "t"))) < 1000


@pytest.mark.parametrize("name", sorted(FILES - {"plan.json"}))
def test_hashes_are_checked_before_content(triangle_folder: Path, name: str) -> None:
    """Nothing is said about what is in a file that is not the one that was saved."""
    (triangle_folder / name).write_bytes(b"no table, no array")
    error = refused(triangle_folder, name, "")
    assert (error.got, error.expected) == ("other content", "the file that was saved with plan.json")


@pytest.mark.parametrize("name", sorted(FILES))
def test_larger_files_than_a_plan_has(short_folder: Path, name: str) -> None:
    """A sparse file: it takes no space, but reading it would."""
    os.truncate(short_folder / name, 10**12)
    error = refused(short_folder, name, "")
    assert error.got == "a larger file"
    assert error.expected == ("at most 20 MB" if name == "plan.json" else "at most 500 MB")


@pytest.mark.parametrize("name", sorted(FILES))
def test_pipes_in_place_of_files(short_folder: Path, name: str) -> None:
    (short_folder / name).unlink()
    os.mkfifo(short_folder / name)
    assert "not a regular file" in str(refused(short_folder, name, ""))


@pytest.mark.parametrize("key", ["passes", "fallbacks", "strange"])
def test_a_plan_file_of_many_zeros(short_folder: Path, key: str) -> None:
    edit(short_folder, lambda data: data.update({key: [0] * 250_000}))
    assert "more values, expected at most 200000" in str(refused(short_folder, "plan.json", ""))


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b'{"a":' + b"[" * 150_000, "recursion limit"),
        (b'["' + b"[" * 1000 + b'"]', "a JSON object"),  # brackets in a string
        (b'"' * 1_000_001, "no JSON"),
        (b'"' + b"\\" * 1_000_001, "no JSON"),
        (b"[" * 500_000, "more values"),
        (b"{" + b'"k": 0,' * 250_000, "more values"),
    ],
)
def test_depth_and_numbers_of_json(content: bytes, word: str) -> None:
    with pytest.raises(ArchiveError, match=word):
        read_json(content, "FILE")


def test_the_saved_plan_is_within_the_bounds(saved_triangle: Path) -> None:
    load_plan(saved_triangle)
