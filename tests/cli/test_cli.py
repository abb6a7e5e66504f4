"""What the commands do, write and print when all goes well."""

import re
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from unittest.mock import Mock
from urllib.request import urlopen

import pytest
from command_line import (
    Outcome,
    command,
    environment,
    on_a_terminal,
    output,
    plain,
    refusal,
    run,
    run_apart,
    without_colours,
    write_scene,
)
from plan_folders import names
from small_scenes import SHORT

import cmbot
from cmbot.archive import claim
from cmbot.cli import COMMANDS

SAVED = {"plan.json", "job.csv", "job.npz", "baseline.csv", "replay.html", "report.html"}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli")
    write_scene(folder / "short.yaml", SHORT)
    return folder


@pytest.fixture(scope="module")
def planned(folder: Path) -> Outcome:
    """What ``cmbot plan`` says; it writes folder/plan."""
    return run("plan", folder / "short.yaml", "--output", folder / "plan")


@pytest.fixture
def directory(folder: Path, planned: Outcome, tmp_path: Path) -> Path:
    assert planned.status == 0, planned.err
    return shutil.copytree(folder / "plan", tmp_path / "plan")


@pytest.fixture
def known(directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> cmbot.Plan:
    """The plan that ``cmbot plan`` finds at once, so that only what is around the planning is tested."""
    known = cmbot.load_plan(directory)
    monkeypatch.setattr(cmbot, "plan", lambda scene, options, partial, progress: known)
    monkeypatch.chdir(tmp_path)
    write_scene(Path("short.yaml"), SHORT)
    return known


def test_version_of_the_command_and_of_the_module() -> None:
    assert run("--version") == Outcome(status=0, out=f"{cmbot.__version__}\n", err="")
    words = [sys.executable, "-m", "cmbot", "--version"]
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{cmbot.__version__}\n", "")


def test_help_shows_an_example_and_every_verb() -> None:
    outcome, without_a_verb = run("--help"), run()
    assert (outcome.status, outcome.err, without_a_verb.err) == (0, "", "")
    text = plain(outcome.out)
    assert "Example: cmbot plan triangle" in text
    assert "Example: cmbot plan triangle" in plain(without_a_verb.out)
    ends = "0 done, 2 bad input, 3 no plan, 130 stopped with Ctrl-C, 143 terminated, 1 anything else."
    assert f"Exit status: {ends}" in text
    assert all(f" {verb} " in text for verb in ("plan", "simulate", "reproduce", "replay", "check", "doctor"))


def test_the_manual_has_the_help_of_every_command() -> None:
    text = output("--help-all")
    assert text.startswith(output("--help"))
    assert [verb for verb in COMMANDS if output(verb, "--help") not in text] == []


def test_help_breaks_lines_where_the_terminal_does_and_gives_flags_no_value(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("cmbot.cli.console.out.width", 60)
    text = output("stand", "--help")
    assert "\nFor the shipped robot, an arm on a climber that holds a\nguardrail, and for any arm" in text
    assert max(map(len, text.splitlines())) <= 60
    assert "  --one-foot  " in text
    assert "[default: 0.05]" in " ".join(text.split())


def test_plan_writes_a_directory_and_prints_plain_lines(folder: Path, planned: Outcome) -> None:
    assert planned.status == 0, planned.err
    assert names(folder) == {"short.yaml", "plan"}
    assert names(folder / "plan") >= SAVED
    assert (folder / "plan" / "replay.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    plan = cmbot.load_plan(folder / "plan")
    assert plan.scene.name == "short"
    lines, table = planned.out.splitlines(), plan.summary().splitlines()
    assert lines[0].split() == ["baseline", "planned"]
    assert lines[1 : len(table)] == table[1:]
    # At most ten figures and five sentences, of which the first is about the tool.
    assert lines[len(table)].startswith("The tool is within ")
    assert len(table) <= 11 and len(lines) - len(table) <= 5 + 1
    written = re.escape(str(folder / "plan"))
    look = rf"open {written}/report\.html in a browser; --verbose prints the rest\."
    assert re.fullmatch(rf"Written to {written} in \d+\.\d s: {look}", lines[-1])
    assert "\x1b" not in planned.out + planned.err
    assert planned.err == ""


def test_plan_near_an_earlier_one(folder: Path, directory: Path, tmp_path: Path) -> None:
    asked = ("plan", folder / "short.yaml", "--near", directory, "--verbose")
    outcome = run(*asked, "--output", tmp_path / "near", "--set", "robot.payload_kg=0.2")
    assert outcome.status == 0, outcome.err
    near, told = cmbot.load_plan(tmp_path / "near", verify=True), "Planned near an earlier plan: "
    assert near.scene.robot.payload_kg == 0.2
    assert near.fallbacks[0].startswith(told)
    assert told in outcome.out
    refused = run(*asked, "--output", tmp_path / "both", "--partial")
    assert refused.status == 2
    assert refused.err.startswith("error: cmbot plan: --partial, --near: got both, expected one of them")
    legs = [{"by": [0, 0.05, 0], "seconds": 3}] * 3
    write_scene(tmp_path / "other.yaml", {**SHORT, "tool_path": {"legs": legs}})
    other = run("plan", tmp_path / "other.yaml", "--near", directory, "--output", tmp_path / "no")
    assert other.status == 2
    assert "scene.tool_path: got other strokes, expected the strokes of the plan" in other.err


def test_plan_on_a_terminal_draws_a_table(folder: Path, tmp_path: Path) -> None:
    """A narrow terminal on all three streams."""
    text = on_a_terminal("plan", folder / "short.yaml", "-o", tmp_path / "out", columns=78)
    assert re.search(r"│ peak torque at work, Nm +│ +\d+\.\d\d │ +\d+\.\d\d │", without_colours(text))
    assert "\x1b[" in text
    assert "following the tool path" in text
    # A path on the last line is never broken, so that it can be copied.
    assert f"open {tmp_path / 'out' / 'report.html'} in a browser; --verbose" in text


@pytest.mark.usefixtures("known")
def test_plan_writes_to_out_by_default_and_shows_a_name_as_it_is(tmp_path: Path) -> None:
    assert run("plan", "short.yaml").status == 0
    assert names(tmp_path / "out") == {"short"}
    assert names(tmp_path / "out" / "short") >= SAVED
    (tmp_path / "out" / "short" / "replay.html").write_text("old", encoding="utf-8")
    (tmp_path / "out" / "short" / "notes.txt").touch()
    assert run("plan", "short.yaml", "--force").status == 0
    assert "notes.txt" in names(tmp_path / "out" / "short")
    assert (tmp_path / "out" / "short" / "replay.html").stat().st_size > 100_000
    name = "a [red]b[/red]  :warning:"
    assert f"Written to {name} in " in output("plan", "short.yaml", "-o", name)
    assert names(tmp_path / name) >= SAVED


@pytest.mark.parametrize("force", [(), ("--force",)])
def test_plan_refuses_what_is_in_the_way_before_it_plans(
    known: cmbot.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: tuple[str, ...]
) -> None:
    monkeypatch.setattr(cmbot, "plan", Mock(side_effect=pytest.fail.Exception("planned first")))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work", encoding="utf-8")
    line = refusal("plan", "short.yaml", "-o", "mine", *force)
    assert re.fullmatch(r"error: mine: got a folder .*--force.*", line)
    assert (tmp_path / "mine" / "thesis.txt").read_text(encoding="utf-8") == "years of work"


@pytest.mark.parametrize("verb", ["replay", "report"])
def test_a_page_is_written_anew_or_elsewhere(directory: Path, tmp_path: Path, verb: str) -> None:
    page, elsewhere = directory / f"{verb}.html", tmp_path / "seen.html"
    size = page.stat().st_size
    page.unlink()
    assert run(verb, directory) == Outcome(status=0, out=f"Written to {page}.\n", err="")
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert page.stat().st_size == pytest.approx(size, rel=1e-3)
    before = {path: path.read_bytes() for path in directory.iterdir()}
    outcome = run(verb, directory, "--html", elsewhere)
    assert outcome == Outcome(status=0, out=f"Written to {elsewhere}.\n", err="")
    assert elsewhere.stat().st_size > 100_000
    assert {path: path.read_bytes() for path in directory.iterdir()} == before


def test_report_replaces_no_file_elsewhere_unasked(directory: Path, tmp_path: Path) -> None:
    page = tmp_path / "mine.html"
    page.write_text("mine", encoding="utf-8")
    outcome = run("report", directory, "--html", page)
    expected = f"error: {page}: got a file that is already there, expected a new file, or --force\n"
    assert outcome == Outcome(status=2, out="", err=expected)
    assert page.read_text(encoding="utf-8") == "mine"
    assert run("report", directory, "--html", page, "--force").status == 0
    assert page.stat().st_size > 100_000


def test_what_a_killed_call_left_is_removed(directory: Path) -> None:
    for part in (directory / ".report.html.part", directory / ".plan.json.part"):
        part.write_bytes(b"half of")
    directory.with_name(".plan.lock").touch()
    outcome = run_apart("report", directory)
    assert (outcome.status, outcome.err) == (0, "")
    assert not [name for name in names(directory) | names(directory.parent) if name.startswith(".")]


def test_a_plan_directory_may_be_the_current_folder(
    directory: Path, known: cmbot.Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(directory)
    for words in (("plan", "../short.yaml", "--force", "-o", "."), ("simulate", "."), ("report", ".")):
        assert run(*words).status == 0
    assert names(Path()) >= {"tracking.json", "report.html"}
    assert names(directory.parent) == {"plan", "short.yaml"}


@pytest.mark.usefixtures("known")
def test_where_another_process_writes_a_call_is_refused_in_one_line(directory: Path) -> None:
    ended, claimed = Event(), Event()

    def other() -> None:
        with claim(directory):
            claimed.set()
            ended.wait()

    with ThreadPoolExecutor() as threads:
        done = threads.submit(other)
        claimed.wait()
        try:
            for words in (
                ("plan", "short.yaml", "-o", directory, "--force"),
                ("simulate", directory, "--force"),
                ("replay", directory),
                ("report", directory),
            ):
                line = refusal(*words)
                assert line.startswith(f"error: {directory}: got a place where another process is writing")
            cmbot.load_plan(directory)
        finally:
            ended.set()
        done.result()
    assert run("report", directory).status == 0


def test_replay_serves_the_page_until_ctrl_c(directory: Path) -> None:
    with subprocess.Popen(
        command("replay", directory, "--serve"),
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            line = process.stdout.readline()
            found = re.fullmatch(r"Replay of short at (http://127\.0\.0\.1:\d+/); stop with Ctrl-C\.\n", line)
            assert found, line
            with urlopen(found[1], timeout=60) as answer:
                page = answer.read().decode()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert run("replay", directory).status == 0
    assert page == (directory / "replay.html").read_text(encoding="utf-8")
    assert (process.returncode, out, err) == (0, "", "")
