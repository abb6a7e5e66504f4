"""The reference page of the scene file, written from its JSON Schema."""

from __future__ import annotations

import json
import re
from collections.abc import Container, Iterator
from typing import Any

__all__ = ["reference_text"]

_HEAD = """# Scene file

A scene is one YAML file: the robot, where its arm starts, the tool's path, obstacles and guardrail. This page
is written from the JSON Schema `scenes/scene.schema.json` by `tools/build_schema.py`; editors that read the
first line `# yaml-language-server: $schema=…` check a scene while it is typed; `cmbot new`
names the schema of the installation there, or `scene.schema.json` beside the scene where `cmbot schema` has
written it, which goes with the scene to other machines. Lengths are metres, angles degrees, times seconds.

A whole job, from the stowed arm and back to it (`cmbot plan gusset_plate`):

```yaml
{example}
```
"""
# Order of the sections, with the words above each; the scene itself comes first.
_SECTIONS = {
    "Scene": "The scene",
    "PostureFile": "`start`",
    "NamedState": "Named states: `return`",
    "RobotFile": "`robot`",
    "AttachedToolFile": "`robot.tool`",
    "ToolShapeFile": "`robot.tool.shapes`",
    "MountFile": "`robot.mount`, `frames`",
    "MountsFile": "`mounts`",
    "MountGridFile": "`mounts.grid`",
    "MountRailFile": "`mounts.rail`",
    "BaseFile": "`base`",
    "ModesFile": "`base.modes`",
    "Tool": "`tool`",
    "Tolerance": "`tool.tolerance`",
    "Uncertainty": "`uncertainty`",
    "Placement": "`uncertainty.foot`, `uncertainty.workpiece`",
    "JointUncertainty": "`uncertainty.joints`",
    "ToolPathFile": "`tool_path`",
    "StrokeFile": "`tool_path.strokes`",
    "AxisCone": "Cones: `keep`",
    "Leg": "Legs",
    "Goal": "Poses: `to`, `from`",
    "ArcTo": "Arcs: `arc`",
    "WaypointFile": "Tables of waypoints: `waypoints`",
    "Raster": "Rasters: `raster`",
    "CylinderPatch": "Rasters over a cylinder: `raster.cylinder`",
    "FaceSelection": "Rasters over faces of a mesh: `raster.faces`",
    "RowPiece": "Pieces of rows: `raster.pieces`",
    "SpeedProfile": "`speed_profile`",
    "LegLaw": "Laws of legs with `seconds: auto`: `time_laws`",
    "ObstacleFile": "`obstacles`",
    "GuardrailFile": "`guardrail`",
    "PostFile": "`guardrail.post`",
    "RailFile": "`guardrail.rails`",
    "SectionFile": "Sections of posts and rails",
    "MaterialFile": "`guardrail.material`",
    "FootFile": "`guardrail.foot`",
    "HoldFile": "`guardrail.hold`",
    "StanceFile": "`guardrail.stance`",
    "FootholdFile": "`guardrail.stance.foot_1`, `foot_2`",
    "IdentifiedStiffness": "`identified`",
    "IdentifiedSpring": "`identified.links`, `identified.joints`",
    "IdentifiedBase": "`identified.base`",
    "ExcitationFile": "`excitation`",
    "DeckFile": "`excitation.deck`",
    "TrainsFile": "`excitation.deck.trains`",
    "SpanFile": "`excitation.deck.trains.span`",
    "WindFile": "`excitation.wind`",
    "PassingFile": "`excitation.passing`",
    "DamperFile": "`damper`",
    "PlannerOptions": "`planner`",
}


def reference_text(schema: dict[str, Any], example: str) -> str:
    """Return the page as Markdown."""
    definitions = {**schema["$defs"], "Scene": schema}
    if missing := definitions.keys() ^ _SECTIONS.keys():
        raise ValueError(f"sections and definitions differ: {', '.join(sorted(missing))}")
    parts = [_HEAD.replace("{example}", example.strip())]
    for name, title in _SECTIONS.items():
        definition = definitions[name]
        parts.append(f"## {title}\n\n{_prose(definition['description'])}\n")
        above = definitions["ToolPathFile"]["properties"] if name == "StrokeFile" else {}
        rows = _rows(definition, above)
        parts.append("| key | value | |\n|---|---|---|\n" + "\n".join(rows) + "\n")
    return "\n".join(parts)


def _rows(definition: dict[str, Any], known: Container[str] = ()) -> Iterator[str]:
    """A row for each key that is not known from another section."""
    required = definition.get("required", ())
    for key, value in definition["properties"].items():
        if key in known:
            continue
        text = _prose(value.get("description", ""))
        if key in required:
            text = f"Required. {text}"
        elif not isinstance(value.get("default"), dict | list | None):
            text = f"{text} Default: `{json.dumps(value['default'])}`."
        yield f"| `{key}` | {_kind(value)} | {text.strip()} |"


def _kind(value: dict[str, Any]) -> str:
    """What a value may be, in words."""
    if "$ref" in value:
        name = value["$ref"].rsplit("/", 1)[-1]
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
    words = {"number": "number", "integer": "whole number", "string": "text", "boolean": "true or false"}
    kind = words[value["type"]]
    low = value.get("minimum", value.get("exclusiveMinimum"))
    high = value.get("maximum", value.get("exclusiveMaximum"))
    if low is not None and high is not None:
        return f"{kind}, {low:g} to {high:g}"
    return kind


def _anchor(title: str) -> str:
    """The anchor that MkDocs gives a heading."""
    return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", title.lower())).strip("-")


def _prose(text: str) -> str:
    """A docstring on one line of Markdown."""
    line = " ".join(text.split()).replace("``", "`")
    return re.sub(r"`cmbot\.([\w.]+)`", r"`cmbot.\1`", line).replace("|", "\\|")
