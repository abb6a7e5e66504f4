"""Check pages by axe-core and by the keyboard; exit status 1 with a violation that is serious.

``npm install axe-core`` in any folder, then
``python tools/accessibility.py FOLDER/node_modules/axe-core/axe.min.js out/triangle/*.html``.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from selenium.webdriver import ActionChains, Chrome, Keys

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from browser import ask, chromium, next_frame, open_page, screen  # noqa: E402

SCREENS = (
    *(("desktop", 1280, "", "light"), ("dark", 1280, "", "dark")),
    *(("phone", 390, "", "light"), ("print", 800, "print", "light")),
)
RUN = "const done = arguments[0]; axe.run(document).then(done, error => done({error: `${error}`}))"
# Names of all that the Tab key has to reach: of radio buttons of one name a single one.
REACHABLE = """
    window.nameOf = (e) => e.type === "radio" ? `radio ${e.name}`
        : `${e.tagName} ${e.id || e.textContent.trim().slice(0, 40)}`;
    return [...new Set([...document.querySelectorAll(
        "a[href], button, input, select, textarea, summary, iframe, [tabindex]")]
        .filter((e) => e.tabIndex >= 0 && !e.disabled && e.checkVisibility({visibilityProperty: true}))
        .map(nameOf))]"""
# What has the focus, and whether that is seen.
FOCUSED = """
    const e = document.activeElement, style = getComputedStyle(e);
    const outlined = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0;
    return [nameOf(e), outlined || style.boxShadow !== "none"]"""


def violations(chrome: Chrome, axe: str) -> Iterator[tuple[str, str, int]]:
    """Yield the impact, the rule and the number of places of what axe-core finds on the page that is open."""
    chrome.execute_script(axe)
    next_frame(chrome)
    result = chrome.execute_async_script(RUN)
    if "error" in result:
        sys.exit(result["error"])
    for found in result["violations"]:
        yield found["impact"], found["id"], len(found["nodes"])


def out_of_reach(chrome: Chrome) -> Iterator[tuple[str, str, int]]:
    """Yield what the Tab key does not reach on the page that is open, and what does not show its focus."""
    wanted = chrome.execute_script(REACHABLE)
    reached = {}
    for _ in range(2 * len(wanted) + 5):
        ActionChains(chrome).send_keys(Keys.TAB).perform()
        name, seen = chrome.execute_script(FOCUSED)
        reached[name] = seen
    for name in wanted:
        if not reached.get(name):
            yield "serious", f"{'focus not seen' if name in reached else 'no focus'}: {name}", 1


def main() -> int:
    """Print the violations of each page, and return the exit status."""
    axe, *pages = map(Path, sys.argv[1:])
    serious = 0
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder)) as chrome:
        for page in pages:
            for name, width, media, colours in SCREENS:
                wanted = {
                    "media": media,
                    "features": [{"name": "prefers-color-scheme", "value": colours}],
                }
                chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", wanted)
                with screen(chrome, width):
                    open_page(chrome, page.resolve())
                    found = list(violations(chrome, axe.read_text(encoding="utf-8")))
                    if name == "desktop":
                        open_page(chrome, page.resolve())
                        print(f"{page}: {ask(chrome, 'document.title')}")
                        found += out_of_reach(chrome)
                serious += sum(impact in ("serious", "critical") for impact, *_ in found)
                told = "; ".join(f"{impact} {key} ({number})" for impact, key, number in found)
                print(f"  {name}: {told or 'none'}", flush=True)
    return int(serious > 0)


if __name__ == "__main__":
    sys.exit(main())
