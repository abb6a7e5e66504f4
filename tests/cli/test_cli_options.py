"""Options of long commands: ``--json``, ``--quiet``, ``--figures``; and ``--set`` of ``cmbot plan``."""

import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from command_line import Outcome, output, refusal, run, write_scene
from small_scenes import SHORT

import cmbot
import cmbot.views.plots
from cmbot.common.errors import MissingExtra
from cmbot.common.installation import install_command
from cmbot.planning import Plan, Progress
from cmbot.simulation import Tracking

FIGURES = {"guardrail_torque", "joints", "clearance", "tool_deviation"}
TRACKING_FIGURES = {"tracking_error", "tracking_path"}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with a scene file; the current one."""
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "short.yaml", SHORT)
    return tmp_path


@pytest.fixture
def known(
    short_plan: Plan, short_tracking: Tracking, monkeypatch: pytest.MonkeyPatch
) -> list[cmbot.PlannerOptions]:
    """Planning and simulation take no time; the options that were planned with."""
    asked: list[cmbot.PlannerOptions] = []

    def plan(scene: Any, *, options: cmbot.PlannerOptions, partial: bool, progress: Any) -> Plan:
        progress(Progress(stage="path"))
        asked.append(options)
        return short_plan

    monkeypatch.setattr(cmbot, "plan", plan)
    monkeypatch.setattr(cmbot, "simulate", lambda plan, options, progress: short_tracking)
    return asked


def printed(outcome: Outcome) -> dict[str, Any]:
    assert outcome.status == 0, outcome.err
    data = json.loads(outcome.out)
    assert data["format"] == "cmbot-summary/1"
    return dict(data)


@pytest.mark.parametrize(
    ("change", "name", "value"),
    [
        ("start=pinned", "start", "pinned"),
        ("start='pinned'", "start", "pinned"),
        ("compensate=true", "compensate", True),
        ("path_step_s=0.01", "path_step_s", 0.01),
        ("avoidance_gain=3", "avoidance_gain", 3.0),
        ("max_passes=7", "max_passes", 7),
        ("axis_weights=[1, 0, 0.5]", "axis_weights", (1.0, 0.0, 0.5)),
    ],
)
def test_set_overrides_one_option(
    known: list[cmbot.PlannerOptions], change: str, name: str, value: object
) -> None:
    assert run("plan", "short.yaml", "--set", change).status == 0
    (options,) = known
    assert getattr(options, name) == value
    # The rest is as the scene has it.
    before = cmbot.load_scene("short.yaml").planner
    assert {**vars(options), name: None} == {**vars(before), name: None}
    assert type(getattr(options, name)) is type(getattr(before, name))


def test_set_takes_keys_of_the_scene_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    planned = list[cmbot.Scene]()

    def plan(scene: cmbot.Scene, **_: object) -> None:
        planned.append(scene)
        raise cmbot.InputError("plan", "", "enough", "no more")

    monkeypatch.setattr(cmbot, "plan", plan)
    before = cmbot.load_scene("short.yaml")
    words = ("robot.payload_kg=2", "tool_path.legs[0].seconds=4", "planner.start=pinned", "max_passes=7")
    assert run("plan", "short.yaml", *(part for word in words for part in ("--set", word))).status == 2
    (scene,) = planned
    assert (scene.name, scene.source) == (before.name, before.source)
    assert (scene.robot.payload_kg, scene.strokes[0].legs[0].seconds) == (2, 4)
    assert scene.robot.payload_kg == 2
    assert scene.strokes[0].legs[0].by == before.strokes[0].legs[0].by
    # A block is the scene's, where an option has its name.
    assert run("plan", "short.yaml", "--set", "start={stow: true}").status == 2
    assert planned[1].posture_key == "start.stow"
    # What is wrong in the file itself is named by the file.
    text = (folder / "short.yaml").read_text(encoding="utf-8")
    (folder / "wrong.yaml").write_text(f"{text}\nmore: 1\n", encoding="utf-8")
    assert "error: wrong.yaml:" in refusal("plan", "wrong.yaml", "--set", "robot.payload_kg=2")


def test_set_may_be_repeated_or_left_out(known: list[cmbot.PlannerOptions]) -> None:
    words = ("--set", "knots=sliding", "--set", "start=pinned", "--set", "smoothing_weight=1e-3")
    assert run("plan", "short.yaml", *words).status == 0
    assert run("plan", "short.yaml", "--force").status == 0
    changed, kept = known
    assert (changed.knots, changed.start, changed.smoothing_weight) == ("sliding", "pinned", 1e-3)
    assert kept == cmbot.load_scene("short.yaml").planner


def test_what_was_set_is_planned_and_kept(folder: Path) -> None:
    outcome = run("plan", "short.yaml", "--set", "avoidance=switch", "-o", "switched", "--quiet")
    assert outcome == Outcome(status=0, out="", err="")
    kept = json.loads((folder / "switched" / "plan.json").read_text(encoding="utf-8"))
    assert kept["options"]["avoidance"] == "switch"
    assert cmbot.load_plan(folder / "switched").options.avoidance == "switch"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("start",), "got 'start', expected NAME=VALUE, such as start=pinned"),
        (
            ("strat=free",),
            "strat: got an unknown key, expected a planner option or a key of the scene file; did you mean "
            "start? (one of: knots, ",
        ),
        (("start=fre",), "start: got 'fre', expected a known value; did you mean free? (one of: free, p"),
        (("start=",), "start: got None, expected a known value"),
        (
            ("via_points=3000",),
            "via_points: got an unknown key, expected a planner option or a key of the scene file; did you "
            "mean tool_path.via_points?",
        ),
        (
            ("ramp=0.3",),
            "ramp: got an unknown key, expected a planner option or a key of the scene file; did",
        ),
        (("robot.payload_kg=-1",), "robot.payload_kg: got -1, expected at least 0"),
        (("tool_path.legs[7].seconds=3",), "tool_path.legs[7].seconds: got item 7 of a list of 1, expected"),
        (("tool_path.via=3",), "tool_path.via: got an unknown key, expected a known key"),
        (("name=other",), "name: got no key, expected a key of the scene file"),
        (("start=free", "planner.start=free"), "start: got the same option again"),
        (("compensate=yes",), "compensate: got 'yes', expected auto, true or false"),
        (("max_passes=many",), "max_passes: got 'many', expected a whole number"),
        (("max_passes=0",), "max_passes: got 0, expected at least 1"),
        (("path_step_s=.inf",), "path_step_s: got '.inf', expected a finite number"),
        (("axis_weights=[1, 2]",), "axis_weights: got [1, 2], expected a list of 3 items"),
        (("axis_weights=[1, 2",), "axis_weights: got "),
        (("start=free", "start=free"), "start: got the same option again, expected each option once"),
    ],
)
def test_a_wrong_option_is_named_before_anything_is_planned(
    known: list[cmbot.PlannerOptions], words: tuple[str, ...], message: str
) -> None:
    line = refusal("plan", "short.yaml", *(part for word in words for part in ("--set", word)))
    assert line.startswith(f"error: --set: {message}")
    assert known == []


@pytest.mark.usefixtures("known")
def test_json_of_a_plan_is_that_of_plan_json(folder: Path) -> None:
    outcome = run("plan", "short.yaml", "-o", "out", "--json")
    data = printed(outcome)
    kept = json.loads((folder / "out" / "plan.json").read_text(encoding="utf-8"))
    assert (data["verb"], data["scene"], data["directory"]) == ("plan", "short", "out")
    assert data["files"] == sorted(path.name for path in (folder / "out").iterdir())
    own = {"format", "verb", "verdict", "scene", "directory", "files", "remarks", "baseline_faults"}
    own |= {"table", "notes", "loads"}
    assert {name: value for name, value in data.items() if name not in own} == {
        name: kept[name] for name in data.keys() - own
    }
    assert kept.keys() - data.keys() == {"content", "floor", "passes"}
    assert data["verdict"] == data["remarks"][0]
    # The baseline keeps the limits: gains are stated.
    assert data["baseline_faults"] == {"work": "", "job": ""}
    assert any(remark.startswith("Certified: ") for remark in data["remarks"])
    assert next(row["key"] for row in data["table"] if row["first"]) == "accuracy.within_mm"
    assert {note["level"] for note in data["notes"]} <= {"first", "fault", "warning", "note"}
    assert {load["unit"] for load in data["loads"]} == {"N", "Nm"}
    verbose = run("plan", "short.yaml", "-o", "out", "--force", "--verbose")
    assert {load["name"] for load in data["loads"]} <= {
        line.partition("  ")[0] for line in verbose.out.splitlines()
    }
    assert set(cmbot.planning.remarks(cmbot.load_plan(folder / "out"))) <= set(verbose.out.splitlines())
    assert outcome.err == ""


def test_json_of_a_simulation_is_that_of_tracking_json(short_folder: Path) -> None:
    outcome = run("simulate", short_folder, "--json", "--quiet")
    data = printed(outcome)
    assert outcome.err == ""
    assert (data["verb"], data["scene"], data["directory"]) == ("simulate", "short", str(short_folder))
    kept = json.loads((short_folder / "tracking.json").read_text(encoding="utf-8"))
    assert set(data["files"]) >= {"tracking.csv", "tracking_baseline.csv", "tracking.json"}
    for name in ("cmbot", "options", "seconds", "baseline", "planned"):
        assert data[name] == kept[name]
    assert data["remarks"]


def test_json_of_a_check(urdf_folder: Path) -> None:
    data = printed(run("check", "short.yaml", "--json"))
    assert (data["verb"], data["kind"], data["file"]) == ("check", "scene", "short.yaml")
    assert (data["usable"], data["findings"]) == (True, [])
    assert data["found"]["via-points"] == "8"
    path = urdf_folder / "cmbot.urdf"
    data = printed(run("check", path, "--json"))
    assert (data["kind"], data["usable"], data["findings"]) == ("urdf", True, [])
    assert data["found"]["robot"] == "cmbot"
    path.write_text(path.read_text("utf-8").replace('mass value="', 'mass value="-', 1), encoding="utf-8")
    out = output("check", path, "--json", status=2)
    data = json.loads(out)
    assert (data["usable"], data["found"]) == (False, {})
    assert {"severity", "key", "got", "expected", "remedy"} == set(data["findings"][0])
    assert data["findings"][0]["severity"] == "error"
    quiet = run("check", path, "--quiet")
    assert quiet.status == 2
    assert all(line.startswith(f"error: {path}: ") for line in quiet.out.splitlines())
    assert quiet.out


@pytest.mark.usefixtures("known")
def test_quiet_prints_nothing_and_with_json_an_error_stays_one_line(short_folder: Path) -> None:
    for verb, what in (("plan", "short.yaml"), ("simulate", short_folder), ("check", "short.yaml")):
        assert run(verb, what, "--quiet") == Outcome(status=0, out="", err="")
        assert refusal(verb, "nosuch", "--json", "--quiet").startswith("error: nosuch: ")


@pytest.mark.usefixtures("known")
def test_figures_are_drawn_into_the_plan_directory(folder: Path, short_folder: Path) -> None:
    for words, directory, names in (
        (("plan", "short.yaml"), folder / "out" / "short", FIGURES),
        (("simulate", short_folder), short_folder, TRACKING_FIGURES),
    ):
        outcome = run(*words, "--figures")
        assert outcome.status == 0, outcome.err
        drawn = {f"{name}.{suffix}" for name in names for suffix in ("png", "svg", "pdf")}
        assert {path.name for path in directory.iterdir()} >= drawn
        assert all(name in outcome.out for name in drawn)
        # They are no part of what is read back.
        cmbot.load_plan(directory)
        if words[0] == "plan":
            (line,) = (line for line in outcome.out.splitlines() if line.startswith("Figures: "))
            assert set(line.removeprefix("Figures: ").removesuffix(".").split(", ")) == drawn


def test_without_matplotlib_nothing_is_planned(
    known: list[cmbot.PlannerOptions], short_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    missing = Mock(side_effect=MissingExtra("matplotlib", "plots"))
    monkeypatch.setattr("cmbot.views.require_matplotlib", missing)
    monkeypatch.setattr(cmbot, "simulate", lambda *_, **__: pytest.fail("simulated first"))
    for words in (("plan", "short.yaml"), ("simulate", short_folder)):
        line = refusal(*words, "--figures", status=1)
        assert line == f"error: matplotlib is not installed; run: {install_command('plots')}"
    assert known == []


def test_the_simulation_tells_how_far_it_is(short_plan: Plan) -> None:
    shares: list[float] = []
    cmbot.simulate(short_plan, progress=shares.append)
    assert shares == sorted(shares)
    assert 0 < shares[0] < 0.1
    assert shares[-1] == pytest.approx(1.0)
    assert len(shares) > 20
