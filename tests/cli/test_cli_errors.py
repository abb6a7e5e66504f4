"""Whatever goes wrong on the command line ends in one line on standard error and an exit status."""

import copy
import json
import re
import signal
import tomllib
from collections import Counter
from importlib import metadata, util
from pathlib import Path
from types import ModuleType
from typing import Any
from unittest.mock import Mock

import pytest
from command_line import ROOT, Outcome, one_line, output, refusal, run, run_apart, write_scene
from small_scenes import SHORT

import cmbot
import cmbot.cli.inspection
from cmbot.cli import COMMANDS, commands
from cmbot.common import errors
from cmbot.common.installation import install_command, model_folder

MODELS = model_folder() / "urdf"
FRAMES = {
    "model": str(MODELS / "cmbot.urdf"),
    "base_frame": "arm_base",
    "tool_frame": "tool0",
    "limits": str(MODELS / "joint_limits.yaml"),
    "mount": {"xyz": [0, 0.5, 0], "rpy_deg": [180, 0, 0]},
}
FILES = {
    "short.yaml": json.dumps(SHORT),
    "broken.yaml": "format: [cmbot-scene/2\nname: x",
    "campaign.yaml": "format: cmbot-campaign/1\nscene: triangle\njobs:\n- name: a\n",
    "empty.yaml": "",
    "list.yaml": "[1, 2]",
    "twice.yaml": "format: cmbot-scene/2\nformat: cmbot-scene/2\n",
    "slip.yaml": json.dumps({**SHORT, "tool_path": {**SHORT["tool_path"], "via_point": 8}}),
    "type.yaml": json.dumps({**SHORT, "tool_path": {**SHORT["tool_path"], "via_points": "many"}}),
    "option.yaml": json.dumps({**SHORT, "planner": {"knots": "slidin"}}),
    "model.yaml": json.dumps({**SHORT, "robot": {"model": "cmbto"}}),
    "frame.yaml": json.dumps({**SHORT, "robot": {**FRAMES, "base_frame": "arm_bas"}}),
    "robot.yaml": json.dumps({**SHORT, "robot": {"model": "zzz/zzz"}}),
    "other.yaml": json.dumps({**SHORT, "robot": FRAMES}),
    "joints.yaml": json.dumps({**SHORT, "start": {"posture_deg": [0, 0]}}),
    "binary.yaml": b"\xff\xfe\x00",
    "broken.urdf": "<robot",
    "none.urdf": '<robot name="none"></robot>',
    "other.xml": "<mujoco/>",
    "folder/plan.json": '{"format": "cmbot-plan/1"}',
    "other_version/plan.json": '{"format": "cmbot-plan/999"}',
    "no_plan/notes.txt": "",
}
_A_CAMPAIGN = "expected cmbot-scene/2; cmbot campaign campaign.yaml plans it"
# The words after cmbot, and what the error has to name.
BAD_INPUT: list[tuple[str, tuple[str, ...]]] = [
    (
        "plan nosuch",
        (
            "nosuch: no such file, expected a scene",
            "shipped scene (one of: angle_steel, bracket_faces, clamped_triangle, gusset_plate, line, ",
        ),
    ),
    ("plan triangel", ("triangel: no such file", "shipped scene; did you mean triangle? (one of: angle")),
    ("check triangel", ("triangel: no such file", "shipped scene; did you mean triangle?")),
    (
        "check pnada",
        ("pnada: no such file, expected a URDF, a scene file, or the name of a robot", "did you mean panda?"),
    ),
    ("check robot.yaml", ("robot.yaml:1: robot.model: got 'zzz/zzz'", ", cmbot, or the name of a robot")),
    ("new --from panda --tool-at .5 0 -o x.yaml", ("--tool-at: expected 3 arguments. See: cmbot new",)),
    ("new --from panda --tool-at .5 0", ("--tool-at: expected 3 arguments. See: cmbot new --help",)),
    ("plan model.yaml", ("model.yaml:1: robot.model: got 'cmbto'", "; did you mean cmbot?")),
    (
        "check frame.yaml",
        ("frame.yaml:1: robot.base_frame: got 'arm_bas'", "did you mean arm_base? (one of: "),
    ),
    ("plan short.yaml -o empty.yaml/plan", ("empty.yaml/plan: got a place below ", "which is a file")),
    ("reproduce -o empty.yaml", ("empty.yaml/triangle: got a place below ", "which is a file")),
    (
        "plan short.yaml --set seconds=3",
        ("--set: seconds: got an unknown key", "did you mean tool_path.legs[0].seconds?"),
    ),
    (
        "check nosuch.yaml",
        (
            "nosuch.yaml: no such file",
            "one of: angle_steel, bracket_faces, clamped_triangle, gusset_plate, line, mast_inspection",
        ),
    ),
    ("plan no_plan", ("no_plan: got a folder, expected a scene file or the name of a shipped scene (one",)),
    ("plan broken.yaml", ("broken.yaml:2: got ':' where ',' or ']' should be, ", "expected valid YAML")),
    ("plan campaign.yaml", ("campaign.yaml:1: format: got a campaign (cmbot-campaign/1)", _A_CAMPAIGN)),
    ("check campaign.yaml", ("campaign.yaml:1: format: got a campaign", _A_CAMPAIGN)),
    ("plan empty.yaml", ("empty.yaml: got an empty file", "a mapping")),
    ("plan list.yaml", ("list.yaml: got ", "a mapping")),
    ("plan twice.yaml", ("twice.yaml:2: format: got the same key again,",)),
    ("plan binary.yaml", ("binary.yaml: got ", "UTF-8")),
    ("plan slip.yaml", ("slip.yaml:1: tool_path.via_point: got an unknown key", "did you mean via_points?")),
    ("plan type.yaml", ("type.yaml:1: tool_path.via_points: got 'many', expected a whole number",)),
    ("plan option.yaml", ("option.yaml:1: planner.knots: got 'slidin'", "did you mean sliding?")),
    ("check joints.yaml", ("joints.yaml:1: start.posture_deg: got ", "7")),
    ("check nosuch.urdf", ("nosuch.urdf: no such file",)),
    ("check broken.urdf", ("broken.urdf: ",)),
    ("check other.xml", ("other.xml: ",)),
    ("replay nosuch", ("nosuch: no such folder", "cmbot plan")),
    ("replay no_plan", ("no_plan",)),
    (f"report nosuch --html {'a' * 300}", ("nosuch: no such folder",)),
    ("replay folder", ("folder",)),
    ("replay other_version", ("other_version", "cmbot-plan/999")),
    ("replay folder --serve --html page.html", ("--html, --serve: got both",)),
    ("--nonsense", ("no such option: --nonsense. See: cmbot --help",)),
    ("plan short.yaml --forse", ("no such option: --forse; did you mean --force? See: cmbot plan --help",)),
    ("plan short.yaml -o", ("--output/-o: expected one argument",)),
    ("plan", ("arguments are required: SCENE. See: cmbot plan --help",)),
    ("plan short.yaml line", ("unexpected argument: ",)),
    ("paln short.yaml", ("no such command: paln; did you mean plan? See: cmbot --help",)),
    ("doctor now", ("unexpected argument: ",)),
    ("doctor --html", ("no such option: --html; did you mean --help? See: cmbot doctor --help",)),
    ("doctor -o x", ("no such option: -o. See: cmbot doctor --help",)),
    ("schema now", ("unexpected argument: ",)),
    ("schema --json", ("no such option: --json. See: cmbot schema --help",)),
    ("schema -o x", ("no such option: -o. See: cmbot schema --help",)),
    ("scenes now", ("unexpected argument: ",)),
    ("scenes --html empty.yaml", ("empty.yaml: got a file that is already there", "a new file, or --force")),
    ("scenes --html empty.yaml/x.html", ("empty.yaml/x.html: got ", "expected ")),
    ("check panda --write-srdf empty.yaml", ("--write-srdf: got empty.yaml", "path of a new file")),
    ("check short.yaml --write-srdf x.srdf", ("--write-srdf: got a scene", "a URDF to check")),
    ("new", ("--from: got nothing", "--from URDF and --tool-at X Y Z")),
    ("new --from nosuch --tool-at .5 0 .4", ("nosuch: no such file", "a URDF file, or the name of a robot")),
    ("new --from panda --tool-at .5 0 .4 -o empty.yaml", ("empty.yaml: got a file that", "or --force")),
    ("new --from panda --tool hand --tool-at .5 0 .4", ("--tool: got 'hand'", "(one of: panda_link0, ")),
    ("stand nosuch", ("nosuch: no such file, expected a scene file",)),
    ("stand other.yaml", ("other.yaml: mounts: got none, expected ",)),
    ("stand short.yaml --on moon", ("members (--on): got 'moon', expected a member", "(one of: top_rail,")),
    ("stand short.yaml --max-sag-mm -5", ("--max-sag-mm: got -5, expected a number of at least 0. See: ",)),
    ("stand short.yaml -o empty.yaml", ("empty.yaml: got a file of that name, expected ",)),
    ("stand short.yaml --objective time", ("--objective: got time", "(one of: torque, hold, sag, sway)")),
    ("walk short.yaml", ("arguments are required: --to. See: cmbot walk --help",)),
    ("walk short.yaml --to nosuch.yaml", ("nosuch.yaml: no such file, expected a scene file",)),
    ("walk other.yaml --to short.yaml", ("other.yaml: robot: got another robot",)),
    ("walk short.yaml --to short.yaml", ("stance: got the stance where", "robot stands there already")),
    ("tour", ("arguments are required: SCENE. See: cmbot tour --help",)),
    ("tour other.yaml", ("other.yaml: robot: got another robot, expected the shipped robot",)),
    ("tour short.yaml --on moon", ("members (--on): got 'moon', expected a member",)),
    ("tour short.yaml -o no_plan", ("no_plan: got ", "expected ")),
    ("campaign nosuch.yaml", ("nosuch.yaml: no such file, expected a campaign file, a CSV table",)),
    ("campaign short.yaml", ("short.yaml:1: format: got a scene (", "; cmbot plan short.yaml plans it")),
    ("campaign list.yaml", ("list.yaml: got [1, 2]", "a mapping")),
    ("campaign no_plan", ("no_plan: got a campaign without jobs, expected at least one job",)),
    (
        "campaign short.yaml --workers 0",
        ("--workers: got 0, expected a whole number of at least 1. See: cmbot campaign",),
    ),
    ("compare nosuch other", ("nosuch: no such folder, expected a plan directory",)),
    ("compare nosuch", ("nosuch", "expected ")),
    # Inputs are looked at before places that are taken.
    ("compare nosuch other --html empty.yaml", ("nosuch: no such folder, expected a plan directory",)),
    ("compare folder folder", ("got one directory more than once, expected different plan directories",)),
    ("verify nosuch", ("nosuch: no such folder",)),
    ("verify other_version", ("other_version", "cmbot-plan/999")),
    ("verify folder --engine bullet", ("--engine: got bullet", "one of: mujoco")),
    ("report nosuch --html empty.yaml", ("nosuch: no such folder",)),
    ("export nosuch --mcap empty.yaml", ("nosuch: no such folder",)),
    ("new --from nosuch --tool-at .5 0 .4 -o empty.yaml", ("nosuch: no such file",)),
    ("check nosuch.urdf --write-srdf empty.yaml", ("nosuch.urdf: no such file",)),
    ("identify triangle --propose 2 --axes q -o empty.yaml", ("--axes: got 'q', expected letters of xyz",)),
    ("simulate folder --rate 125", ("--servo: got nothing, expected a number beside --rate: without",)),
    ("compare no_plan folder", ("no_plan/plan.json: no such file, expected a plan directory",)),
    ("report .", ("./plan.json: no such file, expected a plan directory",)),
    ("report empty.yaml", ("empty.yaml: got a file, not a folder, expected a plan directory",)),
    ("export nosuch --mcap x.mcap", ("nosuch: no such folder, expected a plan directory",)),
    ("export no_plan --mcap x.mcap", ("no_plan/plan.json: no such file, expected a plan directory",)),
    ("export no_plan", ("got nothing to write, expected --csv, --ros, --mcap or --ros-package",)),
    ("simulate nosuch", ("nosuch: no such folder, expected a plan directory",)),
    ("simulate no_plan", ("no_plan/plan.json: no such file, expected a plan directory",)),
    ("simulate no_plan --servo -1", ("--servo: got -1.0, expected at least 0.1",)),
    ("identify nosuch", ("nosuch: no such file, expected a file of measurements, or a scene",)),
    ("identify triangle", ("triangle: got a scene, expected a file of measurements: cmbot identify",)),
    ("identify short.yaml --propose 0", ("--propose: got 0, expected a whole number of at least 1 and",)),
    ("excite nosuch", ("nosuch: no such folder, expected a plan directory",)),
    ("excite short.yaml", ("short.yaml: got a file, not a folder, expected a plan",)),
    ("excite nosuch --damper 3", ("no such option: --damper",)),
    ("locate nosuch", ("nosuch: no such file, expected a file of touches",)),
    ("locate short.yaml --propose 0", ("--propose: got 0, expected a whole number of at least 1 and",)),
    ("locate x.csv --propose 2", ("x.csv: --propose: got a CSV file, expected a scene",)),
    ("evaluate nosuch --motion m.csv", ("nosuch: no such file, expected a scene",)),
    ("evaluate triangle", ("the following arguments are required: --motion",)),
    ("evaluate triangle --motion nosuch.csv", ("nosuch.csv: no such file, expected a table with t and",)),
    ("reproduce now", ("unexpected argument: ",)),
    ("reproduce --runs 3", ("no such option: --runs",)),
]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder with files that something is wrong with; the current one."""
    for name, content in FILES.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(("words", "parts"), BAD_INPUT, ids=[words for words, _ in BAD_INPUT])
def test_bad_input(words: str, parts: tuple[str, ...], folder: Path) -> None:
    before = sorted(folder.rglob("*"))
    line = refusal(*words.split())
    for part in parts:
        assert part in line
    assert " expected " in line or " See: cmbot " in line
    assert sorted(folder.rglob("*")) == before


def test_three_wrong_inputs_of_every_command() -> None:
    """Each is refused in one line with what was expected, or the help that says it."""
    tried = Counter(words.split()[0] for words, _ in BAD_INPUT)
    assert {name: tried[name] for name in COMMANDS if tried[name] < 3} == {}


def test_check_of_a_urdf_without_links() -> None:
    assert output("check", "none.urdf", status=2).startswith("error: none.urdf: ")


NAMES = ("[red]bold[/red].yaml", "[/].yaml", "a:warning:b.yaml", "two  blanks.yaml", "back\\slash\\[x].yaml")


@pytest.mark.parametrize("name", [*NAMES, "ünïcode-狗.yaml", "long" * 100])
@pytest.mark.parametrize("verb", ["check", "replay"])
def test_names_are_shown_as_they_are(name: str, verb: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands.err, "width", 40)  # a narrow window breaks no line
    line = refusal(verb, name)
    # A name that is too long for the system is shortened.
    shown = f"error: {name}: no such f" if len(name) < 300 else "long" * 10
    assert shown in line


@pytest.mark.parametrize("name", ["line\nbreak", "\x1b[31mred", "bell\a", "\udcff", "\u2028"])
@pytest.mark.parametrize("verb", ["check", "replay"])
def test_names_cannot_drive_the_terminal(name: str, verb: str) -> None:
    assert refusal(verb, name).isprintable()


@pytest.mark.parametrize("place", [0, 1, 2])
def test_debug_shows_the_traceback_wherever_it_stands(place: int) -> None:
    words = ["plan", "nosuch"]
    words.insert(place, "--debug")
    outcome = run(*words)
    assert (outcome.status, outcome.out) == (2, "")
    assert outcome.err.startswith("Traceback (most recent call last):\n")
    assert outcome.err.splitlines()[-1].startswith("cmbot.common.errors.SceneError: nosuch: no such file")


def test_a_hopeless_scene_says_how_far_it_came(folder: Path) -> None:
    far: dict[str, Any] = {
        **SHORT,
        "name": "far",
        "tool_path": {"legs": [{"by": [0, -0.3, 3], "seconds": 4}], "via_points": 8},
        "planner": {"knots": "fixed", "path_step_s": 0.05, "other_starts": 0},
    }
    outcome = run("plan", write_scene(folder / "far.yaml", far))
    assert (outcome.status, outcome.out) == (3, "")
    (error,) = outcome.err.splitlines()
    assert re.fullmatch(
        r"error: \S*far\.yaml: line 1: no path beyond t = \d\.\d\d s \(\d+% of the tool path\): \w.*",
        error,
    )
    assert "singular" not in error  # it is not the reason
    assert not (folder / "out").exists()


FAILURES = [
    (errors.InputError("f", "k", 1, "2"), 2),
    (errors.SceneError("f", "k", 1, "2"), 2),
    (errors.ModelError("f", "k", 1, "2"), 2),
    (errors.ArchiveError("f", "k", 1, "2"), 2),
    (errors.PathNotFound("stuck", time=1, progress=0.5, smallest_singular_value=0.1), 3),
    (errors.OptimisationFailed("stuck", constraint="jerk", violation=0.1), 3),
    (errors.LimitViolation("jerk", time=1, value=2, bound=1, unit="rad/s3"), 3),
    (errors.SimulationDiverged(time=1, state=[2.0]), 1),
    (errors.MissingExtra("mujoco", "test"), 1),
    (errors.CmbotError("else"), 1),
]


@pytest.mark.parametrize(("error", "status"), FAILURES, ids=lambda value: type(value).__name__)
def test_exit_status_of_every_error(
    error: errors.CmbotError, status: int, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    monkeypatch.setattr(cmbot, "plan", Mock(side_effect=error))
    assert refusal("plan", "short.yaml", status=status) == f"error: {error}"
    assert not (folder / "out").exists()
    own = (value for value in vars(errors).values() if isinstance(value, type))
    kinds = {kind for kind in own if issubclass(kind, errors.CmbotError)} - {errors.PlanningError}
    assert {type(error) for error, _ in FAILURES} == kinds


def test_ctrl_c_ends_planning(monkeypatch: pytest.MonkeyPatch, folder: Path) -> None:
    monkeypatch.setattr(
        cmbot, "plan", lambda scene, options, partial, progress: signal.raise_signal(signal.SIGINT)
    )
    assert run("plan", "short.yaml") == Outcome(status=130, out="", err="")
    assert not (folder / "out").exists()


BUG = """
import cmbot
def load_scene(scene):
    raise RuntimeError("not [red]expected[/red]\\nat all")
cmbot.load_scene = load_scene
"""


def test_what_should_not_happen_is_one_line_as_well_and_debug_shows_where() -> None:
    expected = "error: RuntimeError: not [red]expected[/red] at all (a bug in cmbot: --debug shows where)"
    outcome = run_apart("plan", "x", before=BUG)
    assert (outcome.status, one_line(outcome)) == (1, expected)
    outcome = run_apart("plan", "x", "--debug", before=BUG)
    assert (outcome.status, outcome.out) == (1, "")
    assert outcome.err.startswith("Traceback (most recent call last):\n")
    assert "in load_scene" in outcome.err
    assert "RuntimeError: not [red]expected[/red]\nat all" in outcome.err


def test_doctor_finds_every_dependency() -> None:
    lines = output("doctor").splitlines()
    assert all(line.startswith("ok ") for line in lines)
    found = {line.split()[1]: line for line in lines}
    assert f"{cmbot.__version__} from {ROOT / 'cmbot'}" in found["cmbot"]
    assert metadata.version("numpy") in found["numpy"]
    assert str(ROOT / "models" / "meshes") in found["meshes"]
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = {re.match(r"[\w.\-]+", requirement)[0] for requirement in declared["dependencies"]}  # type: ignore[index]
    assert names <= {symptom.name for symptom in cmbot.cli.inspection.examine()}


def missing() -> list[str]:
    return [line for line in output("doctor", status=1).splitlines() if line.startswith("MISSING")]


@pytest.mark.parametrize(
    ("owner", "function", "package", "answer"),
    [
        (metadata, "version", "scipy", metadata.PackageNotFoundError("scipy")),
        (metadata, "version", "pin", metadata.PackageNotFoundError("pin")),
        (metadata, "version", "ruamel.yaml", metadata.PackageNotFoundError("ruamel.yaml")),
        (util, "find_spec", "ruamel.yaml", None),
        (util, "find_spec", "ruamel.yaml", ModuleNotFoundError("No module named 'ruamel'")),
    ],
)
def test_doctor_reports_a_package_that_is_missing_or_has_no_module(
    owner: ModuleType, function: str, package: str, answer: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    others, fails = getattr(owner, function), Mock(side_effect=[answer])
    monkeypatch.setattr(owner, function, lambda name: fails() if name == package else others(name))
    (line,) = missing()
    assert line.split()[1] == package
    assert owner is util or line.split()[2:] == ["not", "installed", "(run:", "pip", "install", f"{package})"]


def test_doctor_reports_missing_data(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(cmbot.cli.inspection, "model_folder", lambda: tmp_path)
    lines = missing()
    assert [line.split()[1] for line in lines] == ["model", "meshes"]
    assert f"missing: {tmp_path / 'meshes'}" in lines[1]


def test_doctor_is_content_without_what_is_optional(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(cmbot.cli.inspection, "_OPTIONAL_PACKAGES", (("not-a-package-of-anyone", "test"),))
    outcome = run("doctor")
    assert outcome.status == 0
    assert f"not installed (optional: {install_command('test')})" in outcome.out
    assert "not found (optional, for cmbot replay --video: apt-get install ffmpeg)" in outcome.out


def test_legs_too_fast_for_the_joints_name_bound_joint_and_remedy(folder: Path) -> None:
    hasty = copy.deepcopy(SHORT)
    hasty["tool_path"]["legs"][0]["seconds"] = 0.9
    hasty["planner"] |= {"start": "pinned"}
    write_scene(folder / "hasty.yaml", hasty)
    line = refusal("plan", "hasty.yaml", "--quiet", status=3)
    assert line.startswith("error: hasty.yaml: ")
    worst = r"(velocity|acceleration|jerk) of joint_\d at t = (\d\.\d+) s, (\d+\.\d\d%|far) beyond its bound"
    assert (found := re.search(worst, line))
    assert 0.0 <= float(found[2]) <= 0.9
    assert "may" not in line
    # So slow a leg was planned.
    assert re.search(
        r"; seconds: auto on .*, with .*shortest, ramp: 0\.\d+}, would do, and takes \d\.\d+ s$", line
    )


def test_the_doctor_names_the_extra_of_what_is_optional() -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = set(declared["optional-dependencies"]) - {"bench", "docs"}
    found = {symptom.name: symptom.found for symptom in cmbot.cli.inspection.examine()}
    named = dict(cmbot.cli.inspection._OPTIONAL_PACKAGES)
    assert set(named.values()) == extras
    for package, extra in named.items():
        assert f"of the extra {extra}" in found[package] or install_command(extra) in found[package]


@pytest.mark.parametrize("constraint", ["velocity of joint_3", "joint torque", "clearance", "something else"])
def test_a_failed_optimisation_says_what_is_broken_and_advises_nothing(constraint: str) -> None:
    far = str(errors.OptimisationFailed("no way", constraint=constraint, violation=99.0))
    assert far == f"no way; worst constraint: {constraint}, far beyond its bound"
    text = str(errors.OptimisationFailed("no way", constraint=constraint, violation=0.25))
    assert text == f"no way; worst constraint: {constraint}, 25.00% beyond its bound"


def test_a_failed_optimisation_that_breaks_no_constraint() -> None:
    error = errors.OptimisationFailed("no way", constraint="jerk of joint_3", violation=-0.15)
    assert str(error) == "no way; every constraint is met, jerk of joint_3 with the least room"
