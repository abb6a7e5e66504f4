"""Only regular files of bounded size are read; nothing waits for a pipe or a device."""

import os
from pathlib import Path

import pytest

from cmbot.archive import write_file
from cmbot.common.errors import InputError, ModelError
from cmbot.common.reading.input_files import read_input, require_input
from cmbot.views import write_page

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


def test_no_device_is_replaced_by_a_file(tmp_path: Path) -> None:
    """As root, /dev/null would be gone."""
    pipe, link = tmp_path / "pipe", tmp_path / "link"
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for place in (pipe, link):
        for write in (lambda path: write_file(path, b"x"), lambda path: write_page(path, "x")):
            with pytest.raises(InputError, match="something that is not a regular file"):
                write(place)
    assert pipe.is_fifo()
    assert link.is_symlink()
    # What a link leads to is replaced, not the link.
    link.unlink()
    (tmp_path / "file").touch()
    link.symlink_to(tmp_path / "file")
    for write in (lambda path: write_file(path, b"x"), lambda path: write_page(path, "x")):
        write(link)
        assert link.is_symlink()
        assert (tmp_path / "file").read_text() == "x"
    assert {path.name for path in tmp_path.iterdir()} == {"pipe", "link", "file"}
