"""Tables of text as programs and loggers write them."""

from pathlib import Path

import numpy as np
import pytest

from cmbot.common.errors import InputError
from cmbot.common.reading.text_table import TextTable, read_table

ROWS = [[0.5, -1.25, 3e-4], [1.5, 2.0, -7.0]]


def _written(separator: str, comma: bool, heading: str) -> str:
    lines = [separator.join(f"{x:.6g}" for x in row) for row in ROWS]
    text = "\n".join(lines).replace(".", ",") if comma else "\n".join(lines)
    return f"{heading}\n{text}\n"


@pytest.mark.parametrize(
    ("separator", "comma"), [(",", False), (";", False), (";", True), ("\t", True), (" ", False)]
)
@pytest.mark.parametrize("heading", ["", "# of a logger\n#a{0}B{0}c", "\ufeffa{0}B{0}c\n", "\n\nA{0}b{0}c"])
def test_the_same_table_however_it_is_written(
    separator: str, comma: bool, heading: str, tmp_path: Path
) -> None:
    file = tmp_path / "table.txt"
    file.write_text(_written(separator, comma, heading.format(separator)), encoding="utf-8")
    table = read_table(file, InputError, kind="a table")
    np.testing.assert_array_equal(table.numbers([0, 1, 2]), ROWS)
    assert table.names == (("a", "b", "c") if heading else ())


def test_units_quotes_and_comments_between_rows(tmp_path: Path) -> None:
    file = tmp_path / "phyphox.csv"
    file.write_text('"Time (s)","a [m/s^2]"\n0,1\n\n# a gap\n0.1,2\n', encoding="utf-8")
    table = read_table(file, InputError, kind="a table")
    assert (table.names, table.units, table.lines) == (("time", "a"), ("s", "m/s^2"), (2, 5))
    assert table.index("t", "time") == 0 and table.index("b") is None


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "an empty file"),
        (b"a,b\nc,d\n", "no row of numbers"),
        (b"a,b\n1,2\n3\n", "line 3: got 1 cell, expected 2 cells, as in line 2"),
        (b"a,b\n1,2\n3,x\n", "line 3, b: got 'x'"),
        (b"a,b\n1,2\n3,nan\n", "line 3, b: got 'nan'"),
        (b"1,2\n3,x\n", "line 2, column 2"),
        (b"\xff\xfe1,2\n", "cannot be read"),
    ],
)
def test_what_is_no_table(content: bytes, told: str, tmp_path: Path) -> None:
    file = tmp_path / "table.csv"
    file.write_bytes(content)
    with pytest.raises(InputError, match=told):
        read_table(file, InputError, kind="a table").numbers([0, 1])


def test_units_of_places_end_their_names(tmp_path: Path) -> None:
    file = tmp_path / "t.csv"
    file.write_text("x_mm,Y/cm,dz (um),steel_mm\n1,2,3,4\n", encoding="utf-8")
    table = read_table(file, InputError, kind="a table")
    assert table.names == ("x", "y", "dz", "steel_mm")
    assert table.units == ("mm", "cm", "um", "")
    file.write_text("x,y\n1,\n,2\n", encoding="utf-8")
    table = read_table(file, InputError, kind="a table")
    np.testing.assert_array_equal(table.numbers([0, 1], gaps=True), [[1, np.nan], [np.nan, 2]])
    with pytest.raises(InputError, match="line 2, y: got '', expected a finite number"):
        table.numbers([0, 1])


def test_units_of_joints_count_and_a_column_is_there_once(tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"

    def read(heading: str) -> TextTable:
        file.write_text(f"{heading}\n90,0.5,100\n180,0.25,200\n", encoding="utf-8")
        return read_table(file, InputError, kind="a table")

    for heading in ("q1 (deg),q2 [rad],lift (mm)", "q1_deg,q2,q3 (mm)", "turn (°),shift (m),LIFT (mm)"):
        q, columns = read(heading).joints(["turn", "shift", "lift"])
        np.testing.assert_allclose(q, [[np.pi / 2, 0.5, 0.1], [np.pi, 0.25, 0.2]])
        assert columns == [0, 1, 2]
    with pytest.raises(InputError, match=r"line 1, q2: got the unit grad, expected rad, deg, or of a joint"):
        read("q1,q2 (grad),q3").joints(["turn", "shift"])
    with pytest.raises(InputError, match=r"line 1, q1: got 2 columns of this name, expected one"):
        read("q1,q2,Q1").joints(["turn", "shift"])


def test_units_of_times_count(tmp_path: Path) -> None:
    file = tmp_path / "record.csv"

    def seconds(heading: str) -> list[float]:
        file.write_text(f"{heading}\n0,1\n500,2\n", encoding="utf-8")
        return list(read_table(file, InputError, kind="a table").seconds(0))

    assert seconds("t,a") == seconds("Time (s),a") == [0.0, 500.0]
    assert seconds("t [ms],a") == [0.0, 0.5]
    with pytest.raises(InputError, match=r"line 1, t: got the unit min, expected s, ms or us"):
        seconds("t (min),a")
