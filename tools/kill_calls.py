"""Kill commands at every system call that changes names, and report what is left; needs strace.

Run it with ``python tools/kill_calls.py [COMMAND ...]``, such as ``"simulate --force"``; without a command it
takes all of them, some minutes each. The status is 1 if a kill left neither the old nor the new state.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cmbot
import cmbot.archive
from cmbot.archive.folder import read_record

SCENE = {
    "format": "cmbot-scene/2",
    "name": "short",
    "robot": {"model": "cmbot"},
    "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
    "tool_path": {"legs": [{"by": [0, -0.3, 0], "seconds": 4}], "via_points": 8},
    "planner": {"knots": "fixed", "path_step_s": 0.02},
}
SYSTEM_CALLS = "flock,mkdir,rename,rmdir,unlink,unlinkat"
ENTRY = "from cmbot.cli import main; main()"
NOTES = "notes.txt"
# The words of each command, and those that make what is there before it.
PLAN, SIMULATE = ("plan", "short.yaml", "-o", "work/plan"), ("simulate", "work/plan")
COMMANDS = {
    "plan": (PLAN, []),
    "plan --force": ((*PLAN, "--force", "--set", "smoothing_weight=0.3"), [PLAN, SIMULATE]),
    "simulate": (SIMULATE, [PLAN]),
    "simulate --force": ((*SIMULATE, "--force", "--damping", "0.05"), [PLAN, SIMULATE]),
    "report": (("report", "work/plan"), [PLAN, SIMULATE]),
}


def main() -> None:
    """Try the commands that are named, or all of them."""
    if shutil.which("strace") is None:
        print("strace is not installed: nothing is tried")
        return
    names = sys.argv[1:] or list(COMMANDS)
    lost = 0
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            Path("short.yaml").write_text(json.dumps(SCENE), encoding="utf-8")
            left = Counter(_kills(*COMMANDS[name]))
            os.chdir("/")
        lost += left["neither"]
        found = ", ".join(f"{left[state]} {state}" for state in ("old", "new", "neither"))
        print(f"{name}: {left.total()} kills left {found}", flush=True)
    sys.exit(lost > 0)


def _kills(words: tuple[str, ...], made_by: list[tuple[str, ...]]) -> Iterator[str]:
    """Yield what each kill of a command leaves: old, new or neither."""
    before, work = Path("before"), Path("work")
    work.mkdir()
    for made in made_by:
        _run(made)
    if made_by:
        (work / "plan" / NOTES).write_text("mine", encoding="utf-8")
        cmbot.archive.add_file(work / "plan", "report.html", b"old")
    work.rename(before)
    shutil.copytree(before, work)
    _run(words, "-o", "log", "-e", f"trace={SYSTEM_CALLS}")
    old, wanted = _state(before / "plan"), _state(work / "plan")
    lines = re.findall(r"^(\d+) +(\w+)\(", Path("log").read_text(encoding="utf-8"), flags=re.MULTILINE)
    # strace counts the calls of each thread by itself; the main one does all of the writing.
    calls = [call for thread, call in lines if thread == lines[0][0]]
    reached: Counter[str] = Counter()
    for call in calls:
        reached[call] += 1
        shutil.rmtree(work)
        shutil.copytree(before, work)
        kill = f"inject={call}:signal=KILL:when={reached[call]}"
        _run(words, "-o", "log", "-e", f"trace={SYSTEM_CALLS}", "-e", kill, status=-9)
        notes = [path.read_text(encoding="utf-8") for path in work.rglob(NOTES)]
        found = _state(work / "plan")
        if notes != ["mine"] * len(made_by[:1]) or found not in (old, wanted):
            yield "neither"
        else:
            yield "old" if found == old else "new"


def _run(words: tuple[str, ...], *strace: str, status: int = 0) -> None:
    """Run cmbot, under strace if it is given options."""
    command = [sys.executable, "-c", ENTRY, *words]
    if strace:
        command = ["strace", "-f", *strace, *command]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != status:
        sys.exit(f"{' '.join(words)}: status {done.returncode}: {done.stderr}")


def _state(folder: Path) -> tuple[frozenset[str], str] | None:
    """What a reader finds in a plan directory: the names of its files, and figures that tell plans apart."""
    try:
        plan = cmbot.load_plan(folder, verify=True)
        tracking = cmbot.load_tracking(plan, folder)
    except cmbot.InputError:
        return None
    data = read_record(folder, "plan.json")
    report = data["files"].get("report.html") == hashlib.sha256(b"old").hexdigest()
    said = (plan.figures, None if tracking is None else tracking.options, report)
    return frozenset(data["files"]), repr(said)


if __name__ == "__main__":
    main()
