"""The rules of the house, held by machines."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from browser import chromium
from importlinter.cli import EXIT_STATUS_SUCCESS, lint_imports

from cmbot.cli import COMMANDS
from cmbot.cli.command import flags_of

ROOT = Path(__file__).resolve().parent.parent.parent
FILES = sorted((ROOT / "cmbot").rglob("*.py"))
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
LONGEST_FILE = 800
# The files of the command line.
PRINTING = ROOT / "cmbot" / "cli"
# Its handler of SIGTERM exits.
MAIN = ROOT / "cmbot" / "__main__.py"
BROAD = {"Exception", "BaseException"}


def syntax(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def test_imports_point_downwards(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    status = lint_imports(config_filename=str(ROOT / "pyproject.toml"), no_cache=True)
    printed = capsys.readouterr().out
    assert status == EXIT_STATUS_SUCCESS, printed
    contracts = project()["tool"]["importlinter"]["contracts"]
    assert f"Contracts: {len(contracts)} kept, 0 broken." in printed


def test_oracles_know_neither_the_robot_nor_the_scene_of_the_package() -> None:
    named = {"cmbot.common.arrays", "cmbot.common.errors"}
    for path in (ROOT / "tests" / "oracles").glob("*.py"):
        for node in ast.walk(syntax(path)):
            parts = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            parts += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            assert {part for part in parts if part.startswith("cmbot")} <= named, path


def forbidden(tree: ast.AST, *, may_print: bool) -> Iterator[tuple[int, str]]:
    """Line and kind of what has no place in the package."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            yield node.lineno, "assert"
        elif isinstance(node, ast.ExceptHandler) and (node.type is None or BROAD & set(named(node.type))):
            yield node.lineno, "broad except"
        elif isinstance(node, ast.Call):
            called = set(named(node.func))
            if "print" in called and not may_print:
                yield node.lineno, "print"
            elif "exit" in called and not may_print:
                yield node.lineno, "exit"
            elif "suppress" in called and any(BROAD & set(named(argument)) for argument in node.args):
                yield node.lineno, "broad suppress"


def named(node: ast.AST) -> Iterator[str]:
    """The last parts of the names in an expression: of ``a.b`` it is b."""
    if isinstance(node, ast.Name):
        yield node.id
    elif isinstance(node, ast.Attribute):
        yield node.attr
    elif isinstance(node, ast.Tuple):
        for element in node.elts:
            yield from named(element)


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ("print(1)", "print"),
        ("console.print(1)", "print"),
        ("sys.exit(1)", "exit"),
        ("assert x", "assert"),
        ("try: x\nexcept: y", "broad except"),
        ("try: x\nexcept Exception: y", "broad except"),
        ("try: x\nexcept (KeyError, builtins.BaseException): y", "broad except"),
        ("with contextlib.suppress(Exception): x", "broad suppress"),
    ],
)
def test_the_search_finds_what_it_looks_for(code: str, kind: str) -> None:
    assert [found for _, found in forbidden(ast.parse(code), may_print=False)] == [kind]


def undocumented(node: ast.Module | ast.ClassDef, where: str = "") -> Iterator[str]:
    """Public functions, classes and methods without a docstring."""
    for inner in node.body:
        if isinstance(inner, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            if inner.name.startswith("_"):
                continue
            if ast.get_docstring(inner) is None:
                yield where + inner.name
            if isinstance(inner, ast.ClassDef):
                yield from undocumented(inner, f"{where}{inner.name}.")


def test_files_are_short_documented_and_without_print_assert_and_broad_except() -> None:
    for path in FILES:
        tree = syntax(path)
        assert len(path.read_text("utf-8").splitlines()) <= LONGEST_FILE, path
        assert ast.get_docstring(tree), path
        assert not list(undocumented(tree)), path
        assert not list(forbidden(tree, may_print=path.is_relative_to(PRINTING) or path == MAIN)), path


def compared_by_value(tree: ast.AST) -> Iterator[str]:
    """Dataclasses that hold arrays, of which comparing them would ask for one truth."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            decorators = [ast.unparse(each) for each in node.decorator_list]
            data = any(each.startswith("dataclass") and "eq=False" not in each for each in decorators)
            types = (ast.unparse(each.annotation) for each in node.body if isinstance(each, ast.AnnAssign))
            if data and any("Array" in each for each in types):
                yield node.name


def test_what_holds_arrays_is_compared_by_identity() -> None:
    assert [*compared_by_value(ast.parse("@dataclass(frozen=True)\nclass A:\n    x: FloatArray"))] == ["A"]
    assert not [f"{path}: {name}" for path in FILES for name in compared_by_value(syntax(path))]


def installed_scripts(requirements: list[str]) -> set[str]:
    """Commands that come with packages."""
    names = (re.match(r"[\w.\-]+", requirement)[0] for requirement in requirements)  # type: ignore[index]
    files = (path for name in names for path in metadata.files(name) or [])
    return {path.name for path in files if path.parent.name in ("bin", "Scripts")}


def test_the_makefile_runs_commands_that_exist() -> None:
    declared, used = project()["project"], set(re.findall(r"\$\(BIN\)/([\w-]+)", MAKEFILE))
    offered = installed_scripts(declared["optional-dependencies"]["test"]) | set(declared["scripts"])
    assert {"cmbot", "pytest", "ruff", "mypy", "lint-imports", "python"} <= used <= offered | {"python"}
    scripts = re.findall(
        r"^\t\$\(BIN\)/python (\S+\.py)(?: (--\w+)(?: \d+)?)?$", MAKEFILE, flags=re.MULTILINE
    )
    assert len(scripts) == MAKEFILE.count(".py")
    for script, option in scripts:
        assert (ROOT / script).is_file(), script
        assert option in (ROOT / script).read_text(encoding="utf-8"), f"{script} {option}"
    lines = re.findall(r"^\t\$\(BIN\)/cmbot (.+)$", MAKEFILE, flags=re.MULTILINE)
    assert lines
    for line in lines:
        verb, *words = line.split()
        assert {word for word in words if word.startswith("-")} <= {*flags_of(COMMANDS[verb])}, line


def test_ci_makes_targets_that_exist() -> None:
    script = ROOT / ".ci" / "run"
    targets = re.findall(r"^([a-z]+):", MAKEFILE, flags=re.MULTILINE)
    made = re.findall(r"^make (\w+)$", script.read_text("utf-8"), flags=re.MULTILINE)
    assert {"lint", "demo", "test"} <= set(made) <= set(targets)
    assert os.access(script, os.X_OK)
    assert "\nexport CMBOT_REQUIRE_BROWSER=1\n" in script.read_text("utf-8")
    subprocess.run(["bash", "-n", str(script)], check=True)
    dry = subprocess.run(["make", "-n", *made], cwd=ROOT, capture_output=True, text=True, check=False)
    assert dry.returncode == 0, dry.stderr


@pytest.mark.parametrize(("value", "outcome"), [("1", pytest.fail.Exception), ("", pytest.skip.Exception)])
def test_a_missing_browser_is_no_excuse_where_it_is_required(
    value: str, outcome: type[BaseException], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CMBOT_REQUIRE_BROWSER", raising=False)
    if value:
        monkeypatch.setenv("CMBOT_REQUIRE_BROWSER", value)
    with pytest.raises(outcome, match="chromium"), chromium(tmp_path):
        pass


def test_python_is_one_that_the_project_supports() -> None:
    declared = project()["project"]
    lowest = re.fullmatch(r">=3\.(\d+)", declared["requires-python"])
    assert sys.version_info >= (3, int(lowest[1]))
    classified = {
        int(minor) for minor in re.findall(r"Python :: 3\.(\d+)", " ".join(declared["classifiers"]))
    }
    assert min(classified) == int(lowest[1])
