"""Kill commands at every system call that changes names, and report what is left; needs strace.

Run it with ``python tools/kill_calls.py [COMMAND ...]``, such as ``"simulate --force"``; without a command it
takes all of them, some minutes each. The status is 1 if a kill left neither the old nor the new state.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cmbot

SCENE = {
    "format": "cmbot-scene/2",
    "name": "short",
    "robot": {"model": "cmbot"},
    "start": {"posture_deg": [-10, -90, 90, 0, 10, 50, 0]},
    "tool_path": {"legs": [{"by": [0, -0.3, 0], "seconds": 4}], "via_points": 8},
    "planner": {"knots": "fixed", "path_step_s": 0.02},
}
SYSTEM_CALLS = "chmod,flock,fsync,link,linkat,mkdir,rename,renameat2,rmdir,unlink,unlinkat"
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
        (work / "plan" / "report.html").write_text("old", encoding="utf-8")
    work.rename(before)
    shutil.copytree(before, work)
    _run(words, "-o", "log", "-e", f"trace={SYSTEM_CALLS}")
    old, wanted = _contents(before / "plan"), _contents(work / "plan")
    changed = {name for name in wanted if wanted[name] != old.get(name)}
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
        found = _contents(work / "plan")
        notes = [path.read_text(encoding="utf-8") for path in work.rglob(NOTES)]
        if notes != ["mine"] * len(made_by[:1]):
            yield "neither"
        elif found == old:
            yield "old"
        else:
            renewed = {name for name in found if found[name] != old.get(name)}
            whole = found.keys() == wanted.keys() and renewed == changed and _is_readable(work / "plan")
            yield "new" if whole else "neither"


def _run(words: tuple[str, ...], *strace: str, status: int = 0) -> None:
    """Run cmbot, under strace if it is given options."""
    command = [sys.executable, "-c", ENTRY, *words]
    if strace:
        command = ["strace", "-f", *strace, *command]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != status:
        sys.exit(f"{' '.join(words)}: status {done.returncode}: {done.stderr}")


def _contents(folder: Path) -> dict[str, bytes]:
    """What the files of a plan directory hold, but for those that are not the plan's."""
    return {path.name: path.read_bytes() for path in folder.glob("[!.]*") if path.name != NOTES}


def _is_readable(directory: Path) -> bool:
    """Whether plan and tracking errors are there and belong to each other."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cmbot.load_tracking(cmbot.load_plan(directory), directory)
    except cmbot.InputError:
        return False
    return True


if __name__ == "__main__":
    main()
