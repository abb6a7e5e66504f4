"""Run axe-core on pages: desktop, dark and phone; exit status 1 with a violation that is serious.

``npm install axe-core`` in any folder, then
``python tools/accessibility.py FOLDER/node_modules/axe-core/axe.min.js out/triangle/*.html``.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from browser import chromium, next_frame, open_page, screen  # noqa: E402

SCREENS = (("desktop", 1280, "light"), ("dark", 1280, "dark"), ("phone", 390, "light"))
RUN = "const done = arguments[0]; axe.run(document).then(done, error => done({error: `${error}`}))"


def main() -> int:
    """Print the violations of each page, and return the exit status."""
    axe, *pages = map(Path, sys.argv[1:])
    serious = 0
    with tempfile.TemporaryDirectory() as folder, chromium(Path(folder)) as chrome:
        for page in pages:
            for name, width, colours in SCREENS:
                media = {"features": [{"name": "prefers-color-scheme", "value": colours}]}
                chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
                with screen(chrome, width):
                    open_page(chrome, page.resolve())
                    chrome.execute_script(axe.read_text(encoding="utf-8"))
                    next_frame(chrome)
                    result = chrome.execute_async_script(RUN)
                if "error" in result:
                    sys.exit(f"{page}: {result['error']}")
                found = [(each["impact"], each["id"], len(each["nodes"])) for each in result["violations"]]
                serious += sum(impact in ("serious", "critical") for impact, *_ in found)
                told = "; ".join(f"{impact} {key} ({number})" for impact, key, number in found)
                print(f"{page.name}, {name}: {told or 'none'}")
    return int(serious > 0)


if __name__ == "__main__":
    sys.exit(main())
