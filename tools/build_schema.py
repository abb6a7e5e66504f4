"""Writes scenes/scene.schema.json, the JSON Schema of the scene file, from the models that check it."""

from __future__ import annotations

import json
from pathlib import Path

from cmbot.scene.schema import FORMAT, SceneFile

TARGET = Path(__file__).resolve().parent.parent / "scenes" / "scene.schema.json"


def schema_text() -> str:
    """Return the schema as the text of its file."""
    schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **SceneFile.model_json_schema(),
        "title": FORMAT,
    }
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def main() -> None:
    """Write the file."""
    TARGET.write_text(schema_text(), encoding="utf-8")
    print(f"wrote {TARGET.name}")


if __name__ == "__main__":
    main()
