"""What the documents say is so: links lead somewhere, code runs, commands exist, figures are printed ones."""

import importlib
import re
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import typer.main
from ruamel.yaml import YAML

from cmbot.archive.tables import columns
from cmbot.cli import app
from cmbot.planning import Plan, plan, remarks
from cmbot.scene import load_scene
from cmbot.simulation import simulate

ROOT = Path(__file__).resolve().parent.parent.parent
IGNORED = {".git", ".venv", "out", "dist", "build", "__pycache__"}
README = ROOT / "README.md"
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.MULTILINE | re.DOTALL)
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


def documents() -> list[Path]:
    return [path for path in tracked_files() if path.suffix == ".md"]


def prose(path: Path) -> str:
    """A document without its blocks of code."""
    return FENCE.sub("", path.read_text(encoding="utf-8"))


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("document", documents(), ids=name_of)
def test_relative_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(document)):
        if not re.match(r"[a-z]+:", target):
            assert (document.parent / target.split("#")[0]).exists(), f"{target} in {name_of(document)}"


def test_the_documents_are_there() -> None:
    names = {name_of(path) for path in documents()}
    pages = ("conventions", "assumptions", "errata", "method", "architecture")
    assert names >= {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", *(f"docs/{page}.md" for page in pages)}


def test_readme_python_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = [code for language, code in FENCE.findall(README.read_text("utf-8")) if language == "python"]
    assert blocks
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for code in blocks:  # they follow on one another
        exec(compile(code, str(README), "exec"), names)
    assert "peak torque on the guardrail" in capsys.readouterr().out
    # The shapes that the comments give.
    shapes = re.findall(r"^(\w+) = .*# \((\d+, \d+)\)", "".join(blocks), flags=re.MULTILINE)
    assert len(shapes) == 3
    for name, shape in shapes:
        assert str(names[name].shape) == f"({shape})"  # type: ignore[attr-defined]
    assert (tmp_path / "triangle" / "plan.json").is_file()
    assert (tmp_path / "triangle.html").stat().st_size > 100_000


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Verbs and options of every ``cmbot …`` in backticks, in a table or in a block of code."""
    blocks = "\n".join(code for language, code in FENCE.findall(text) if language in ("", "sh", "text"))
    lines = re.findall(r"`cmbot ([^`\n]+)`", FENCE.sub("", text))
    lines += re.findall(r"^\s*(?:\$ )?cmbot (.+)$", blocks, flags=re.MULTILINE)
    for line in lines:
        words = line.split("#")[0].split()
        yield words[0], [word.split("=")[0] for word in words[1:] if word.startswith("-")]


def test_named_commands_exist() -> None:
    verbs = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    named = set()
    for document in documents():
        for verb, options in commands(document.read_text(encoding="utf-8")):
            assert verb in verbs, f"cmbot {verb} in {name_of(document)}"
            known = {name for parameter in verbs[verb].params for name in parameter.opts}
            assert set(options) <= known | {"--help"}, f"cmbot {verb} in {name_of(document)}"
            named.add(verb)
    assert named == set(verbs), "a command that no document names"


def test_makefile_has_the_named_targets() -> None:
    targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    named = {
        name for path in documents() for name in re.findall(r"\bmake ([a-z]+)`", path.read_text("utf-8"))
    }
    named |= set(re.findall(r"^    make ([a-z]+)", README.read_text("utf-8"), flags=re.MULTILINE))
    assert {"demo", "test", "lint"} <= named <= set(targets)


def test_named_paths_exist() -> None:
    pattern = re.compile(r"`((?:cmbot|tools|tests|scenes|models|examples|docs|benchmarks)/[\w./]*)`")
    for document in documents():
        for path in (path for path in pattern.findall(prose(document)) if "NAME" not in path):
            assert (ROOT / path).exists(), f"{path} in {name_of(document)}"


def test_named_code_exists() -> None:
    """Every dotted name of docs/, such as those beside the equations, is one of the package."""
    named = {name for path in documents() for name in re.findall(r"`(cmbot(?:\.\w+){2,})`", prose(path))}
    assert len(named) > 20
    for name in sorted(named):
        module, *attributes = split(name)
        thing: object = importlib.import_module(module)
        for attribute in attributes:
            fields = getattr(thing, "__dataclass_fields__", {})
            assert hasattr(thing, attribute) or attribute in fields, name
            thing = getattr(thing, attribute, None)


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
def figures(triangle_plan: Plan) -> list[tuple[str, ...]]:
    """Name, triangle's baseline and planned, line's baseline and planned, as printed."""
    line = plan(load_scene("line"))
    pairs = zip(triangle_plan.rows(), line.rows(), strict=True)
    return [(*triangle, *others[1:]) for triangle, others in pairs]


# Figures of a planned motion that no optimum settles, and by how much they may differ; where nothing is near,
# the smallest clearance most of all.
FLAT = {"clearance": 0.3, "swing": 0.1, "share": 0.02, "tool": 0.02, "mean": 0.02}


def assert_same(quoted: str, printed: str, where: str) -> None:
    """Numbers agree to two of their last digits, or to a share where an optimum is flat; a dash is for none.

    Peaks are what is optimised. Of the motions with one peak the smoothest one is taken, and among those that
    are as smooth to the solver's accuracy the mean torque differs by up to 1 %.
    """
    if "-" in (quoted, printed):
        assert quoted == printed, where
        return
    last_digit = 10.0 ** -len(quoted.partition(".")[2])
    flat = next((share for word, share in FLAT.items() if word in where), 0.0)
    assert float(quoted) == pytest.approx(float(printed), abs=2 * last_digit, rel=flat), where


def test_readme_figures_are_the_planners(figures: list[tuple[str, ...]]) -> None:
    text = README.read_text("utf-8").split("<!-- figures -->")[1].split("<!-- end of figures -->")[0]
    table = [[cell.strip() for cell in line.strip("|\n ").split("|")] for line in text.strip().splitlines()]
    assert [row[0] for row in table[2:]] == [row[0] for row in figures]
    for quoted, printed in zip(table[2:], figures, strict=True):
        for column in range(1, 5):
            # The baseline is not optimised: its figures are exact.
            assert_same(quoted[column], printed[column], "" if column % 2 else quoted[0])


def test_readme_tracking_is_the_simulations(triangle_plan: Plan) -> None:
    text = README.read_text("utf-8").split("<!-- tracking of the triangle -->")[1].split("<!-- end of")[0]
    table = [[cell.strip() for cell in line.strip("|\n ").split("|")] for line in text.strip().splitlines()]
    scene = triangle_plan.scene
    compensated = plan(scene, options=replace(scene.planner, compensate=True))
    plain, other = simulate(triangle_plan), simulate(compensated)
    found = [motion.figures for motion in (plain.baseline, plain.planned, other.planned)]
    assert table[0] == ["mm", "baseline", "planned", "planned, compensated"]
    assert [row[0].split(",")[0] for row in table[2:]] == [
        "error",
        "its dynamic part",
        "off the path",
        "after the stop",
    ]
    for column, figures in enumerate(found, start=1):
        assert figures.residual is not None
        rms = [part.rms[3] for part in (figures.total, figures.dynamic, figures.path)]
        for row, value in zip(table[2:], [*rms, figures.residual.diameter], strict=True):
            # Where the optimum is flat, vibrations differ a little from machine to machine.
            assert float(row[column]) == pytest.approx(1e3 * value, rel=0.1, abs=0.02), row


def test_readme_output_is_the_commands(triangle_plan: Plan) -> None:
    text = README.read_text("utf-8")
    quoted = text.split("<!-- output of cmbot plan triangle -->")[1].split("```")[1].splitlines()[1:]
    printed = [*triangle_plan.summary().splitlines(), *remarks(triangle_plan)]
    assert quoted[0] == printed[0]
    number = re.compile(r"[-+]?\d+(?:\.\d+)?")
    for left, right in zip(quoted, printed, strict=False):
        # Times and passes differ from run to run; the words and the other numbers do not.
        assert number.sub("#", left).split() == number.sub("#", right).split()
        if not left.startswith("Time:"):
            for a, b in zip(number.findall(left), number.findall(right), strict=True):
                assert_same(a, b, left)
    assert [line.split()[0] for line in quoted[len(printed) :]] == ["Written", "Look"]


def test_readme_names_the_columns() -> None:
    """The first of each kind, such as q1 and tool_x."""
    named = set(re.findall(r"`(\w+)`", prose(README)))
    first = {name for name in columns(7) if not re.search(r"[2-9]$|_[yz]$", name)}
    assert first <= named


def test_figures_in_the_prose(figures: list[tuple[str, ...]]) -> None:
    text = " ".join(prose(README).split())
    by_name = {row[0]: row[1:] for row in figures}
    gravity, clearance = by_name["peak of its gravity part, Nm"], by_name["smallest clearance, mm"]
    falls = "falls from {} Nm to about {:.0f} Nm, on the line from {} Nm to about {:.0f} Nm"
    assert falls.format(gravity[0], float(gravity[1]), gravity[2], float(gravity[3])) in text
    # What it is with fixed knots is held by tests/house/test_examples.py.
    assert f"gravity's peak is then {gravity[0]} Nm before and after" in text
    assert f"the baseline's clearance is {clearance[2]} mm" in text


def test_citation() -> None:
    citation = YAML(typ="safe").load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert all(citation[key] for key in ("message", "title", "authors", "license", "type"))
    assert citation["license"] == "BSD-3-Clause"
    assert citation["version"] == importlib.import_module("cmbot").__version__
    (paper,) = citation["references"]
    assert (paper["type"], paper["doi"], paper["year"]) == ("article", "10.3390/electronics10222793", 2021)
    assert all({"family-names"} <= author.keys() for author in paper["authors"])
    assert (paper["journal"], paper["volume"], paper["issue"], paper["start"]) == (
        "Electronics",
        10,
        22,
        "2793",
    )


def test_license_and_changelog() -> None:
    license_text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert license_text.startswith("BSD 3-Clause License\n\nCopyright (c) 2026, The cmbot developers\n")
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "## [Unreleased]" in changelog
    assert importlib.import_module("cmbot").__version__ in changelog
