"""What the verbs of the command line do, write and print when all goes well."""

import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import pytest
from command_line import (
    Outcome,
    command,
    environment,
    on_a_terminal,
    plain,
    run,
    without_colours,
    write_scene,
)
from small_scenes import SHORT

import cmbot

SAVED = {"plan.json", "baseline.csv", "replay.html", "report.html"} | {
    f"trajectory.{suffix}" for suffix in ("csv", "npz", "ros.json")
}
FIGURES = ("peak torque on the guardrail, Nm", "smallest clearance, mm", "joint jerk, share of its bound")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the scene file that the tests plan."""
    folder = tmp_path_factory.mktemp("cli")
    write_scene(folder / "short.yaml", SHORT)
    return folder


@pytest.fixture(scope="module")
def planned(folder: Path) -> Outcome:
    """What ``cmbot plan`` says; it writes folder/plan."""
    return run("plan", folder / "short.yaml", "--output", folder / "plan")


@pytest.fixture
def directory(folder: Path, planned: Outcome, tmp_path: Path) -> Path:
    """A copy of the plan directory, to be changed by a test."""
    assert planned.status == 0, planned.err
    return shutil.copytree(folder / "plan", tmp_path / "plan")


@pytest.fixture
def known(directory: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> cmbot.Plan:
    """The plan that ``cmbot plan`` finds at once, so that only what is around the planning is tested."""
    known = cmbot.load_plan(directory)
    monkeypatch.setattr(cmbot, "plan", lambda scene, options, progress: known)
    monkeypatch.chdir(tmp_path)
    write_scene(Path("short.yaml"), SHORT)
    return known


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_version() -> None:
    assert run("--version") == Outcome(status=0, out=f"{cmbot.__version__}\n", err="")


def test_help_shows_an_example_and_every_verb() -> None:
    outcome = run("--help")
    assert (outcome.status, outcome.err) == (0, "")
    text = plain(outcome.out)
    assert "Example: cmbot plan triangle" in text
    assert "Exit status: 0 done, 2 bad input, 3 no plan, 130 stopped with Ctrl-C, 1 anything else." in text
    assert all(f" {verb} " in text for verb in ("plan", "simulate", "reproduce", "replay", "check", "doctor"))


def test_it_is_a_module_to_run_as_well() -> None:
    words = [sys.executable, "-m", "cmbot", "--version"]
    done = subprocess.run(words, env=environment(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{cmbot.__version__}\n", "")


def test_without_a_verb_the_help_is_shown() -> None:
    outcome = run()
    assert outcome.err == ""
    assert "Example: cmbot plan triangle" in plain(outcome.out)


@pytest.mark.parametrize(
    ("verb", "example"),
    [
        ("plan", "Examples: cmbot plan triangle -o out/triangle, cmbot plan triangle --set compensate=true"),
        ("replay", "Example: cmbot replay out/triangle --html triangle.html"),
        ("report", "Example: cmbot report out/triangle"),
        ("simulate", "Example: cmbot simulate out/triangle"),
        ("reproduce", "Example: cmbot reproduce -o out/reproduce"),
        ("check", "Examples: cmbot check arm.urdf, cmbot check triangle"),
        ("doctor", "Example: cmbot doctor"),
    ],
)
def test_help_of_a_verb_shows_an_example(verb: str, example: str) -> None:
    outcome = run(verb, "--help")
    assert (outcome.status, outcome.err) == (0, "")
    assert example in plain(outcome.out)


def test_plan_writes_a_directory_with_a_replay_page(folder: Path, planned: Outcome) -> None:
    assert planned.status == 0, planned.err
    assert names(folder) == {"short.yaml", "plan"}
    assert names(folder / "plan") >= SAVED
    assert (folder / "plan" / "replay.html").read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    assert cmbot.load_plan(folder / "plan").scene.name == "short"


def test_plan_prints_plain_lines_where_there_is_no_terminal(folder: Path, planned: Outcome) -> None:
    lines = planned.out.splitlines()
    assert lines[0].split() == ["baseline", "planned"]
    plan = cmbot.load_plan(folder / "plan")
    assert lines[1 : len(plan.summary().splitlines())] == plan.summary().splitlines()[1:]
    assert any(line.startswith("Certified: ") for line in lines)
    assert re.fullmatch(rf"Written to {re.escape(str(folder / 'plan'))} in \d+\.\d s\.", lines[-2])
    assert lines[-1] == f"Look at it: open {folder / 'plan' / 'report.html'} in a browser."
    assert "\x1b" not in planned.out + planned.err
    assert planned.err.splitlines()[0] == "following the tool path"
    assert "optimising" in planned.err
    assert "error" not in planned.err


def test_plan_on_a_terminal_draws_a_table(folder: Path, tmp_path: Path) -> None:
    """A narrow terminal on all three streams."""
    text = on_a_terminal("plan", folder / "short.yaml", "-o", tmp_path / "out", columns=70)
    assert re.search(
        r"│ peak torque on the guardrail, Nm +│ +\d+\.\d\d │ +\d+\.\d\d │", without_colours(text)
    )
    assert "\x1b[" in text
    assert "following the tool path" in text
    # A path on the last line is never broken, so that it can be copied.
    assert f"open {tmp_path / 'out' / 'report.html'} in a browser." in text


@pytest.mark.usefixtures("known")
def test_plan_writes_to_out_by_default(tmp_path: Path) -> None:
    assert run("plan", "short.yaml").status == 0
    assert names(tmp_path / "out") == {"short"}
    assert names(tmp_path / "out" / "short") >= SAVED


@pytest.mark.usefixtures("known")
def test_plan_shows_a_name_as_it_is(tmp_path: Path) -> None:
    name = "a [red]b[/red]  :warning:"
    outcome = run("plan", "short.yaml", "-o", name)
    assert (outcome.status, outcome.err) == (0, "")
    assert f"Written to {name} in " in outcome.out
    assert names(tmp_path / name) >= SAVED


@pytest.mark.usefixtures("known")
def test_force_replaces_a_plan(directory: Path) -> None:
    (directory / "replay.html").write_text("old", encoding="utf-8")
    (directory / "notes.txt").touch()
    assert run("plan", "short.yaml", "-o", directory, "--force").status == 0
    assert "notes.txt" not in names(directory)
    assert (directory / "replay.html").stat().st_size > 100_000


@pytest.mark.parametrize("force", [(), ("--force",)])
def test_plan_refuses_what_is_in_the_way_before_it_plans(
    known: cmbot.Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, force: tuple[str, ...]
) -> None:
    def plan(*_: object, **__: object) -> None:
        pytest.fail("planned first")

    monkeypatch.setattr(cmbot, "plan", plan)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work", encoding="utf-8")
    outcome = run("plan", "short.yaml", "-o", "mine", *force)
    assert (outcome.status, outcome.out) == (2, "")
    assert re.fullmatch(r"error: mine: got a folder .*--force.*\n", outcome.err)
    assert (tmp_path / "mine" / "thesis.txt").read_text(encoding="utf-8") == "years of work"


def test_replay_writes_the_page_anew(directory: Path) -> None:
    page = directory / "replay.html"
    page.unlink()
    outcome = run("replay", directory)
    assert outcome == Outcome(status=0, out=f"Written to {page}.\n", err="")
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")


def test_replay_writes_a_page_elsewhere(directory: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in directory.iterdir()}
    page = tmp_path / "seen.html"
    outcome = run("replay", directory, "--html", page)
    assert outcome == Outcome(status=0, out=f"Written to {page}.\n", err="")
    assert page.stat().st_size > 100_000
    assert {path: path.read_bytes() for path in directory.iterdir()} == before


def test_report_writes_the_page_anew(directory: Path) -> None:
    page = directory / "report.html"
    before = page.read_bytes()
    page.unlink()
    outcome = run("report", directory)
    assert outcome == Outcome(status=0, out=f"Written to {page}.\n", err="")
    assert page.read_bytes().startswith(b"<!DOCTYPE html>")
    assert len(page.read_bytes()) == pytest.approx(len(before), rel=1e-3)


def test_report_replaces_no_file_elsewhere_unasked(directory: Path, tmp_path: Path) -> None:
    page = tmp_path / "mine.html"
    assert run("report", directory, "--html", page) == Outcome(status=0, out=f"Written to {page}.\n", err="")
    page.write_text("mine", encoding="utf-8")
    outcome = run("report", directory, "--html", page)
    expected = f"error: {page}: got a file that is already there, expected a new file, or --force\n"
    assert outcome == Outcome(status=2, out="", err=expected)
    assert page.read_text(encoding="utf-8") == "mine"
    assert run("report", directory, "--html", page, "--force").status == 0
    assert page.stat().st_size > 100_000


@pytest.mark.parametrize("verb", ["plan", "replay", "report"])
def test_the_page_in_a_plan_directory_is_added_by_the_archive(
    known: cmbot.Plan, directory: Path, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    """So that it comes whole, and into nothing but a plan directory."""
    added: list[tuple[Path, str]] = []
    monkeypatch.setattr(
        cmbot.archive, "add_file", lambda folder, name, _: added.append((folder, name)) or folder / name
    )
    words = {
        "plan": ("short.yaml", "-o", directory, "--force"),
        "replay": (directory,),
        "report": (directory,),
    }[verb]
    assert run(verb, *words).status == 0
    names = {"plan": ["replay.html", "report.html"], "replay": ["replay.html"], "report": ["report.html"]}
    assert added == [(directory, name) for name in names[verb]]


def test_replay_serves_the_page_until_ctrl_c(directory: Path) -> None:
    with subprocess.Popen(
        command("replay", directory, "--serve"),
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            found = re.fullmatch(r"Replay of short at (http://127\.0\.0\.1:\d+/); stop with Ctrl-C\.\n", line)
            assert found, line
            with urlopen(found[1], timeout=60) as answer:
                page = answer.read().decode()
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=60)
        finally:
            process.kill()
    assert page == (directory / "replay.html").read_text(encoding="utf-8")
    assert (process.returncode, out, err) == (0, "", "")
