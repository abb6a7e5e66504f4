"""What the documents say is so: links lead somewhere, code runs, commands exist, figures are printed ones."""

import importlib
import re
import subprocess
from collections.abc import Iterable, Iterator
from pathlib import Path

import document_figures
import gallery
import numpy as np
import pytest
from command_line import run
from ruamel.yaml import YAML
from shared_plans import planned
from small_scenes import SHORT

import cmbot
from cmbot import __version__
from cmbot.archive import columns
from cmbot.campaigns import CampaignFile
from cmbot.cli import COMMANDS
from cmbot.cli.command import flags_of
from cmbot.planning import Plan, first_remarks
from cmbot.robot import Kinematics
from cmbot.robot.description import packages, xacro
from cmbot.scene import Scene, shipped_scenes

ROOT = Path(__file__).resolve().parent.parent.parent
IGNORED = {".git", ".venv", "out", "dist", "build", "__pycache__"}
README, DOCS = ROOT / "README.md", ROOT / "docs"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
# Options of the command itself.
WHOLE = {"--help", "--install-completion", "--show-completion", "--help-all"}
# Written in parts, so that this file passes its own test.
REGISTRIES = ("pypi" + ".org", "python" + "hosted.org", "registry" + ".npmjs", "conda" + ".anaconda.org")
WORKPLACES = ("/wo" + "rk/", "/tm" + "p/", "/ho" + "me/", "/ro" + "ot/")


def tracked_files() -> list[Path]:
    """Files under version control, with those that are about to be; all files where there is no git."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        found = (path for path in ROOT.rglob("*") if not IGNORED & set(path.relative_to(ROOT).parts))
    else:
        found = (ROOT / name for name in listed.splitlines())
    return sorted(path for path in found if path.is_file())


DOCUMENTS = [path for path in tracked_files() if path.suffix == ".md"]


def prose(path: Path) -> str:
    """A document without its blocks of code."""
    return FENCE.sub("", path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_documents_are_there_their_links_lead_somewhere_and_the_readme_is_short() -> None:
    names = {name_of(path) for path in DOCUMENTS}
    pages = ("conventions", "assumptions", "errata", "method", "architecture", "results", "performance")
    assert names >= {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", *(f"docs/{page}.md" for page in pages)}
    assert len(README.read_text("utf-8").splitlines()) <= 110
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)\s]+)\)", prose(document)):
            if not re.match(r"[a-z]+:", target):
                assert (document.parent / target.split("#")[0]).exists(), f"{target} in {name_of(document)}"


# Words of all pages, of the method alone, and of a sentence; entries of the glossary; characters of a line.
MOST_WORDS, MOST_OF_METHOD, MOST_IN_A_SENTENCE, MOST_TERMS, LONGEST_LINE = 32_000, 7_000, 40, 40, 200


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page's own prose: without code, formulas, tables, headings and generated blocks."""
    text = FENCE.sub("", text)
    text = re.sub(r"<!-- ([^>]*) -->\n.*?<!-- end of \1 -->", "", text, flags=re.DOTALL)
    text = re.sub(r"^\$\$\n.*?^\$\$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"\]\([^)]*\)", "]", re.sub(r"\$?`[^`]*`\$?", "X", text))
    lines = (line for line in text.splitlines() if not line.startswith(("|", "#", ":::", "    ", "!")))
    for paragraph in re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.) ", "\n".join(lines)):
        yield from re.split(r"(?<=[.!?])[)*]*\s+(?=[A-Z`*(\[0-9]|cmbot)", " ".join(paragraph.split()))


def test_pages_their_sentences_and_their_lines_are_short() -> None:
    pages = {path: path.read_text("utf-8") for path in (*sorted(DOCS.glob("*.md")), README)}
    words = {path.name: len(text.split()) for path, text in pages.items() if path != README}
    assert sum(words.values()) <= MOST_WORDS, words
    assert words["method.md"] <= MOST_OF_METHOD
    assert len(re.findall(r"\*\*[^*]+\*\*", pages[DOCS / "glossary.md"])) <= MOST_TERMS
    counted = [(path.name, each) for path, text in pages.items() for each in sentences(text)]
    assert len(counted) > 500
    assert [each for each in counted if len(each[1].split()) > MOST_IN_A_SENTENCE] == []
    for path, text in pages.items():
        lines = [line for line in text.splitlines() if len(line) > LONGEST_LINE]
        assert all(line.startswith("|") for line in lines), (path.name, lines)


def test_readme_and_the_sites_first_page_lead_to_every_page() -> None:
    others = {path.name for path in DOCS.glob("*.md")} - {"index.md"}
    for document, folder in ((README, "docs/"), (DOCS / "index.md", "")):
        linked = {target.split("#")[0] for target in re.findall(r"\]\(([^)\s]+)\)", prose(document))}
        assert {folder + name for name in others} <= linked, name_of(document)


def test_readme_python_runs(
    triangle_plan: Plan,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """With the plan that there is already of its scene."""
    monkeypatch.setattr(cmbot, "plan", lambda scene: {"triangle": triangle_plan}[scene.name])
    (code,) = (code for language, code in FENCE.findall(README.read_text("utf-8")) if language == "python")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(README), "exec"), {})
    assert "peak torque at work" in capsys.readouterr().out
    assert (tmp_path / "triangle" / "plan.json").is_file()


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Verbs and options of every ``cmbot …`` in backticks, in a table or in a block of code."""
    blocks = "\n".join(code for language, code in FENCE.findall(text) if language in ("", "sh", "text"))
    # Indented ones, too.
    blocks += "\n" + "\n".join(re.findall(r"^    .+$", FENCE.sub("", text), flags=re.MULTILINE))
    lines = re.findall(r"`cmbot ([^`\n]+)`", FENCE.sub("", text))
    lines += re.findall(r"^\s*(?:\$ )?cmbot (.+)$", blocks, flags=re.MULTILINE)
    for line in lines:
        words = line.split("#")[0].split()
        yield words[0], [word.split("=")[0] for word in words if word.startswith("-")]


def test_named_commands_exist() -> None:
    named = set()
    for document in DOCUMENTS:
        for verb, options in commands(document.read_text(encoding="utf-8")):
            assert verb in {*COMMANDS, *WHOLE}, f"cmbot {verb} in {name_of(document)}"
            known = set(flags_of(COMMANDS[verb]) if verb in COMMANDS else ())
            assert set(options) <= known | WHOLE, f"cmbot {verb} in {name_of(document)}"
            named.add(verb)
    assert named - WHOLE == set(COMMANDS), "a command that no document names"


def test_options_that_the_table_of_commands_names_are_those_of_its_command() -> None:
    page = (DOCS / "command_line.md").read_text("utf-8")
    rows = re.findall(r"^\| `cmbot (\w+)[^`]*` \| (.*) \|$", page, flags=re.MULTILINE)
    assert {verb for verb, _ in rows} == set(COMMANDS)
    named = [(verb, flag) for verb, text in rows for flag in re.findall(r"(?<![\w-])--[a-z][a-z-]*", text)]
    assert len(named) > 15
    assert [f"{verb} {flag}" for verb, flag in named if flag not in flags_of(COMMANDS[verb])] == []
    every = {flag for kind in COMMANDS.values() for flag in flags_of(kind)} | WHOLE | {"--debug", "--version"}
    assert set(re.findall(r"`(--[a-z][a-z-]*)", page)) <= every


def test_pages_list_all_shipped_scenes_keys_of_campaigns_and_verbs_with_json() -> None:
    page = (DOCS / "command_line.md").read_text("utf-8")
    (listed,) = re.findall(r"a shipped scene \((.*?)\)", page)
    assert sorted(re.findall(r"`(\w+)`", listed)) == sorted(shipped_scenes())
    campaigns = (DOCS / "campaigns.md").read_text("utf-8")
    table = campaigns.split("| key | what | if left out |")[1].split("\n\n")[0]
    assert re.findall(r"^\| `(\w+)` \|", table, flags=re.MULTILINE) == list(CampaignFile.model_fields)
    for key in ("time_limit_s", "memory_limit_mb"):
        (row,) = re.findall(rf"^\| `{key}` .*", table, flags=re.MULTILINE)
        assert row.endswith(f"| {CampaignFile.model_fields[key].default:g} |")
    assert "With `--json`, every command but `schema` prints one JSON object" in page
    assert {verb for verb, kind in COMMANDS.items() if "--json" not in flags_of(kind)} == {"schema"}


def test_named_targets_paths_columns_and_code_exist() -> None:
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    text = "".join(path.read_text("utf-8") for path in DOCUMENTS)
    named = set(re.findall(r"(?:`|^    )make ([a-z]+)", text, flags=re.MULTILINE))
    assert {"demo", "test", "lint"} <= named <= set(targets)
    pattern = re.compile(r"`((?:cmbot|tools|tests|scenes|models|examples|docs|benchmarks)/[\w./]*)`")
    for document in DOCUMENTS:
        for path in (path for path in pattern.findall(prose(document)) if "NAME" not in path):
            assert (ROOT / path).exists(), f"{path} in {name_of(document)}"
    # Of the columns the first of each kind, such as q1 and tool_x.
    words = set(re.findall(r"`(\w+)`", prose(DOCS / "command_line.md")))
    assert {name for name in columns(7) if not re.search(r"[2-9]$|_[yz]$", name)} <= words
    # Every dotted name, such as those beside the equations, is one of the package.
    dotted = re.compile(r"`(cmbot(?:\.\w+)+)(?:\(.*?\))?`")
    named = {name for path in DOCUMENTS for name in dotted.findall(prose(path))}
    assert len(named) > 20
    called = {name for path in DOCUMENTS for name in re.findall(r"`(cmbot(?:\.\w+)+)\(", prose(path))}
    for name in sorted(named):
        module, *attributes = split(name)
        thing: object = importlib.import_module(module)
        for attribute in attributes:
            fields = getattr(thing, "__dataclass_fields__", {})
            assert hasattr(thing, attribute) or attribute in fields, name
            thing = getattr(thing, attribute, None)
        assert callable(thing) or name not in called, f"{name}, which is no function"
    # What the reference lists is a function or a class, but for the room of errors.
    listed = set(re.findall(r"^::: (\S+)$", (DOCS / "api.md").read_text("utf-8"), flags=re.MULTILINE))
    assert all(split(name)[1:] for name in listed - {"cmbot.common.errors"})


def split(name: str) -> list[str]:
    """The module of a dotted name, then its attributes."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:count])
        if path.is_dir() or path.with_suffix(".py").is_file():
            return [".".join(parts[:count]), *parts[count:]]
    raise AssertionError(name)


def test_no_registry_and_no_workplace_is_named() -> None:
    for path in tracked_files():
        try:
            text = path.read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        for address in REGISTRIES:
            assert address not in text, f"{address} in {name_of(path)}"
        for place in WORKPLACES:
            assert not re.search(rf"(?<![\w.\-/}}]){re.escape(place)}\w", text), f"{place} in {name_of(path)}"


@pytest.fixture(scope="module")
def plans(triangle_plan: Plan, line_plan: Plan) -> list[Plan]:
    return [triangle_plan, line_plan]


# Not determined by the problem: what only has to stay below a bound.
UNDETERMINED = ("tool deviation", "tool rotation", "tool swings")
# The optimum is the same on every processor to this share; the way of an approach to a little more.
SAME, SAME_APPROACH = 1e-3, 1e-2


def block(path: Path, marker: str) -> str:
    """What stands between the markers of a generated block."""
    found = path.read_text("utf-8").split(f"<!-- {marker} -->\n")[1]
    return found.split(f"\n<!-- end of {marker} -->")[0]


def cells(path: Path, marker: str) -> list[list[str]]:
    """The rows of a generated table, without its header."""
    lines = block(path, marker).splitlines()[2:]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def assert_figures(quoted: Iterable[list[str]], made: Iterable[tuple[str, ...]]) -> None:
    """Each row is a name, then baseline and planned in turn: the one exactly, the other where determined."""
    for left, right in zip(quoted, made, strict=True):
        assert left[0] == right[0]
        if any(word in left[0] for word in UNDETERMINED):
            continue
        for column, (old, new) in enumerate(zip(left[1:], right[1:], strict=True)):
            if column % 2 == 0 or "-" in (old, new):
                assert old == new, left[0]
                continue
            # A figure may have a word behind it.
            (old, *words), (new, *others) = old.split(), new.split()
            assert words == others, left[0]
            share = SAME_APPROACH if "approach" in left[0] or "whole job" in left[0] else SAME
            last_digit = 10.0 ** -len(old.partition(".")[2])
            assert float(old) == pytest.approx(float(new), rel=share, abs=1.01 * last_digit), left[0]


def test_tables_of_figures_are_the_planners(plans: list[Plan]) -> None:
    both = (document_figures.figures(each) for each in plans)
    made = [(*triangle, *line[1:]) for triangle, line in zip(*both, strict=True)]
    assert_figures(cells(DOCS / "results.md", "figures"), made)


def test_what_the_readme_says_is_gained_is_the_planners(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the smaller job; how far the tool sways and swings is not determined."""
    monkeypatch.setattr(cmbot, "plan", planned)
    for quoted, made in zip(cells(README, "jobs"), document_figures.gains("gusset_plate"), strict=True):
        assert quoted[0] == made[0]
        for old, new in zip(quoted[1:3], made[1:], strict=True):
            if "-" in (old, new):
                assert old == new, made[0]
                continue
            last_digit = 10.0 ** -len(old.partition(".")[2])
            close = pytest.approx(float(new), rel=SAME_APPROACH, abs=1.01 * last_digit)
            assert float(old) == close or made[0].startswith("sw"), made[0]


def test_quoted_output_is_the_commands(triangle_plan: Plan) -> None:
    quoted = block(DOCS / "command_line.md", "output of cmbot plan triangle").splitlines()[1:-1]
    table = triangle_plan.summary().splitlines()
    assert quoted[0] == table[0]
    rows = [re.split(r"  +", line) for line in quoted[1 : len(table)]]
    assert_figures(rows, list(triangle_plan.rows(first=True)))
    printed, number = first_remarks(triangle_plan), re.compile(r"[-+]?\d+(?:\.\d+)?")
    for left, right in zip(quoted[len(table) :], printed, strict=False):
        # The words only: figures are compared in the table.
        assert number.sub("#", left) == number.sub("#", right)
    assert [line.split()[0] for line in quoted[len(table) + len(printed) :]] == ["Written"]


def test_table_of_tracking_is_the_simulations(triangle_plan: Plan) -> None:
    quoted = cells(DOCS / "results.md", "tracking of the triangle")
    made = document_figures.tracking(triangle_plan)
    for left, (name, values) in zip(quoted, made, strict=True):
        assert left[0] == name
        # The baseline exactly; what is left of a vibration that is brought to rest is next to nothing.
        assert left[1] == f"{values[0]:.3f}"
        assert [float(x) for x in left[2:]] == pytest.approx(values[1:], rel=1e-2, abs=5e-3), name


def test_citation_license_and_changelog() -> None:
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert all(citation[key] for key in ("message", "title", "authors", "license", "type"))
    assert (citation["license"], citation["version"]) == ("BSD-3-Clause", __version__)
    (paper,) = citation["references"]
    expected = {
        "type": "article",
        "journal": "Electronics",
        "year": 2021,
        "doi": "10.3390/electronics10222793",
    }
    expected |= {"volume": 10, "issue": 22, "start": "2793"}
    assert expected.items() <= paper.items()
    assert all({"family-names"} <= author.keys() for author in paper["authors"])
    license_text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert license_text.startswith("BSD 3-Clause License\n\nCopyright (c) 2026, The cmbot developers\n")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "## [Unreleased]" in changelog
    assert __version__ in changelog


def test_the_gallery_shows_every_shipped_scene() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for name in shipped_scenes():
        section = page.split(f"<!-- {name} -->")[1].split(f"<!-- end of {name} -->")[0]
        assert re.search(r"[Tt]orque .*\d Nm", " ".join(section.split()))
        assert f"(gallery/{name}.png)" in section
        assert (ROOT / "docs" / "gallery" / f"{name}.png").stat().st_size <= gallery.LARGEST
    pictures = {path.stem for path in (ROOT / "docs" / "gallery").iterdir()}
    assert pictures == set(shipped_scenes())


def yaml_blocks(path: Path) -> list[str]:
    return [code for language, code in FENCE.findall(path.read_text("utf-8")) if language == "yaml"]


def test_parts_of_scenes_that_documents_show_are_read() -> None:
    """In a scene that has the rest; files that are named need not be there."""
    keys = set(Scene.model_fields) | {"start", "return"}
    read = 0
    for document in sorted(DOCS.glob("*.md")):
        for block in yaml_blocks(document):
            data = YAML(typ="safe").load(block)
            whole = str(data.get("format", "")) or "cmbot-scene/2"
            if not (whole.startswith("cmbot-scene/") and set(data) <= keys) or "..." in block:
                continue
            if re.search(r"\b(identified|mesh|limits):", block):
                continue
            # A robot that holds something else holds no guardrail.
            if "hold" in data.get("base", {}) or "robot" in data:
                data["robot"] = {"model": "panda"} | data.get("robot", {})
            cmbot.load_scene({**SHORT, **data})
            read += 1
    assert read >= 9


def test_the_how_to_of_a_mast_leads_to_a_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (words,) = re.findall(r"cmbot (new --from panda .*--rpy-deg .*)", (DOCS / "how_to.md").read_text("utf-8"))
    assert run(*words.split()).status == 0
    scene = cmbot.load_scene("panda.yaml")
    tool = Kinematics(cmbot.load_robot("panda")).tool_pose(scene.posture)
    np.testing.assert_allclose(tool.rotation[:, 2], [0, 0, -1], atol=1e-5)
    (mast,) = (block for block in yaml_blocks(DOCS / "how_to.md") if "name: mast" in block)
    # In place of the scene's obstacles and guardrail.
    text = re.sub(
        r"^(obstacles|guardrail): .*\n", "", Path("panda.yaml").read_text("utf-8"), flags=re.MULTILINE
    )
    Path("panda.yaml").write_text(text + mast, encoding="utf-8")
    out = run("check", "panda.yaml").out
    assert out.splitlines()[-1].startswith("No warning. ")
    assert "torque on the mast there" in out


def test_the_how_to_of_a_flange_beside_a_web_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (flange,) = (block for block in yaml_blocks(DOCS / "how_to.md") if "lean_deg" in block)
    Path("flange.yaml").write_text(flange, encoding="utf-8")
    square = flange.replace(", lean_deg: [0, 15]", "")
    Path("square.yaml").write_text(square, encoding="utf-8")
    warned = run("check", "square.yaml").out
    assert re.search(r"link_5 comes within .* of web.*lean_deg \[0, 15\] every place has a posture", warned)
    assert run("check", "flange.yaml").out.splitlines()[-1].startswith("No warning. ")
    # Sooner than with its own options.
    quick = ("knots=fixed", "compensate=false", "tool_path.speed_profile.kind=trapezoidal")
    assert run("plan", "flange.yaml", *(word for each in quick for word in ("--set", each))).status == 0
    plan = cmbot.load_plan("out/flange")
    tool = Kinematics(cmbot.load_robot("cmbot"))
    z = np.array([tool.tool_pose(q).rotation[:, 2] for q in plan.trajectory.q])
    np.testing.assert_allclose(np.degrees(np.arctan2(-z[:, 1], -z[:, 2])), 15, atol=0.1)


def test_the_how_to_of_a_part_in_hand_is_planned() -> None:
    (held,) = (block for block in yaml_blocks(DOCS / "how_to.md") if "fixed:" in block)
    data = {
        "format": "cmbot-scene/2",
        "name": "held",
        "guardrail": {"bays": 0},
        **YAML(typ="safe").load(held),
    }
    # Sooner than about its axis.
    data["tool_path"]["keep"] = "pose"
    plan = cmbot.plan(cmbot.load_scene(data | {"planner": {"baseline": "none"}}))
    assert plan.certificate.holds
    assert plan.figures.min_clearance >= plan.options.safety_margin_m


def test_every_variable_of_the_environment_that_is_read_is_listed() -> None:
    page = (DOCS / "command_line.md").read_text("utf-8")
    text = "".join(path.read_text("utf-8") for path in (ROOT / "cmbot").rglob("*.py"))
    read = re.findall(r"(?:environ\.\w+|_ros_paths)\(\"(\w+)\"", text)
    names = {*read, *packages._PREFIX_VARIABLES, *xacro._VARIABLES} - {
        "SHELL"
    }  # whose commands are completed
    assert len(names) > 10
    assert [name for name in sorted(names) if f"`{name}`" not in page] == []
