"""What a test finds does not depend on chance or on the tests before it."""

import importlib
from pathlib import Path

import pytest
from hypothesis import given, strategies as st


def test_examples_do_not_depend_on_what_other_tests_have_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = list[tuple[int, float, str]]()

    @given(st.integers(), st.floats(), st.text())
    def property_of_anything(number: int, real: float, text: str) -> None:
        drawn.append((number, hash(real) if real == real else 0, text))

    property_of_anything()
    before, drawn[:] = tuple(drawn), []
    constants = ", ".join(f"{77_000_017 * k}, {k}.0625, 'a word {k}'" for k in range(1, 100))
    (tmp_path / "numbers_of_others.py").write_text(f"NUMBERS = ({constants})\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    importlib.import_module("numbers_of_others")
    property_of_anything()
    assert tuple(drawn) == before
