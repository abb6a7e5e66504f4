"""The reference page of the scene file, written from its JSON Schema."""

from __future__ import annotations

import json
import re
import textwrap
from collections import defaultdict
from collections.abc import Container, Iterator
from typing import Any

__all__ = ["reference_text"]

_HEAD = """# Scene file

A scene is one YAML file: the robot, where its arm starts, the tool's path, obstacles and base.
Lengths are metres, angles degrees, times seconds; `rpy_deg` is Rz(yaw) Ry(pitch) Rx(roll), as in URDF.
A key that is not *required* may be left out; its value is a number where nothing else is said.
Largest and smallest values, and the blocks that only cmbot writes, are in the schema.

Editors check a scene while it is typed if its first line is `# yaml-language-server: $schema=FILE`.
`cmbot new` writes that line; `cmbot schema` prints the schema, to go with a scene to other machines.
This page is written from the schema by `tools/build_schema.py`.

A whole job, from the stowed arm and back to it (`cmbot plan gusset_plate`):

```yaml
{example}
```
"""
# Order of the sections, with the words above each; the scene itself comes first.
_SECTIONS = {
    "Scene": "The scene",
    "PostureFile": "`start`",
    "NamedState": "`return`",
    "RobotFile": "`robot`",
    "AttachedToolFile": "`robot.tool`",
    "ToolShapeFile": "`robot.tool.shapes`",
    "MountFile": "`frames`",
    "MountsFile": "`mounts`",
    "MountGridFile": "`mounts.grid`",
    "MountRailFile": "`mounts.rail`",
    "BaseFile": "`base`",
    "ModesFile": "`base.modes`",
    "TubeFile": "`base.tube`",
    "LinkHoldFile": "`base.hold`",
    "Tool": "`tool`",
    "Tolerance": "`tool.tolerance`",
    "Uncertainty": "`uncertainty`",
    "Placement": "`uncertainty.foot`",
    "JointUncertainty": "`uncertainty.joints`",
    "ToolPathFile": "`tool_path`",
    "StrokeFile": "`tool_path.strokes`",
    "AxisCone": "`keep`",
    "Leg": "`legs`",
    "Goal": "`to`, `from`",
    "ArcTo": "`arc`",
    "WaypointFile": "`waypoints`",
    "Raster": "`raster`",
    "CylinderPatch": "`raster.cylinder`",
    "FaceSelection": "`raster.faces`",
    "RowPiece": "`raster.pieces`",
    "SpeedProfile": "`speed_profile`",
    "ObstacleFile": "`obstacles`",
    "GuardrailFile": "`guardrail`",
    "PostFile": "`guardrail.post`",
    "RailFile": "`guardrail.rails`",
    "SectionFile": "`section`",
    "MaterialFile": "`guardrail.material`",
    "FootFile": "`guardrail.foot`",
    "HoldFile": "`guardrail.hold`",
    "PadFile": "`guardrail.hold.pads`",
    "StanceFile": "`guardrail.stance`",
    "FootholdFile": "`guardrail.stance.foot_1`",
    "ExcitationFile": "`excitation`",
    "DeckFile": "`excitation.deck`",
    "TrainsFile": "`excitation.deck.trains`",
    "SpanFile": "`excitation.deck.trains.span`",
    "WindFile": "`excitation.wind`",
    "PassingFile": "`excitation.passing`",
    "DamperFile": "`damper`",
    "PlannerOptions": "`planner`",
}
# Blocks that planning and identification write: their keys are in the schema.
_WRITTEN = {
    "LegLaw": "laws of legs",
    "IdentifiedStiffness": "an identified stiffness",
    "IdentifiedSpring": "",
    "IdentifiedBase": "",
    "IdentifiedDamping": "",
    "IdentifiedMode": "",
    "IdentifiedReadings": "",
    "MeasuredFile": "",
}


def reference_text(schema: dict[str, Any], example: str) -> str:
    """Return the page as Markdown."""
    definitions = {**schema["$defs"], "Scene": schema}
    if missing := definitions.keys() ^ (_SECTIONS | _WRITTEN).keys():
        raise ValueError(f"sections and definitions differ: {', '.join(sorted(missing))}")
    parts = [_HEAD.replace("{example}", example.strip())]
    for name, title in _SECTIONS.items():
        definition = definitions[name]
        parts.append(f"## {title}\n\n{_filled(_prose(definition['description']))}\n")
        above = definitions["ToolPathFile"]["properties"] if name == "StrokeFile" else {}
        parts.append("\n".join(_entries(definition, above)) + "\n")
    return "\n".join(parts)


def _entries(definition: dict[str, Any], known: Container[str] = ()) -> Iterator[str]:
    """Yield an entry of a list for the keys that say the same, without those known from another section."""
    required, entries = definition.get("required", ()), defaultdict[tuple[str, str], list[str]](list)
    for key, value in definition["properties"].items():
        if key in known:
            continue
        name, kind = f"`{key}`", [_kind(value)]
        if kind[0].startswith(f"[{key}](") and kind[0].endswith(")"):
            name, kind = kind[0].replace(key, name, 1), []
        elif kind == ["number"]:
            kind = []
        if key in required:
            kind.append("required")
        elif not isinstance(value.get("default"), dict | list | None):
            kind.append(f"default `{json.dumps(value['default'])}`")
        entries[", ".join(kind), _prose(value.get("description", ""))].append(name)
    for (kind, text), keys in entries.items():
        said = f" ({kind})" if kind else ""
        entry = f"- {', '.join(keys)}{said}" + (f": {text}" if text else ".")
        yield _filled(entry, "  ")


def _filled(text: str, indent: str = "") -> str:
    """A paragraph in lines that can be compared."""
    return textwrap.fill(text, 118, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _kind(value: dict[str, Any]) -> str:
    """What a value may be, in words."""
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[-1]
        if name in _WRITTEN:
            return _WRITTEN[name]
        title = _SECTIONS[name]
        return f"[{title.replace('`', '')}](#{_anchor(title)})"
    for several in ("anyOf", "oneOf"):
        if several in value and "type" not in value:
            each = [_kind(one) for one in value[several] if one.get("type") != "null"]
            return " or ".join(dict.fromkeys(each))
    if "enum" in value or "const" in value:
        choices = value.get("enum", [value.get("const")])
        return ", ".join(f"`{x if isinstance(x, str) else json.dumps(x)}`" for x in choices)
    if value.get("type") == "array":
        fixed = value.get("prefixItems")
        if fixed or value.get("minItems") == value.get("maxItems"):
            number = len(fixed) if fixed else value["minItems"]
            item = fixed[0] if fixed else value["items"]
            return f"{number} lists of {_kind(item)}" if item.get("type") == "array" else f"{number} numbers"
        return f"list of {_kind(value['items'])}"
    if value.get("type") == "object":
        (of,) = value.get("patternProperties", {"": value.get("additionalProperties")}).values()
        return f"{_kind(of)} by name"
    words = {"number": "number", "integer": "integer", "string": "text", "boolean": "boolean"}
    return words[value["type"]]


def _anchor(title: str) -> str:
    """The anchor that MkDocs gives a heading."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title.lower())).strip("-")


def _prose(text: str) -> str:
    """A docstring on one line of Markdown."""
    line = " ".join(text.split()).replace("``", "`")
    return re.sub(r"`cmbot\.([\w.]+)`", r"`cmbot.\1`", line)
