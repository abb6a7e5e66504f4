"""Writes the JSON Schema of the scene file, its reference page and the table of attributes from the code."""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import re
import sys
import textwrap
from collections.abc import Iterator
from dataclasses import is_dataclass
from itertools import pairwise
from pathlib import Path

import attribute_tables
from scene_reference import reference_text

from cmbot.common.reading.validation import FileModel
from cmbot.scene import PlannerOptions, Scene, Tool
from cmbot.scene.path.waypoint_file import WaypointFile
from cmbot.scene.scene import FORMAT
from cmbot.toolpath import (
    ArcTo,
    CylinderPatch,
    FaceSelection,
    Goal,
    Leg,
    LegLaw,
    Raster,
    RowPiece,
    SpeedProfile,
)

_ROOT = Path(__file__).resolve().parent.parent
TARGET, PAGE = _ROOT / "scenes" / "scene.schema.json", _ROOT / "docs" / "scene_file.md"
API = _ROOT / "docs" / "api.md"


def schema_text() -> str:
    """Return the schema as the text of its file."""
    schema = Scene.model_json_schema()
    schema["$defs"]["WaypointFile"] = WaypointFile.model_json_schema()
    paths = (ArcTo, CylinderPatch, FaceSelection, Goal, Leg, LegLaw, Raster, RowPiece, SpeedProfile)
    classes = (*paths, Tool, PlannerOptions)
    kinds = [*subclasses(FileModel), *classes]
    for name, definition in [*schema["$defs"].items(), ("Scene", schema)]:
        (kind,) = (kind for kind in kinds if kind.__name__ == name)
        definition["description"] = inspect.getdoc(kind).partition("\n\nAttributes")[0]
        # pydantic would read the docstrings whenever cmbot is imported, and that takes a while.
        fields = {} if is_dataclass(kind) else kind.model_fields
        aliases = {name: field.alias for name, field in fields.items() if field.alias}
        for key, text in attributes(kind) if is_dataclass(kind) else docstrings(kind):
            for name in key.split(", "):
                definition["properties"][aliases.get(name, name)]["description"] = text
    # A CSV file's rows are read before a scene is checked.
    for name in ("ToolPathFile", "StrokeFile"):
        waypoints = schema["$defs"][name]["properties"]["waypoints"]
        waypoints["anyOf"] += [{"type": "string", "minLength": 1}, {"$ref": "#/$defs/WaypointFile"}]
    # A file's content is read, too, and a diagonal made a matrix.
    schema["properties"]["identified"]["anyOf"].append({"type": "string", "minLength": 1})
    stiffness, entries = schema["$defs"]["GuardrailFile"]["properties"]["stiffness"], {"type": "number"}
    stiffness["anyOf"].append({"type": "array", "items": entries, "minItems": 6, "maxItems": 6})
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema, "title": FORMAT}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def page_text() -> str:
    """Return the reference page as the text of its file."""
    example = (_ROOT / "scenes" / "gusset_plate.yaml").read_text(encoding="utf-8")
    return reference_text(json.loads(schema_text()), example)


def subclasses(kind: type) -> Iterator[type]:
    """Yield the classes below a class, at all depths."""
    for below in kind.__subclasses__():
        yield below
        yield from subclasses(below)


def docstrings(model: type) -> Iterator[tuple[str, str]]:
    """Yield the model's keys that have a docstring, each with it; first those of the class above it."""
    if model.__base__ is not FileModel:
        yield from docstrings(model.__base__)
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    for statement, following in pairwise(definition.body):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)


def attributes(kind: type) -> Iterator[tuple[str, str]]:
    """Yield the dataclass's keys, each with its text in the section "Attributes" of the docstring."""
    section = inspect.getdoc(kind).partition("Attributes\n----------\n")[2].partition("\n\n")[0]
    for name, text in re.findall(r"^([\w, ]+) : .*\n((?:    .*\n?)+)", section, flags=re.MULTILINE):
        yield name, textwrap.dedent(text).strip()


def main() -> int:
    """Write the file, or with ``--check`` only say whether it is up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit 1 when the file differs")
    check, differ = parser.parse_args().check, False
    attributes = attribute_tables.page_text(API.read_text(encoding="utf-8"))
    for target, text in ((TARGET, schema_text()), (PAGE, page_text()), (API, attributes)):
        if check:
            current = target.exists() and target.read_text(encoding="utf-8") == text
            differ |= not current
            print(f"{target.name} is {'up to date' if current else 'not what tools/build_schema.py writes'}")
        else:
            target.write_text(text, encoding="utf-8")
            print(f"wrote {target.name}")
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
