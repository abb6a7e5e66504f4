"""The documentation as a site: built without a warning, in need of nothing from elsewhere, its code runs."""

import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from browser import chromium
from small_scenes import short_scene

import cmbot

ROOT = Path(__file__).resolve().parent.parent.parent
DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built as ``make docs`` builds it."""
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    assert "WARNING" not in done.stderr, done.stderr
    return folder


class Resources(HTMLParser):
    """What a page loads by itself, and where its links lead."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.anchors |= {name for name in (values.get("id"), values.get("name")) if name}
        if tag == "link" and values.get("rel") in ("canonical", "next", "prev"):
            return
        if tag in ("link", "script", "img", "iframe", "source"):
            self.loaded += [value for value in (values.get("src"), values.get("href")) if value]


def test_every_page_is_there_and_loads_nothing_from_elsewhere(site: Path) -> None:
    pages = list(site.glob("*.html"))
    assert {page.stem for page in pages} - {"404"} == {page.stem for page in DOCS.glob("*.md")}
    for page in pages:
        loaded = Resources(page).loaded
        assert loaded
        for address in loaded:
            assert not re.match(r"(?:\w+:)?//", address), f"{address} in {page.name}"
            # What stands on the page of errors is addressed from the server's root.
            if page.stem != "404":
                assert (site / address.split("?")[0].split("#")[0]).exists(), f"{address} in {page.name}"
    elsewhere = re.compile(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//")
    for style in site.rglob("*.css"):
        assert not elsewhere.search(style.read_text(encoding="utf-8")), style


def test_every_public_name_is_described(site: Path) -> None:
    page = (DOCS / "api.md").read_text(encoding="utf-8")
    anchors = Resources(site / "api.html").anchors
    for name in set(cmbot.__all__) - {"__version__"}:
        # A function beside a module of its own name is addressed by where it is defined, as errors are.
        addresses = {f"cmbot.{name}", f"{getattr(cmbot, name).__module__}.{name}"}
        assert addresses & anchors, name
        headed = (f"::: {it}\n    options: {{heading: cmbot.{name}" for it in addresses)
        described = f"::: cmbot.{name}\n" in page or any(heading in page for heading in headed)
        assert described or getattr(cmbot, name).__module__ == "cmbot.common.errors", name


def test_formulas_are_drawn_without_a_script(site: Path) -> None:
    for page in DOCS.glob("*.md"):
        source, built = page.read_text("utf-8"), (site / f"{page.stem}.html").read_text("utf-8")
        formulas = re.findall(r"<math.*?</math>", built)
        blocks = len(re.findall(r"^\$\$$", source, flags=re.MULTILINE)) // 2
        assert len(formulas) == blocks + source.count("$`")
        # What the converter does not know it leaves as it is.
        assert not any("\\" in formula or ">&<" in formula for formula in formulas), page.name
    assert (site / "method.html").read_text("utf-8").count('display="block"') > 10


def test_the_tutorial_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On a short scene: what matters is that every line of it works."""
    text = (DOCS / "tutorial.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL)
    assert len(blocks) > 5
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cmbot, "load_scene", lambda name: {"triangle": short_scene()}[name])
    names: dict[str, object] = {}
    for code in blocks:
        exec(compile(code, "tutorial.md", "exec"), names)
    printed = capsys.readouterr().out
    assert "peak torque at work" in printed
    off = [float(x) for x in re.findall(r"is (\S+) mm \(RMS\) off its path", printed)]
    assert len(off) == 2
    assert off[1] < 0.1 * off[0]
    written = {path.name for path in tmp_path.iterdir()}
    assert written >= {"triangle", "replay.html", "report.html", "guardrail_torque.pdf", "tracking_error.pdf"}
    assert names["q"].shape == (1000, 7)  # type: ignore[attr-defined]


def test_every_picture_is_shown_and_those_of_the_script_are_there() -> None:
    script = (ROOT / "tools" / "plot_figures.py").read_text(encoding="utf-8")
    drawn = re.findall(r'"(\w+)"', re.findall(r"^SHOWN = (.+)$", script, flags=re.MULTILINE)[0])
    pictures = {path.name for path in (DOCS / "images").iterdir()}
    assert {f"{name}_triangle.png" for name in drawn} <= pictures
    text = "".join(path.read_text("utf-8") for path in (ROOT / "README.md", *DOCS.glob("*.md")))
    for name in pictures:
        assert f"images/{name})" in text, f"{name} is shown nowhere"


@pytest.mark.browser
def test_search_and_colours_work_from_a_folder_without_a_network(site: Path, tmp_path: Path) -> None:
    with chromium(tmp_path / "chromium") as chrome:
        chrome.get((site / "index.html").as_uri())
        found = chrome.execute_async_script(
            """const done = arguments[0], input = document.querySelector("[data-md-component=search-query]");
            document.getElementById("__search").click();
            input.focus();
            input.value = "certificate";
            input.dispatchEvent(new Event("input", {bubbles: true}));
            input.dispatchEvent(new KeyboardEvent("keyup", {bubbles: true}));
            const links = () => document.querySelectorAll(".md-search-result__link");
            const results = () => [...links()].map((link) => link.href);
            const wait = (tries) => (results().length || tries === 0 ? done(results())
                : setTimeout(() => wait(tries - 1), 100));
            wait(200);"""
        )
        # The colours are those of the system at each visit, not those of the first one.
        for scheme, shown in (("light", "default"), ("dark", "slate"), ("light", "default")):
            features = [{"name": "prefers-color-scheme", "value": scheme}]
            chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
            chrome.get((site / "method.html").as_uri())
            assert chrome.execute_script("return document.body.dataset.mdColorScheme") == shown
    assert any("glossary.html" in address for address in found)
    assert all(address.startswith("file://") for address in found)
