"""Values that are put into a scene file's content by key, such as ``tool_path.legs[0].seconds``."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.installation import scene_folder
from cmbot.common.reading.validation import resolved

# A step of a key such as tool_path.legs[0].by[2].
_KEY_STEP = re.compile(r"\.?([A-Za-z_]\w*)|\[(\d{1,4})\]")
# Blocks in blocks, beyond which no key is looked for.
_MAX_NESTING = 3


def changed_content(data: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a scene file's content with other values.

    Parameters
    ----------
    data : mapping
        As `cmbot.common.reading.yaml_reader.read_yaml` returns it; it stays as it is.
    values : mapping
        By key; a block that the content lacks is made.

    Raises
    ------
    SceneError
        Without a source, for a key that leads nowhere. Whether the scene file may have it is checked where
        the content becomes a scene.
    """
    content = dict(deepcopy(data))
    for key, value in values.items():
        _put(content, key, value)
    return content


def is_within(key: str, values: Iterable[str]) -> bool:
    """Return whether a key of an error is one of those that were set, or part of one."""
    return any(re.match(rf"{re.escape(value)}(\W|$)", key) for value in values)


def whole_key(name: str, data: Mapping[str, Any]) -> str | None:
    """Return the key that ends in `name`, ``robot.payload_kg``: of this content, else of any scene."""
    return _content_key(name, data, "") or _schema_key(name)


def numbers_in(node: Any, key: str = "") -> Iterator[tuple[str, FloatArray]]:
    """Yield the keys of all numbers of a scene file's content, or a part of it, and the numbers."""
    if isinstance(node, dict):
        for step, value in node.items():
            yield from numbers_in(value, f"{key}.{step}".removeprefix("."))
    elif isinstance(node, list) and node and isinstance(node[0], dict):
        for k, value in enumerate(node):
            yield from numbers_in(value, f"{key}[{k}]")
    elif isinstance(node, float) or (isinstance(node, list) and node and not isinstance(node[0], str)):
        yield key, np.array(node, float)


def _content_key(name: str, node: Any, prefix: str) -> str | None:
    """The first key in a scene file's content that ends in `name`."""
    if isinstance(node, list):
        each = ((f"{prefix}[{k}]", item) for k, item in enumerate(node))
    elif isinstance(node, dict):
        if name in node:
            return f"{prefix}.{name}".removeprefix(".")
        each = ((f"{prefix}.{step}", item) for step, item in node.items())
    else:
        return None
    found = (_content_key(name, item, key.removeprefix(".")) for key, item in each)
    return next((key for key in found if key), None)


def _schema_key(name: str) -> str | None:
    """The shortest key of any scene file that ends in `name`."""
    schema = json.loads((scene_folder() / "scene.schema.json").read_text(encoding="utf-8"))
    level = [("", schema)]
    for _ in range(_MAX_NESTING):
        deeper = []
        for prefix, block in level:
            for step, node in block.get("properties", {}).items():
                if step == name:
                    return f"{prefix}{step}"
                found, suffix = _block(schema, node)
                deeper.append((f"{prefix}{step}{suffix}.", found))
        level = deeper
    return None


def _block(schema: Mapping[str, Any], node: Mapping[str, Any]) -> tuple[Mapping[str, Any], str]:
    """The block that a value of a JSON Schema is, or the first item of a list of blocks."""
    node, suffix = resolved(schema, node), ""
    while isinstance(node.get("items"), Mapping):
        node, suffix = resolved(schema, node["items"]), f"{suffix}[0]"
    return node, suffix


def _put(content: dict[str, Any], key: str, value: Any) -> None:
    """Set a value of a scene file's content by its key."""
    steps = _steps(key)
    place: Any = content
    for step, following in zip(steps, [*steps[1:], None], strict=True):
        if isinstance(step, int):
            if not isinstance(place, list) or step >= len(place):
                length = len(place) if isinstance(place, list) else 0
                raise SceneError("", key, f"item {step} of a list of {length}", "one that the scene has")
        elif not isinstance(place, dict):
            raise SceneError("", key, f"a key {step} of no block", "a key of the scene file")
        if following is None:
            place[step] = value
        elif isinstance(step, int):
            place = place[step]
        else:
            if place.get(step) is None:
                place[step] = {}
            place = place[step]


def _steps(key: str) -> list[str | int]:
    steps, end = list[str | int](), 0
    for found in _KEY_STEP.finditer(key):
        if found.start() != end:
            break
        steps.append(found[1] if found[1] is not None else int(found[2]))
        end = found.end()
    if end != len(key) or not steps or steps[0] == "name":
        raise SceneError("", key, "no key", "a key of the scene file, such as tool_path.legs[0].seconds")
    return steps
