"""The page for the next engineer names files and functions that are there."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
STEP = re.compile(r"`((?:cmbot|studies)/[\w/]+\.py)`(?:: ((?:`\w+`(?:, )?)+))?")


def test_every_step_of_a_call_is_there() -> None:
    section = PAGE.partition("## One call, followed")[2].partition("\n## ")[0]
    steps = STEP.findall(section)
    assert len(steps) > 20
    for file, names in steps:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        for name in re.findall(r"\w+", names):
            assert name in defined, f"{file}: {name}"


def test_every_room_has_a_row() -> None:
    rooms = {path.parent.name for path in (ROOT / "cmbot").glob("*/__init__.py")}
    assert all(f"| `cmbot/{room}/` |" in PAGE for room in rooms), rooms
