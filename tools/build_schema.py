"""Writes scenes/scene.schema.json, the JSON Schema of the scene file, from the models that check it."""

from __future__ import annotations

import argparse
import json
import sys
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
