"""Writes scenes/scene.schema.json, the JSON Schema of the scene file, from the models that check it."""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import sys
import textwrap
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

from cmbot.common.validation import FileModel
from cmbot.scene.schema import FORMAT, SceneFile

TARGET = Path(__file__).resolve().parent.parent / "scenes" / "scene.schema.json"


def schema_text() -> str:
    """Return the schema as the text of its file."""
    # pydantic would read the docstrings whenever cmbot is imported, and that takes a while. Here models come
    # before those that are made of them.
    for model in FileModel.__subclasses__():
        for name, text in docstrings(model):
            model.model_fields[name].description = text
        model.model_rebuild(force=True)
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **SceneFile.model_json_schema(),
        "title": FORMAT,
    }
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def docstrings(model: type[FileModel]) -> Iterator[tuple[str, str]]:
    """Yield the model's keys that have a docstring, each with it."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    for statement, following in pairwise(definition.body):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)


def main() -> int:
    """Write the file, or with ``--check`` only say whether it is up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when the file differs")
    if parser.parse_args().check:
        current = TARGET.exists() and TARGET.read_text(encoding="utf-8") == schema_text()
        print(f"{TARGET.name} is {'up to date' if current else 'not what tools/build_schema.py writes'}")
        return 0 if current else 1
    TARGET.write_text(schema_text(), encoding="utf-8")
    print(f"wrote {TARGET.name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
