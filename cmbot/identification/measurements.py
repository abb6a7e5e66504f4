"""What was measured: the deflections of the tool by a weight, natural frequencies, and how exact they are.

A file of measurements::

    format: cmbot-measurements/1
    scene: triangle                    # robot and base, by name or relative to this file
    weight_kg: 5.0                     # hung on the tool point
    measurements:
      - {posture_deg: [...], deflection_mm: [0.41, -0.12, -3.87]}    # with the weight, less without it
      - {posture_deg: [...], deflection_mm: {z: -5.02}, frequencies_hz: [5.9, 7.4]}
      - {posture_deg: [...], record: tap.csv}          # of an accelerometer on the tool, without the weight

Deflections are along the axes of W. Differences need no calibrated arm; absolute positions would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import InputError, SceneError
from cmbot.common.reading.fields import Posture, Text
from cmbot.common.reading.input_files import is_file
from cmbot.common.reading.validation import FileModel, given_path, plain, refusal, require_type, validated
from cmbot.common.reading.yaml_reader import lines_named, read_yaml
from cmbot.common.representation import ShortRepr
from cmbot.identification.records import RingDown, UnusableRecord, read_record
from cmbot.planning import robot_of
from cmbot.robot import JointLimits, Robot
from cmbot.scene import Scene, load_scene, shipped_scenes

_MAX_MEASUREMENTS = 1000
# By how much a measured posture may be beyond the range of a joint, rad or m.
_RANGE_TOLERANCE = 0.05

Share = Annotated[float, Field(ge=1e-3, le=3)]
Deflection = Annotated[float, Field(ge=-1000, le=1000)] | None


def _by_axis(value: Any) -> Any:
    """Let deflections be given by the names of the axes that were measured."""
    if not isinstance(value, Mapping):
        return tuple(value) if isinstance(value, list) else value
    for axis in value.keys() - set("xyz"):
        raise refusal("x, y or z", got=str(axis))
    return tuple(value.get(axis) for axis in "xyz")


Deflections = Annotated[tuple[Deflection, Deflection, Deflection], BeforeValidator(_by_axis)]
Frequency = Annotated[float, Field(gt=0, le=1e4)]


class Prior(FileModel):
    """How well the model's stiffness is known before: standard deviations of logarithms."""

    links: Share = 0.3
    joints: Share = 0.5
    base: Share = 0.3
    """Of the diagonal of X, `IdentifiedStiffness`."""
    base_coupling: Share = 0.15
    """Of its other entries."""


class MeasuringSetup(FileModel):
    """With what is measured."""

    weight_kg: Annotated[float, Field(gt=0, le=1e4)] = 5.0
    """Hung on the tool point for each deflection."""
    weight_sd_kg: Annotated[float, Field(ge=0, le=1e3)] = 0.01
    """Standard deviation of that weight, the same in all measurements."""
    gauge_sd_mm: Annotated[float, Field(ge=1e-6, le=100)] = 0.1
    """Standard deviation of every component of a deflection."""
    windup_sd_arcmin: Annotated[float, Field(ge=0, le=600)] = 0.0
    """By how much every joint that turns may turn beyond its stiffness when the weight is hung on: play and
    friction, each time anew; a standard deviation."""
    frequency_sd_share: Annotated[float, Field(ge=1e-5, le=1)] = 0.01
    """Standard deviation of a natural frequency, as a share of it."""
    record_axes: Literal["W", "tool"] | None = None
    """Along whose axes the sensor's x, y and z are; left out: unknown, and directions tell nothing."""
    prior: Prior = Prior()


class MeasurementFile(FileModel):
    """In one posture."""

    posture_deg: Posture | None = None
    posture: Posture | None = None
    """In rad and, of joints that slide, m."""
    deflection_mm: Deflections | None = None
    """Of the tool point along x, y, z of W by the weight; null: not measured. Or by the names of the axes."""
    frequencies_hz: Annotated[tuple[Frequency, ...], Field(max_length=4)] = ()
    """Natural frequencies without the weight, the slowest first."""
    record: Text | None = None
    """In place of them a table ``t,ax,ay,az``, or as Klipper, phones and loggers write it, of an
    accelerometer on the tool: a tap, and its decay."""

    def _check(self) -> None:
        if (self.posture is None) == (self.posture_deg is None):
            raise refusal("either posture_deg or posture", got="both" if self.posture else "neither")
        if list(self.frequencies_hz) != sorted(self.frequencies_hz):
            expected = "the slowest first"
            raise refusal(expected, got=self.frequencies_hz, key=("frequencies_hz",))
        if self.record is not None and self.frequencies_hz:
            raise refusal("no such key beside record", got="both", key=("frequencies_hz",))


class MeasurementsFile(MeasuringSetup):
    """All of a robot on a base."""

    model_config = ConfigDict(title="cmbot-measurements/1")

    format: Literal["cmbot-measurements/1"]
    scene: Text
    """A scene file, or the name of a shipped scene: robot, payload, base and where the feet hold."""
    measurements: Annotated[tuple[MeasurementFile, ...], Field(min_length=1, max_length=_MAX_MEASUREMENTS)]
    job: Annotated[tuple[Posture, ...] | None, Field(min_length=1, max_length=_MAX_MEASUREMENTS)] = None
    """Postures, rad and m, in which the sag is wanted; left out: nothing is told of it."""

    def _check(self) -> None:
        each = self.measurements
        if not any(
            one.frequencies_hz or one.record or any(x is not None for x in one.deflection_mm or ())
            for one in each
        ):
            expected = "a measured number in a deflection_mm, a frequencies_hz or a record"
            raise refusal(expected, got="none", key=("measurements",))


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements(ShortRepr):
    """What was measured, in SI.

    Attributes
    ----------
    source : str
        Where it came from, for messages.
    scene : Scene
    setup : MeasuringSetup
    q : (N, n), rad and m
        Postures.
    deflection : (N, 3), m
        NaN: not measured.
    modes : tuple of RingDown
        For each posture; empty: none are known.
    rows : tuple of str
        What each is called in messages; empty: ``measurements[k]``.
    job : (M, n) or None
        Postures in which the sag is wanted.
    """

    source: str
    scene: Scene
    setup: MeasuringSetup
    q: FloatArray
    deflection: FloatArray
    job: FloatArray | None
    modes: tuple[RingDown, ...] = ()
    rows: tuple[str, ...] = ()

    def key(self, row: int, part: str = "") -> str:
        """Return what a row, or a part of it, is called in messages."""
        called = [self.rows[row] if self.rows else f"measurements[{row}]", *[part] * bool(part)]
        return (", " if self.rows else ".").join(called)


def read_measurements(source: str | Path | Mapping[str, Any]) -> Measurements:
    """Read and check measurements.

    Parameters
    ----------
    source : str, Path or mapping
        Path of the file, or its content, in which relative paths start at the current folder.

    Raises
    ------
    InputError
        When a key or value is wrong, or nothing was measured; or as `cmbot.load_scene`.
    """
    if isinstance(source, Mapping):
        name = "measurements"
        file = validated(MeasurementsFile, dict(source), name, InputError)
        return in_si(file, Path.cwd(), name)
    path = given_path(
        source, "cmbot.identify", "source", "the path of a file of measurements, or its content"
    )
    if str(source) in shipped_scenes() and not path.exists():
        raise _no_sheet(str(source))
    with lines_named(path):
        data = read_yaml(path, InputError, "a file of measurements, or a scene with --propose")
        if str(data.get("format")).startswith("cmbot-scene/"):
            raise _no_sheet(str(source))
        file = validated(MeasurementsFile, data, str(path), InputError)
        return in_si(file, path.parent, str(path))


def _no_sheet(scene: str) -> InputError:
    expected = f"a file of measurements: cmbot identify {scene} --propose 8 writes one to fill in"
    return InputError(scene, "", "a scene", expected)


def is_sheet(source: str | Path) -> bool:
    """Whether it is a file of measurements, which need not be filled in, by its format."""
    # Path.is_file raises for names that no file can have.
    if not is_file(source):
        return False
    return str(read_yaml(source, InputError).get("format")).startswith("cmbot-measurements/")


def scene_named(name: str, folder: Path, source: str) -> Scene:
    """Return the scene that a sheet names, relative to its folder; of a file that is none nothing is told."""
    if name in shipped_scenes():
        return load_scene(name)
    path, held = folder / name, ""
    if is_file(path):
        with suppress(InputError):
            held = str(read_yaml(path, SceneError).get("format"))
        if not held.startswith("cmbot-scene/"):
            raise InputError(source, "scene", name, "a scene file, or the name of a shipped scene")
    return load_scene(path)


def in_si(file: MeasurementsFile, folder: Path, source: str) -> Measurements:
    """Return what a file has, with what it names: its scene and records, relative to a folder.

    Raises
    ------
    InputError
        As `read_measurements`.
    """
    scene = scene_named(file.scene, folder, source)
    robot = robot_of(scene)
    rows, n = [], len(robot.joints)
    for k, each in enumerate(file.measurements):
        rows.append(posture_of(each.posture_deg, each.posture, robot, source, f"measurements[{k}].posture"))
    for k, posture in enumerate(file.job or ()):
        _require_length(posture, n, source, f"job[{k}]")
    nothing = (None, None, None)
    deflection = [
        [np.nan if x is None else 1e-3 * x for x in one.deflection_mm or nothing] for one in file.measurements
    ]
    return Measurements(
        source=source,
        scene=scene,
        setup=file,
        q=np.array(rows),
        deflection=np.array(deflection),
        job=None if file.job is None else np.array(file.job),
        modes=tuple(_modes(each, folder, source, k) for k, each in enumerate(file.measurements)),
    )


def _modes(file: MeasurementFile, folder: Path, source: str, number: int) -> RingDown:
    """The modes that were measured in a posture."""
    if file.record is None:
        return RingDown.at(file.frequencies_hz)
    path = folder / file.record
    if not path.exists():
        key = f"measurements[{number}].record"
        raise InputError(source, key, file.record, "a file that exists (relative to this one)")
    try:
        return read_record(path)
    except UnusableRecord:
        raise
    except InputError as error:
        # A sheet may name any file: what is in one that is no record is not told.
        raise InputError(error.source, error.key, "something else", error.expected) from error


def posture_of(
    posture_deg: Posture | None, posture: Posture | None, robot: Robot, source: str, key: str
) -> FloatArray:
    """Return a posture (n,) in SI that a file gives in degrees or in rad and m; `key` is that of the latter.

    Raises
    ------
    InputError
        When there are other numbers than joints, degrees of an arm with joints that slide, or a position
        beyond a joint's range, as is one in the other unit.
    """
    if posture_deg is not None:
        key = f"{key}_deg"
        if robot.limits.prismatic.any():
            expected = "posture, in rad and, of joints that slide, m"
            raise InputError(source, key, "degrees, but a joint slides", expected)
    given = np.array(posture, dtype=float) if posture_deg is None else np.radians(posture_deg)
    _require_length(given, len(robot.joints), source, key)
    limits = robot.limits
    for k in np.flatnonzero(_beyond_ranges(given, limits)):
        unit = " m" if limits.prismatic[k] else " rad" if posture_deg is None else " deg"
        factor = 1.0 if posture_deg is None else np.degrees(1.0)
        got, least, most = (factor * float(each[k]) for each in (given, limits.lower, limits.upper))
        expected = f"the joint's range, {least:.4g} to {most:.4g}{unit}"
        otherwise = np.radians(given) if posture_deg is None else np.degrees(given)
        if not (limits.prismatic.any() or _beyond_ranges(otherwise, limits).any()):
            joint, q = robot.joints[k], f"q{k + 1}"
            if posture_deg is None:
                expected += f"; degrees? name them posture_deg, in a table {joint}_deg or {q}_deg"
            else:
                expected += f"; radians? name them posture, in a table {joint} or {q} (without _deg)"
        raise InputError(source, key, f"{robot.joints[k]} at {got:.4g}{unit}", expected)
    return given


def _beyond_ranges(q: FloatArray, limits: JointLimits) -> BoolArray:
    """Whether each joint (n,) is where the arm cannot have been, in a posture `q` (n,)."""
    return np.asarray((q < limits.lower - _RANGE_TOLERANCE) | (q > limits.upper + _RANGE_TOLERANCE))


def _require_length(posture: Any, n: int, source: str, key: str) -> None:
    if len(posture) != n:
        raise InputError(source, key, f"{len(posture)} numbers", f"{n}, one for each joint of the robot")


def _measured(scene: Scene) -> tuple[object, object]:
    """What measurements are of: the base, and the robot, whatever the scene says of its joints."""
    return scene.with_joints("elastic").robot, plain(scene.elastic_guardrail, scene.source)


def require_alike(sheets: Sequence[Measurements]) -> None:
    """Refuse sheets that are not of one robot on one base, with one prior."""
    require_type(sheets[0] if sheets else None, Measurements, "estimate", "measurements", "Measurements")
    first = sheets[0]
    for other in sheets[1:]:
        if _measured(other.scene) != _measured(first.scene):
            expected = f"the robot, payload and base of {first.source}, to be used with it"
            raise InputError(other.source, "scene", other.scene.name, expected)
        if other.setup.prior != first.setup.prior:
            expected = f"that of {first.source}: there is one model"
            raise InputError(other.source, "prior", "another prior", expected)
