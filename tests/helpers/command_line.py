"""Runs the command line: in this process, or in one of its own."""

import json
import os
import pty
import re
import subprocess
import sys
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from cmbot.cli import main

ROOT = Path(__file__).resolve().parent.parent.parent
# What a shell runs as `cmbot`; a test can put lines before it.
ENTRY = "from cmbot.cli import main\nmain()\n"
# What every command has to print with --json.
SUMMARIES = jsonschema.Draft202012Validator(
    json.loads((ROOT / "scenes" / "summary.schema.json").read_text(encoding="utf-8"))
)
# What would make rich believe in a terminal, or in a width.
_TERMINAL = ("FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE", "COLUMNS", "NO_COLOR", "CLICOLOR_FORCE")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Exit status and what was printed."""

    status: int
    out: str
    err: str


def run(*words: str | Path) -> Outcome:
    """Run ``cmbot WORDS`` in this process."""
    out, err = StringIO(), StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["cmbot", *map(str, words)])
        patch.setattr(sys, "excepthook", sys.excepthook)  # main sets its own
        for name in _TERMINAL:
            patch.delenv(name, raising=False)
        # Tests have a processor each, and other processes not what is set for tests.
        patch.setattr("cmbot.common.workers.processors", lambda: 1)
        with pytest.raises(SystemExit) as ended:
            main()
    outcome = Outcome(status=int(ended.value.code or 0), out=out.getvalue(), err=err.getvalue())
    if "--json" in words and outcome.out:
        SUMMARIES.validate(json.loads(outcome.out))
    return outcome


def output(*words: str | Path, status: int = 0) -> str:
    """What ``cmbot WORDS`` prints; it has to end with that status and tell of no error."""
    outcome = run(*words)
    assert (outcome.status, outcome.err) == (status, ""), outcome.err
    return outcome.out


def refusal(*words: str | Path, status: int = 2) -> str:
    """The error of ``cmbot WORDS``, which has to end with that status."""
    outcome = run(*words)
    assert outcome.status == status
    return one_line(outcome)


def one_line(outcome: Outcome) -> str:
    """The error's one line, nothing else having been printed."""
    assert outcome.out == ""
    assert re.fullmatch(r"error: [^\n]+\n", outcome.err), outcome.err
    assert "Traceback" not in outcome.err
    assert "\x1b" not in outcome.err
    return outcome.err.rstrip("\n")


def run_apart(*words: str | Path, before: str = "") -> Outcome:
    """Run ``cmbot WORDS`` in a process of its own, after some Python."""
    done = subprocess.run(
        command(*words, before=before), env=environment(), capture_output=True, text=True, check=False
    )
    return Outcome(status=done.returncode, out=done.stdout, err=done.stderr)


def on_a_terminal(*words: str | Path, columns: int, status: int = 0) -> str:
    """What ``cmbot WORDS`` shows on a terminal so wide, on all three streams; it has to end with a status."""
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command(*words),
        env=environment(TERM="xterm-256color", COLUMNS=str(columns)),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    ) as process:
        os.close(theirs)
        shown = b""
        try:
            while chunk := os.read(ours, 65536):
                shown += chunk
        except OSError:  # how a terminal ends that nobody writes to any longer
            pass
        finally:
            os.close(ours)
        assert process.wait() == status, shown
    return shown.decode()


def command(*words: str | Path, before: str = "") -> list[str]:
    """What starts ``cmbot WORDS`` in a process of its own."""
    return [sys.executable, "-c", before + ENTRY, *map(str, words)]


def environment(**changes: str) -> dict[str, str]:
    """Environment of that process: this checkout, and no trace of a terminal."""
    kept = {name: value for name, value in os.environ.items() if name not in _TERMINAL}
    return kept | {"PYTHONPATH": str(ROOT)} | changes


def without_colours(text: str) -> str:
    """Text without what only a terminal understands."""
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)


def plain(text: str) -> str:
    """Text without colours, boxes and line breaks."""
    return " ".join(re.sub(r"[─│╭╮╰╯]", " ", without_colours(text)).split())


def write_scene(path: Path, data: Mapping[str, Any]) -> Path:
    """Write a scene file; JSON is YAML."""
    path.write_text(json.dumps(data), encoding="utf-8")
    return path
