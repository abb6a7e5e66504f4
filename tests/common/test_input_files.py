"""Only regular files of bounded size are read; nothing waits for a pipe or a device."""

import os
from pathlib import Path

import pytest

from cmbot.common.errors import ModelError
from cmbot.common.input_files import read_input, require_input

READERS = (read_input, require_input)


@pytest.mark.parametrize("read", READERS)
@pytest.mark.parametrize(
    ("name", "got"),
    [
        ("pipe", "something that is not a regular file"),
        ("/dev/zero", "something that is not a regular file"),
        ("folder", "a folder"),
        ("none", "no such file"),
        ("file/below", "a file that cannot be read"),
        ("a\0b", "a file that cannot be read"),
        ("n" * 300, "a file that cannot be read"),
        ("long", "a larger file"),
    ],
)
def test_what_is_not_read(tmp_path: Path, read, name: str, got: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "long").write_bytes(b"123456")
    with pytest.raises(ModelError) as caught:
        read(tmp_path / name, ModelError, kind="a URDF", key="model", largest=5)
    assert (caught.value.source, caught.value.key) == (str(tmp_path / name), "model")
    assert str(caught.value.got).startswith(got)
    assert caught.value.expected == ("at most 5e-06 MB" if name == "long" else "a URDF")


def test_a_file_of_the_largest_size_is_read(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_bytes(b"12345")
    assert read_input(file, ModelError, largest=5) == b"12345"
    require_input(file, ModelError, largest=5)


def test_files_without_a_size_are_read_to_the_bound() -> None:
    """Those of the system say that they are empty."""
    status = Path("/proc/self/status")
    assert read_input(status, ModelError).startswith(b"Name:")
    with pytest.raises(ModelError, match="a larger file"):
        read_input(status, ModelError, largest=10)


def test_only_files_for_other_libraries_must_not_be_empty(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    assert read_input(file, ModelError) == b""
    with pytest.raises(ModelError, match="got an empty file, expected a mesh file"):
        require_input(file, ModelError, kind="a mesh file")
