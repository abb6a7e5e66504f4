"""Numbers as text are what Python's `repr` has."""

import json

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from cmbot.archive.motion_files import number_rows


@given(arrays.arrays(np.float64, st.tuples(st.integers(0, 6), st.integers(1, 6))))
def test_every_number_is_its_repr(table: np.ndarray) -> None:
    assert number_rows(table) == [list(map(repr, row)) for row in table.tolist()]


def test_sizes_at_which_the_form_changes() -> None:
    numbers = np.outer([1.0, -1.0, 1 + 2**-52, 1 - 2**-53], 10.0 ** np.arange(-30, 30))
    assert number_rows(numbers) == [list(map(repr, row)) for row in numbers.tolist()]
    assert number_rows(numbers) == [list(map(json.dumps, row)) for row in numbers.tolist()]
