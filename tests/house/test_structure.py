"""The rules of the structure see what they are for."""

from pathlib import Path

import pytest
import structure


def module(text: str) -> structure.Module:
    return structure.Module(Path("cmbot/planning/planner.py"), text)


def test_lines_of_code_are_neither_comments_nor_docstrings() -> None:
    text = '"""Says\nwhat it is."""\n\n# Why.\nx = 1  # m\ntext = """two\nlines"""\n'
    assert module(text).code_lines == {5, 6, 7}


@pytest.mark.parametrize(
    "text",
    [
        'late = "was over" in str(error)',
        'late = "the time" not in failure.reason',
        "late = _LATE in failure.reason",
        'near = failure.constraint.startswith("clearance")',
        'speed = check.quantity == "process speed"',
    ],
)
def test_text_that_steers_is_seen(text: str) -> None:
    assert list(structure.text_that_steers(module(text))) == [1]


@pytest.mark.parametrize(
    "text",
    ['raise Failure(failure.reason + "x")', "near = failure.pair == pair", 'same = name == "clearance"'],
)
def test_what_only_tells_does_not_steer(text: str) -> None:
    assert not list(structure.text_that_steers(module(text)))


@pytest.mark.parametrize(
    "text",
    [
        'other = stroke.model_copy(update={"name": "a"})',
        "stance = StanceFile.model_construct(foot_1=place)",
        "other = replace(plan.scene, name=name)",
        "other = dataclasses.replace(scene, name=name)",
    ],
)
def test_changes_past_the_checks_are_seen(text: str) -> None:
    assert list(structure.past_the_checks(module(text))) == [1]
    assert not list(structure.past_the_checks(module("plan = replace(plan, scene=scene.changed(name=name))")))


def test_constants_and_globals() -> None:
    text = "_STEP, _SAME = 1e-3, 2\nfound = {}\nKNOWN = {'a': 1}\nlog: list[str] = list()\n"
    assert dict(structure.private_constants(module(text))) == {"_STEP": "0.001", "_SAME": "2"}
    assert list(structure.mutable_globals(module(text))) == [2, 4]
    twice = [module("_STEP = 1"), module("_STEP = 2"), module("_SAME = 3"), module("_SAME = 3")]
    assert list(structure.constants_of_two_values(twice)) == ["_STEP: 1, 2"]


def test_long_functions_are_counted_without_docstrings() -> None:
    lines = "".join(f"    x = {k}\n" for k in range(59))
    assert not list(structure.functions_too_long(module(f'def f():\n    """Do."""\n{lines}')))
    assert list(structure.functions_too_long(module(f"def f():\n{lines}    x = 0\n"))) == [1]


def test_what_exceeds_its_limit_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values = {"files": 3, "code_lines_of.robot": 20}
    limits = tmp_path / "structure.toml"
    monkeypatch.setattr(structure, "LIMITS", limits)
    limits.write_text("# Why.\nfiles = 4\n[code_lines_of]\nrobot = 19\n", encoding="utf-8")
    assert list(structure.breaches(values)) == ["code_lines_of.robot: got 20, expected at most 19"]
    structure.lower(values)
    assert limits.read_text(encoding="utf-8") == "# Why.\nfiles = 3\n[code_lines_of]\nrobot = 19\n"
