"""What the YAML reader refuses, and that it names the place."""

import os
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from cmbot.common.errors import ModelError, SceneError
from cmbot.common.reading import yaml_reader
from cmbot.common.reading.yaml_reader import LARGEST_FILE, read_yaml, yaml_text, yaml_value


def refused(folder: Path, content: str | bytes) -> SceneError:
    path = folder / "file.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(SceneError) as caught:
        read_yaml(path, SceneError)
    error = caught.value
    assert error.source == str(path)
    assert "\n" not in str(error)
    return error


_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers(-(10**9), 10**9)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(categories=("L", "N", "P", "Zs", "S")), max_size=20)
    | st.sampled_from(["on", "null", "010", "1e3", "12:30", "~", "- a", "a: b", "#", "\n"])
)
_KEYS = st.text("abc_1", min_size=1, max_size=5) | st.just("on")


@given(
    st.dictionaries(
        _KEYS,
        st.recursive(
            _SCALARS, lambda some: st.lists(some, max_size=4) | st.dictionaries(_KEYS, some, max_size=4)
        ),
        max_size=5,
    )
)
@settings(max_examples=30, deadline=None)
def test_what_is_written_is_read_again(data):
    shared = [1.0, 2.0]
    data = data | {"one": shared, "two": shared, "three": {"a": shared}}
    text = yaml_text(data)
    assert yaml_value(text, "text", SceneError) == data
    assert "\n" + "two: [1.0, 2.0]" in text


def test_plain_data_in_yaml_1_2(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("a: [1, 2.5, 1e3, yes, true, ~]\nb: {c: 010, d: 'x', '1': 12:30}\n")
    data = read_yaml(path, SceneError)
    assert data == {"a": [1, 2.5, 1000.0, "yes", True, None], "b": {"c": 10, "d": "x", "1": "12:30"}}
    assert [type(item) for item in data["a"]] == [int, float, float, str, bool, type(None)]
    path.write_bytes(b"\xef\xbb\xbfa: 1\n")  # a byte order mark
    assert read_yaml(path, SceneError) == {"a": 1}


@pytest.mark.parametrize(
    ("content", "key", "got"),
    [
        ("a: 1\nb:\n  c: 1\n  c: 2\n", "b.c", "the same key again (line 4)"),
        ("a: 1\n'a': 2\n", "a", "the same key again (line 2)"),
        ("a: &x 1\nb: 2\n", "a", "the anchor &x (line 1)"),
        ("a: [1, *x]\n", "a[1]", "the alias *x (line 1)"),
        ("a: !!float 1\n", "a", "the tag 'tag:yaml.org,2002:float' (line 1)"),
        ("a: {b: !python/object:os.system x}\n", "a.b", "the tag '!python/object:os.system'"),
        ("%YAML 1.1\n---\na: yes\n", "", "a % directive"),
        ("a: 1\n---\nb: 2\n", "", "a second document (line 2)"),
        ("1: a\n", "", "the key '1' (line 1)"),
        ("a:\n- true: a\n", "a[0]", "the key 'true' (line 2)"),
        ("a:\n  ~: a\n", "a", "the key '~'"),
        ("? [1, 2]\n: a\n", "", "a list or mapping as key"),
        ("<<: {a: 1}\n", "", "the key '<<'"),
        ("a: [0, .nan]\n", "a[1]", "'.nan' (line 1)"),
        ("a: {b: -.inf}\n", "a.b", "'-.inf'"),
        ("a: 1.0e999\n", "a", "'1.0e999'"),
        ("a: 2020-01-31\n", "a", "the date '2020-01-31'"),
        ("a: 2020-13-31\n", "a", "'2020-13-31'"),
        (f"a: {'1' * 5000}\n", "a", "'1111"),
        ("a: " + "[" * 1000 + "]" * 1000, "a[0][0]", "nesting too deep"),
        ("a:\n" + "".join(" " * n + "- \n" for n in range(400)), "a[0][0]", "nesting too deep"),
        ("{" * 1000, "", "a list or mapping as key (line 1)"),
        ("a:\n  ? b: 1\n  : 2\n", "a", "a list or mapping as key (line 2)"),
        ("", "", "an empty file"),
        ("# only a comment\n", "", "an empty file"),
        ("---\n", "", "an empty file"),
        ("- 1\n- 2\n", "", "[1, 2]"),
        ("words\n", "", "'words'"),
        (
            "a: [1, 2\nb: 3\n",
            "",
            "':' where ',' or ']' should be, while parsing a flow sequence (column 2) (line 2)",
        ),
        ("- 1\nb: 3\n", "", "a key where the end of the block above should be, while parsing a block coll"),
        ("a:\n  b: 1\n c: 2\n", "", "a key that is indented otherwise where the end of the block above"),
        ("a: 1\nb\nc: 2\n", "", "no ':', while scanning a simple key (column 1) (line 3)"),
        (
            "a: 'x\n",
            "",
            "unexpected end of stream, while scanning a quoted scalar (column 1) (line 2)",
        ),
        ("a: b: c\n", "", "mapping values are not allowed here (column 5) (line 1)"),
        ("a: \x07\n", "", "a control character (U+0007, at position 4)"),
        (b"a: \xff\n", "", "a byte that is not UTF-8 (byte 3)"),
    ],
)
def test_refused_content(tmp_path, content, key, got):
    error = refused(tmp_path, content)
    assert error.key == key
    assert got in f"{error.got} (line {error.line})"
    assert error.expected


def test_too_many_values_are_refused(tmp_path, monkeypatch):
    """With a smaller bound: to read as many as are allowed takes seconds."""
    assert yaml_reader._MAX_YAML_VALUES == 100_000
    monkeypatch.setattr(yaml_reader, "_MAX_YAML_VALUES", 1000)
    error = refused(tmp_path, "a: [" + "0," * 1000 + "]")
    assert (error.key, error.got, error.line) == ("a[997]", "more values", 1)
    assert error.expected == "at most 1000 in a file"
    # The mapping, its key and the list count, too.
    path = tmp_path / "file.yaml"
    path.write_text("a: [" + "0," * 997 + "]")
    assert len(read_yaml(path, SceneError)["a"]) == 997


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("none.yaml", "none.yaml: no such file"),
        (".", "got a folder, expected a file"),
        ("pipe", "not a regular file"),  # reading one may never end
        ("file.yaml/below", "cannot be read"),  # an OSError for root, too
    ],
)
@pytest.mark.parametrize("error", [SceneError, ModelError])
def test_what_is_no_readable_file(tmp_path, name, message, error):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "file.yaml").write_text("a: 1\n")
    with pytest.raises(error, match=message) as caught:
        read_yaml(tmp_path / name, error)
    if name == "none.yaml":
        assert caught.value.got == "no such file"
        assert isinstance(caught.value.__cause__, FileNotFoundError)


def test_too_large(tmp_path):
    error = refused(tmp_path, b"#" * (LARGEST_FILE + 1))
    assert (error.got, error.expected) == ("a larger file", "at most 2 MB")


PIECES = [*"{}[]:,-#&*!|>'\"%@`?\\\n\t 0aA.~<=", "---", "%TAG ! x\n", "<<: ", "? ", "\\x", "\x00", "0x", "1_"]


@settings(deadline=None)
@given(pieces=st.lists(st.sampled_from(PIECES) | st.text(max_size=3), max_size=12))
def test_any_text_is_read_or_refused(tmp_path_factory, pieces):
    scratch = tmp_path_factory.getbasetemp() / "fuzz.yaml"
    scratch.write_bytes("".join(pieces).encode("utf-8", "surrogatepass"))
    try:
        data = read_yaml(scratch, SceneError)
    except SceneError as error:
        assert "\n" not in str(error)
    else:
        assert all(isinstance(key, str) for key in data)
