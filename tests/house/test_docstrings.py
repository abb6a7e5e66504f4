"""Examples of the public names run as they are written, one after the other; every entry point has one."""

import ast
import builtins
import doctest
import re
from pathlib import Path

import pytest
from shared_plans import planned

import cmbot

ROOT = Path(__file__).resolve().parent.parent.parent
# In the order in which a reader would use them: what one makes the next ones take.
NAMES = (
    *("load_scene", "load_robot", "plan", "save", "load_plan", "simulate", "save_tracking", "load_tracking"),
    *("evaluate", "excite", "save_excitation", "load_excitation"),
    *("replay", "report", "show", "plot", "replan", "identify", "locate", "walk", "load_walk"),
    *("load_tour", "tour", "campaign"),
)
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def test_examples_of_the_public_names_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    functions = {name for name in cmbot.__all__ if name.islower() and not name.startswith("_")}
    assert functions == set(NAMES)
    texts = {name: getattr(cmbot, name).__doc__ for name in NAMES}
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cmbot, "plan", planned)
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner(optionflags=FLAGS)
    names = {"cmbot": cmbot}
    ran = 0
    for name, text in texts.items():
        assert "\n    Examples\n    --------\n" in text, name
        test = parser.get_doctest(text, names, f"cmbot.{name}", None, None)
        said: list[str] = []
        ran += runner.run(test, out=said.append, clear_globs=False).attempted
        assert said == [], "".join(said)
        names |= test.globs
    assert ran > 15
    assert {path.name for path in tmp_path.iterdir()} >= {"out", "replay.html", "report.html"}
    # Those of the page: what needs nothing that is not there yet, and did not run above.
    ran = 0
    for code in examples():
        found = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)]
        used = {node.id for node in found if isinstance(node.ctx, ast.Load)} - {"segment"}
        if used <= names.keys() | vars(builtins).keys() and not re.search(
            rf"cmbot\.({'|'.join(NAMES)})\(", code
        ):
            exec(code, names)
            ran += 1
    assert ran > 15


def examples() -> list[str]:
    """The last column of the page's tables, in which every name that it describes has a row."""
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(cmbot[\w.]+)` \| [^|]+ \| `([^`]+)` \|$", page, flags=re.MULTILINE)
    described = re.findall(r"^::: (\S+)(?:\n    options: {heading: ([\w.]+))?", page, flags=re.MULTILINE)
    assert [name for name, _ in rows] == [heading or path for path, heading in described]
    return [code for _, code in rows if not code.startswith("except ")]
