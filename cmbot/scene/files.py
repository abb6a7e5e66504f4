"""Files that a scene names: where they are, when it is read, and what is in them, for its hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, ValidationInfo

from cmbot.common.errors import MissingExtra, SceneError
from cmbot.common.reading.fields import Text, existing_file, is_mesh_file, place_of
from cmbot.common.reading.input_files import LARGEST_MESH, is_file, read_input
from cmbot.common.reading.validation import hint, refusal, shown
from cmbot.common.robot_library import LIBRARY, LIBRARY_EXTRA, is_robot_name, library_robots

TRAINS = ("freight", "emu", *(f"hslm_a{k}" for k in range(1, 11)))
"""Trains that need no file."""


def _axles_name(text: str, info: ValidationInfo) -> str:
    place = place_of(text, info)
    if text not in TRAINS and place is not None and not is_file(place):
        expected = f"a train or a file of axles that exists (relative to the scene file){hint(text, TRAINS)}"
        raise refusal(expected, got=shown(text), choices=TRAINS)
    return text if text in TRAINS else existing_file(text, info)


def _model(text: str, info: ValidationInfo) -> str:
    """The path of a URDF, or the name of a robot; a file of that name comes first."""
    path = place_of(text, info)
    if text == "cmbot" or path is None:
        return text
    if is_file(path):
        return str(path.resolve())
    robots = library_robots()
    if robots is not None and text in robots:
        return text
    near = hint(text, ("cmbot", *(robots or ())))
    if robots is None and is_robot_name(text) and not near:
        missing = MissingExtra(LIBRARY, LIBRARY_EXTRA)
        missing.add_hint(f"robot.model: {text} is no file, and may be a robot of that package")
        raise missing
    named = "the name of a robot" + ("" if robots else f" (of the extra {LIBRARY_EXTRA})")
    expected = f"a file that exists (relative to the scene file), cmbot, or {named}{near}"
    raise refusal(expected, got=shown(text))


AxlesName = Annotated[Text, AfterValidator(_axles_name)]
"""The name of a train, or the path of a file of axle loads, likewise."""
RobotModel = Annotated[Text, AfterValidator(_model)]
"""``cmbot``, the path of a URDF, likewise, or the name of a robot of example-robot-data."""


def file_hashes(data: dict[str, Any], source: str, known: Mapping[str, str]) -> dict[str, str]:
    """Return the SHA-256 (hexadecimal) of the files that a scene's content names, by their paths.

    Parameters
    ----------
    data : dict
        As `Scene.as_data` returns it.
    source : str
        The scene's, for messages.
    known : mapping of str to str
        Those of files that were read before.

    Raises
    ------
    SceneError
        When one of the others cannot be read.
    """
    hashes = dict[str, str]()
    for key, block, name in _paths(data):
        path = block[name]
        try:
            content = b"" if path in known else read_input(Path(path), SceneError, largest=LARGEST_MESH)
        except SceneError as error:
            raise SceneError(source, key, error.got, error.expected) from error
        hashes[path] = known.get(path) or hashlib.sha256(content).hexdigest()
    return hashes


def with_paths(data: dict[str, Any], others: Mapping[str, str]) -> dict[str, Any]:
    """Put `others`, or hashes, in place of the paths of files in a scene's content, itself."""
    for _, block, name in _paths(data):
        block[name] = others[block[name]]
    return data


def _paths(data: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any], str]]:
    """The paths of files in a scene's content: the key of each, and the block in which it is, by its name."""
    robot, path = data["robot"], data["tool_path"]
    yield from ((f"robot.{name}", robot, name) for name in ("limits", "srdf", "elasticity") if name in robot)
    if Path(robot["model"]).is_absolute():
        yield "robot.model", robot, "model"
    deck = data.get("excitation", {}).get("deck", {})
    if "record" in deck:
        yield "excitation.deck.record", deck, "record"
    if "trains" in deck and deck["trains"]["axles"] not in TRAINS:
        yield "excitation.deck.trains.axles", deck["trains"], "axles"
    tool = robot.get("tool", {})
    blocks = [("robot.tool", tool)]
    blocks += [(f"robot.tool.shapes[{k}]", shape) for k, shape in enumerate(tool.get("shapes", ()))]
    yield from ((f"{key}.mesh", block, "mesh") for key, block in blocks if "mesh" in block)
    for k, obstacle in enumerate(data["obstacles"]):
        if "mesh" in obstacle:
            yield f"obstacles[{k}].mesh", obstacle, "mesh"
    strokes = [(f"tool_path.strokes[{k}]", stroke) for k, stroke in enumerate(path.get("strokes", ()))]
    for key, stroke in strokes or [("tool_path", path)]:
        raster = stroke.get("raster", {})
        if is_mesh_file(raster.get("mesh", "")):
            yield f"{key}.raster.mesh", raster, "mesh"
