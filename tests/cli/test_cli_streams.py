"""Standard streams that are closed or full, Ctrl-C at any time, and messages on a terminal."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command_line import command, environment, on_a_terminal, without_colours

# What the installed command runs; it tells when the first signal has a handler.
INSTALLED = """
import signal
from cmbot.__main__ import main
take_over = signal.signal
def told(*given):
    signal.signal = take_over
    take_over(*given)
    print("begun", flush=True)
signal.signal = told
main()
"""
# The same, where the folder that was written is never moved to its place: no signal comes too late.
UNFINISHED = "import time\nfrom pathlib import Path\nPath.rename = lambda *_: time.sleep(60.0)\n" + INSTALLED
VERBS = [("check", "triangle"), ("plan", "--options"), ("doctor",), ("--version",)]


@pytest.mark.parametrize("words", VERBS, ids=" ".join)
def test_a_reader_that_stops_is_no_error(words: tuple[str, ...]) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    done = subprocess.run(
        command(*words), env=environment(), stdout=theirs, stderr=subprocess.PIPE, text=True, check=False
    )
    os.close(theirs)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("words", VERBS, ids=" ".join)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_is_one_line(words: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            command(*words), env=environment(), stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == (
        "error: standard output: got a refusal of the system (No space left on device), "
        "expected room for what is printed\n"
    )


@pytest.mark.parametrize("stream", [1, 2])
def test_a_closed_stream_is_no_error(stream: int) -> None:
    line = f'exec "$@" {stream}>&-'
    done = subprocess.run(
        ["/bin/sh", "-c", line, "sh", *command("plan", "--options")],
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert bool(done.stdout) == (stream == 2)


def test_where_standard_error_is_full_the_status_says_it() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(command("check", "nosuch"), env=environment(), stderr=full, check=False)
    assert done.returncode == 2


def test_an_encoding_without_a_letter_is_no_error(tmp_path: Path) -> None:
    done = subprocess.run(
        command("check", "triangle", "--json"),
        env=environment(PYTHONIOENCODING="ascii"),
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1, 0.3, 0.6, 1.0])
def test_ctrl_c_is_quiet_at_any_time(delay: float, tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", UNFINISHED, "plan", "triangle", "--quiet", "-o", tmp_path / "plan"],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        time.sleep(delay)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert (process.returncode, out, err) == (130, b"", b"")
    assert not list(tmp_path.iterdir())


# What becomes of an exception where another language calls Python.
ELSEWHERE = {
    "another error": "    try:\n        signal.raise_signal(number)\n"
    "    except BaseException as error:\n        raise ValueError(repr(error)) from error\n",
    "nothing": "    try:\n        signal.raise_signal(number)\n    except BaseException:\n        pass\n",
    "a report": "    class Lost:\n        def __del__(self):\n            signal.raise_signal(number)\n"
    "    Lost()\n",
}


@pytest.mark.parametrize("becomes", ELSEWHERE)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_call_whatever_becomes_of_its_exception(
    becomes: str, number: signal.Signals, tmp_path: Path
) -> None:
    reading = f"def read(*_):\n{ELSEWHERE[becomes]}    return load(*_)\n"
    names = f"import cmbot, signal\nnumber, load = {number:d}, cmbot.load_scene\n"
    replaced = names + reading + "cmbot.load_scene = read\n"
    done = subprocess.run(
        [sys.executable, "-c", replaced + INSTALLED, "plan", "triangle", "--quiet", "-o", tmp_path / "plan"],
        env=environment(),
        capture_output=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (128 + number, b"begun\n", b"")
    assert not list(tmp_path.iterdir())


def test_what_else_nobody_receives_is_reported_as_ever() -> None:
    replaced = "class Lost:\n    def __del__(self):\n        raise ValueError('lost')\nimport cmbot\n"
    reading = "def read(*_):\n    Lost()\n    raise cmbot.SceneError('scene', '', 'one', 'another')\n"
    done = subprocess.run(
        [
            sys.executable,
            "-c",
            replaced + reading + "cmbot.load_scene = read\n" + INSTALLED,
            "plan",
            "triangle",
        ],
        env=environment(),
        capture_output=True,
        check=False,
    )
    assert done.returncode == 2
    assert b"ValueError: lost" in done.stderr


def test_a_call_that_is_terminated_leaves_nothing(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", UNFINISHED, "plan", "triangle", "--quiet", "-o", tmp_path / "plan"],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        while not any(tmp_path.iterdir()) and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate()
    assert (process.returncode, out, err) == (143, b"begun\n", b"")
    assert not list(tmp_path.iterdir())


def test_a_terminal_breaks_a_message_between_words() -> None:
    name = "no_such_scene_of_this_name.yaml"
    begun, erased, shown = on_a_terminal("plan", name, columns=50, status=2).partition("\r\x1b[2K")
    assert (begun, bool(erased)) == ("reading …", True)
    lines = without_colours(shown).split("\r\n")[:-1]
    assert len(lines) > 1
    assert all(len(line) <= 50 for line in lines)
    assert " ".join(line.rstrip() for line in lines) == (
        f"error: {name}: no such file, expected a scene file or the name of a shipped scene "
        "(one of: angle_steel, bracket_faces, clamped_triangle, gusset_plate, line, mast_inspection, "
        "panda_sanding, passing_train, pipe, triangle, "
        "two_brackets)"
    )
    # Quietly nothing is shown but the error.
    assert on_a_terminal("plan", name, "--quiet", columns=50, status=2) == shown


def test_a_ctrl_c_that_nothing_answers_any_more_is_one_all_the_same() -> None:
    """Python would end itself by the signal; a shell would not know that the command was stopped."""
    late = "import sys, cmbot.cli.commands as c\nsys.argv = ['cmbot', '--version']\ntry:\n    c.main()\n"
    late += "except SystemExit:\n    pass\nraise KeyboardInterrupt\n"
    done = subprocess.run([sys.executable, "-c", late], capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (130, b"")
