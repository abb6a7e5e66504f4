"""What goes to the robot: tables and messages of a plan, compared with what its knots make of them."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from pydantic_core import from_json

from cmbot.archive.folder import listed_name, read_file
from cmbot.archive.records import BASELINE_FILE, JOB_FILES, PLAN_FILE, require_same
from cmbot.archive.ros.messages import MAX_DEVIATION, bag, messages, trajectory_message
from cmbot.archive.tables import require_table, samples_csv
from cmbot.archive.writing import job_table
from cmbot.common.arrays import IntArray
from cmbot.common.errors import ArchiveError
from cmbot.common.reading.validation import counted, require_unique_keys, shown
from cmbot.planning import Plan

# What numbers of messages may differ by, as a share and at least: processors round differently.
_SAME, _SAME_ZERO, _WHY = 1e-6, 1e-9, "the knots have it"
_LARGEST_FILE = 500_000_000


@dataclass(frozen=True, kw_only=True)
class FilesBeside:
    """Which files beside a plan's record agree with it, and which are not compared, or lack what moves."""

    compared: tuple[str, ...] = ()
    others: tuple[str, ...] = ()


def compared_files(plan: Plan, folder: Path) -> FilesBeside:
    """Compare the files beside a plan's record with the plan.

    Compared are ``job.csv`` and ``baseline.csv``, and what `cmbot.archive.export_csv`, `export_ros` and,
    where mcap-ros2-support is installed, `export_mcap` have written there.

    Parameters
    ----------
    plan : Plan
        Its certificate holds.
    folder : Path

    Raises
    ------
    ArchiveError
        When one of them has another motion than the plan.
    """
    compared, others = list[str](), list[str]()
    for path in sorted(folder.iterdir()):
        if path.name in (PLAN_FILE, JOB_FILES[1]):
            continue
        # What is hidden may be another motion as well.
        compare = None if path.name.startswith(".") else _KINDS.get(path.suffix)
        named = [listed_name(path)]
        told = compare(plan, path) if compare is not None and path.is_file() else named
        others += told
        compared += [] if told else named
    return FilesBeside(compared=tuple(compared), others=tuple(others))


def _table(plan: Plan, path: Path) -> list[str]:
    """Compare a table with the job, or with the work alone; its name if it is one of something else."""
    content, source = read_file(path, _LARGEST_FILE), str(path)
    if path.name == BASELINE_FILE and plan.baseline is not None:
        expected = samples_csv(plan.baseline.samples, source)
    elif path.name == JOB_FILES[0] or content.startswith(b"t,q1,"):
        expected = job_table(plan, source)
        rows = content.count(b"\n")
        if path.name != JOB_FILES[0] and rows != expected.count(b"\n"):
            # That whose rows are nearly as many.
            each = expected, job_table(plan, source, work=True)
            expected = min(each, key=lambda one: abs(one.count(b"\n") - rows))
    else:
        return [listed_name(path)]
    require_table(content, expected, source)
    return []


def _message(plan: Plan, path: Path) -> list[str]:
    """Compare a file with the job as a ``JointTrajectory``; its name if it is none, or lacks joints."""
    content, source = read_file(path, _LARGEST_FILE), str(path)
    data: object = None
    with suppress(ValueError):
        data = from_json(content)
    if not isinstance(data, Mapping) or not data.keys() & {"joint_names", "points"}:
        return [listed_name(path)]
    require_unique_keys(content, source, ArchiveError)
    times, joints, effort = _as_given(data, plan, source)
    found = trajectory_message(plan, times, joints=joints, effort=effort)
    require_same(data, found.message, source, "", _SAME, _SAME_ZERO, _WHY)
    if found.deviation > MAX_DEVIATION:
        got = f"points whose quintics are {found.deviation:.3g} rad (or m) off"
        raise ArchiveError(source, "points", got, f"the motion within {MAX_DEVIATION:g}, as {_WHY}")
    if found.tool_deviation > (most := plan.options.max_tool_deviation_m):
        got = f"points whose quintics lead the tool {1e3 * found.tool_deviation:.3g} mm off"
        raise ArchiveError(source, "points", got, f"{1e3 * most:g} mm at most (planner.max_tool_deviation_m)")
    lacking = ", ".join(found.left_out)
    return [f"{listed_name(path)} (lacks what moves: {lacking})"] if lacking else []


def _as_given(data: Mapping[str, Any], plan: Plan, source: str) -> tuple[IntArray, list[str], bool]:
    """Times, joints and whether there are efforts, of a message: of these the plan makes another one."""
    names, points = data.get("joint_names"), data.get("points")
    if not isinstance(names, list) or not set(map(str, names)) <= set(plan.robot.joints):
        raise ArchiveError(source, "joint_names", shown(names), f"joints of the arm, as {_WHY}")
    try:
        each = [point["time_from_start"] for point in points]  # type: ignore[union-attr]
        times = np.array([time["sec"] * 10**9 + time["nanosec"] for time in each], dtype=np.intp)
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise ArchiveError(source, "points", shown(points), f"points with times, as {_WHY}") from error
    end = plan.job.duration
    if len(times) < 2 or times[0] != 0 or (np.diff(times) <= 0).any() or abs(times[-1] - 1e9 * end) > 1:
        got = f"{counted(len(times), 'point')}, an end at {1e-9 * times.max(initial=0):.9g} s"
        raise ArchiveError(source, "points", got, f"times that increase from 0 to {end:.9g} s, as {_WHY}")
    return times, names, bool(points) and "effort" in points[0]  # type: ignore[index]


def _bag(plan: Plan, path: Path) -> list[str]:
    """Compare an MCAP file with the messages of the job; its name where it cannot be read."""
    if find_spec("mcap_ros2") is None:
        return [listed_name(path)]
    from mcap.exceptions import McapError
    from mcap.reader import make_reader
    from mcap.writer import MCAP0_MAGIC
    from mcap_ros2.decoder import DecoderFactory
    from zstandard import ZstdError

    content, source = read_file(path, _LARGEST_FILE), str(path)
    try:
        reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
        found = [
            (channel.topic, record.log_time, message)
            for _, channel, record, message in reader.iter_decoded_messages()
        ]
        # What the index leaves out is found by whoever reads from the beginning.
        told = _beside_messages(content)
    except (McapError, ZstdError, KeyError, RuntimeError, ValueError, struct.error) as error:
        raise ArchiveError(source, "", "a damaged file", "an MCAP file of ROS 2 messages") from error
    if content.count(MCAP0_MAGIC) != 2:
        raise ArchiveError(source, "", "more bytes than one recording", "one, as cmbot export writes it")
    job = next((message for topic, _, message in found if topic == "/joint_trajectory"), None)
    effort = job is not None and len(job.points) > 0 and len(job.points[0].effort) > 0
    sent = list(messages(plan, effort=effort))
    expected = [(topic, round(1e9 * time), message) for topic, _, time, message in sent]
    if len(found) != len(expected):
        raise ArchiveError(source, "", f"{len(found)} messages", f"{len(expected)}, as {_WHY}")
    for (topic, time, message), (wanted_topic, wanted_time, wanted) in zip(found, expected, strict=True):
        key = f"{wanted_topic} at {1e-9 * wanted_time:g} s"
        require_same((topic, time), (wanted_topic, wanted_time), source, key, 0.0, 0.0, _WHY)
        require_same(_plain(message, wanted), wanted, source, key, _SAME, _SAME_ZERO, _WHY)
    # One message of each topic has all that a file says of it.
    once, _ = _beside_messages(bag({each[0]: each for each in sent}.values()))
    numbers = sorted(str([time, time, 0]) for _, time, _ in expected)
    for one, other in zip_longest([*chain(*told)], [*once, *numbers], fillvalue="nothing"):
        if one != other:
            raise ArchiveError(
                source, "beside its index", shown(one), f"{shown(other)}, as cmbot export has it"
            )
    return []


def _beside_messages(content: bytes) -> tuple[list[str], list[str]]:
    """What an MCAP file says beside its messages, and of each its times and its number."""
    from mcap.records import Attachment, Channel, Header, Message, Metadata, Schema
    from mcap.stream_reader import StreamReader

    own, once, each = {"library", "id", "schema_id"}, set[str](), list[str]()
    for one in StreamReader(io.BytesIO(content)).records:
        if isinstance(one, Message):
            each.append(str([one.log_time, one.publish_time, one.sequence]))
        elif isinstance(one, Header | Schema | Channel | Attachment | Metadata):
            # They may be repeated.
            said = {name: value for name, value in vars(one).items() if name not in own}
            once.add(f"{type(one).__name__}: {said}")
    return sorted(once), sorted(each)


def _plain(message: Any, like: Any) -> Any:
    """A message as mappings and lists, with the fields that another one has."""
    if isinstance(like, Mapping):
        return {name: _plain(getattr(message, name), value) for name, value in like.items()}
    if isinstance(like, list):
        # What one of them has more of is left as it is, which differs.
        return [_plain(*pair) if None not in pair else pair[0] for pair in zip_longest(message, like)]
    return message


_KINDS: Mapping[str, Callable[[Plan, Path], list[str]]] = {".csv": _table, ".json": _message, ".mcap": _bag}
