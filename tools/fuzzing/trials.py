"""What is done with a mutant, and whether its outcome is one that cmbot promises."""

from __future__ import annotations

import io
import re
import shutil
import sys
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

import cmbot
from cmbot.campaigns import read_campaign
from cmbot.cli import main
from cmbot.common.errors import CmbotError, InputError
from cmbot.identification import identified_rows, remarks
from cmbot.planning import bending_arm, precheck_scene, robot_of
from cmbot.robot import inspect_urdf, overview, parse_urdf, robot_files
from fuzzing.cases import Case

__all__ = ["LIMIT", "LONGEST_MESSAGE", "Verdict", "fresh_folder", "time_limit", "try_case"]

LIMIT = 5.0
"""Processor time in seconds that a mutant may take, unless it is planned or simulated."""
_LONG_LIMIT = 90.0
_LONG_VERBS = ("plan", "simulate", "identify", "new")
LONGEST_MESSAGE = 600

_NO_NUMBER = re.compile(r"(?<![\w.\-/'])[-+]?(nan|inf)(?![\w.\-/'])")
# A clearance is infinite where there is nothing to hit, a range where a joint is endless.
_MAY_BE_INFINITE = ("clearance", "lower", "upper", "bound", "value", "distance")
# Words and names that a file holds: text, no figures.
_NAMES = (".quantity", ".unit", ".scene")
_STATUSES = (0, 2, 3)
# Errors of another kind than bad input and no plan, whose status is 1.
_OTHER_ERRORS = re.compile(r"error: (the simulation diverges|.* is not installed; run: )")


@dataclass(frozen=True)
class Verdict:
    """How a trial ended.

    Attributes
    ----------
    outcome : str
        ``accepted``, ``refused``, or the kind of the finding.
    text : str
        Of a finding: what is wrong.
    place : str
        Of a finding: where, the same for findings of one cause.
    seconds : float
        Processor time.
    """

    outcome: str
    text: str = ""
    place: str = ""
    seconds: float = 0.0

    @property
    def is_finding(self) -> bool:
        """Whether cmbot broke a promise."""
        return self.outcome not in ("accepted", "refused")

    @property
    def cause(self) -> tuple[str, str]:
        """What findings of one cause share."""
        return self.outcome, self.place


def time_limit(case: Case) -> float:
    """Return the processor time that a mutant may take, s."""
    return _LONG_LIMIT if set(case.words) & set(_LONG_VERBS) else LIMIT


def try_case(case: Case, folder: Path) -> Verdict:
    """Write a mutant's files into an empty folder, the current one, run what reads them, and judge it."""
    for name, content in case.files.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    began = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        verdict = _judged(case)
    seconds = time.process_time() - began
    if not verdict.is_finding and caught:
        first = caught[0]
        place = f"{Path(first.filename).name}:{first.lineno}"
        verdict = Verdict("warning", f"{first.category.__name__}: {first.message}", place)
    if not verdict.is_finding and seconds > time_limit(case):
        verdict = Verdict("slow", f"{seconds:.1f} s", f"{case.kind} {' '.join(case.words[:1])}")
    return Verdict(verdict.outcome, verdict.text, verdict.place, seconds)


def _judged(case: Case) -> Verdict:
    try:
        if case.words:
            return _judged_command(case)
        readers = {
            "scene": _read_scene,
            "robot": _read_robot,
            "plan directory": _read_plan,
            "measurements": _read_measurements,
            "campaign": _read_campaign,
            "walk": _read_walk,
        }
        found = readers[case.kind](case)
    except CmbotError as error:
        return _judged_message(str(error), _place(error))
    except _BadMessageError as error:
        return error.verdict
    except MemoryError as error:
        return Verdict("memory", "more than 4 GiB", _place(error))
    except Exception as error:  # noqa: BLE001  whatever else is raised is what is sought
        return Verdict("untyped", f"{type(error).__name__}: {error}"[:300], _place(error))
    for where, value in _no_numbers(found, ""):
        return Verdict("not finite", f"{where} is {value}", re.sub(r"\d+", "", where))
    return Verdict("accepted")


def _judged_message(message: str, place: str) -> Verdict:
    if len(message.splitlines()) != 1:
        return Verdict("message", f"of {len(message.splitlines())} lines: {message[:200]!r}", place)
    if len(message) > LONGEST_MESSAGE:
        return Verdict("message", f"of {len(message)} characters: {message[:200]!r}", place)
    return Verdict("refused")


def _place(error: BaseException) -> str:
    """The innermost line of cmbot that an error came through, and its type."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "/cmbot/" in frame.filename]
    # Where a message is too long, it is not the common check that has to change.
    frames = [frame for frame in frames if Path(frame.filename).name != "validation.py"] or frames
    at = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "?"
    return f"{type(error).__name__} at {at}"


def _read_measurements(_: Case) -> Any:
    found = cmbot.identify("measurements.yaml")
    known = found.stiffness, list(identified_rows(found)), list(remarks(found)), found.after
    scene = cmbot.load_scene("identified.yaml")
    arm = bending_arm(scene, robot_of(scene))
    return known, None if arm is None else arm.stiffness


def _read_walk(_: Case) -> Any:
    walk = cmbot.load_walk(".")
    checks = [check for move in walk.moves for check in move.segment.certificate.checks]
    return walk.seconds, walk.effort, walk.adhesion_needed, checks, list(walk.in_words())


def _read_campaign(_: Case) -> Any:
    _, entries = read_campaign("campaign.yaml")
    return [(entry.at_m, entry.scene.posture) for entry in entries]


def _read_scene(_: Case) -> Any:
    scene = cmbot.load_scene("scene.yaml")
    found = precheck_scene(scene)
    bending_arm(scene, robot_of(scene))
    return dict(found.found), found.warnings


def _read_robot(case: Case) -> Any:
    root = parse_urdf(Path("arm.urdf"))
    found: list[Any] = inspect_urdf(root)
    for finding in found:
        if finding.severity == "error":
            text = str(InputError("arm.urdf", finding.key, finding.got, finding.expected))
            if (verdict := _judged_message(text, f"inspection, {finding.expected[:20]}")).is_finding:
                raise _BadMessageError(verdict)
    if not any(finding.severity == "error" for finding in found):
        found.append(dict(overview(robot_files("arm.urdf"), root)))
    return found, _read_scene(case)


class _BadMessageError(Exception):
    """A message of the inspection that is not one short line."""

    def __init__(self, verdict: Verdict) -> None:
        super().__init__(verdict.text)
        self.verdict = verdict


def _read_plan(case: Case) -> Any:
    plan = cmbot.load_plan(".", verify=case.verify)
    tracking = cmbot.load_tracking(plan, ".")
    baseline = None if plan.baseline is None else plan.baseline.figures
    figures = baseline, plan.figures, plan.certificate, plan.objective
    return plan.summary(), figures, tracking if tracking is None else tracking.planned


def _judged_command(case: Case) -> Verdict:
    out, err = io.StringIO(), io.StringIO()
    argv, hook = sys.argv, sys.excepthook
    sys.argv = ["cmbot", *case.words]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            main()
    except SystemExit as ended:
        status = ended.code if isinstance(ended.code, int) else 0 if ended.code is None else 1
    except MemoryError as error:
        return Verdict("memory", "more than 4 GiB", _place(error))
    except Exception as error:  # noqa: BLE001  as in `_judged`
        return Verdict("untyped", f"{type(error).__name__}: {error}"[:300], _place(error))
    finally:
        sys.argv, sys.excepthook = argv, hook
    return _judged_output(case, int(status), out.getvalue(), err.getvalue())


def _judged_output(case: Case, status: int, out: str, err: str) -> Verdict:
    verb, lines = case.words[0][:20], err.splitlines()
    errors = [line for line in lines if line.startswith("error: ")]
    if status not in _STATUSES and not any(map(_OTHER_ERRORS.match, errors)):
        return Verdict("status", f"{status}: {err[-300:]!r}", verb)
    if len(errors) > 1 or (errors and lines[-1] != errors[0]) or bool(status) < len(errors):
        return Verdict("message", f"status {status}, not one line: {err[-300:]!r}", verb)
    if "Traceback" in err or "Traceback" in out:
        return Verdict("message", f"a traceback: {err[-300:]!r}", verb)
    # A folder may be called nan: what the command line says is no figure.
    found = (match for match in _NO_NUMBER.finditer(out) if match[0] not in case.words)
    if status == 0 and (no_number := next(found, None)):
        return Verdict("not finite", f"{out[max(no_number.start() - 60, 0) : no_number.end()]!r}", verb)
    if longest := [line for line in lines if len(line) > LONGEST_MESSAGE]:
        return Verdict("message", f"of {len(longest[0])} characters: {longest[0][:200]!r}", verb)
    if status == 0 and case.verify:
        cmbot.load_plan("out", verify=True)
    return Verdict("refused" if status else "accepted")


def _no_numbers(value: Any, where: str) -> Iterator[tuple[str, Any]]:
    """Numbers in nested results that are not finite, and their places."""
    if isinstance(value, str):
        if where.endswith(_NAMES):
            return
        if found := _NO_NUMBER.search(value):
            yield where, value[max(found.start() - 60, 0) : found.end()]
    elif isinstance(value, float | np.ndarray):
        infinite = any(word in where for word in _MAY_BE_INFINITE)
        array = np.asarray(value)
        if array.dtype.kind == "f" and (np.isnan(array).any() or not (infinite or np.isfinite(array).all())):
            yield where, "not finite"
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            yield from _no_numbers(getattr(value, field.name), f"{where}.{field.name}")
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _no_numbers(item, f"{where}.{key}")
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            yield from _no_numbers(item, f"{where}[{k}]")


def fresh_folder(folder: Path) -> Path:
    """Empty a folder, making it where it is missing."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder
