"""Take the picture of the README: the replay page of a plan in headless Chromium, as a small PNG.

Run it with ``python tools/screenshot.py out/triangle docs/images/replay_triangle.png`` after ``make demo``.
It needs ``chromium`` on the PATH, and Pillow.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

SIZE = (1280, 720)
# Time in which the page may load and draw, ms of its own clock.
BUDGET = 15_000


def shoot(page: Path, picture: Path, browser: str) -> None:
    """Draw `page` in a browser that cannot reach any network, and write it to `picture`."""
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(
            [
                browser,
                "--headless=new",
                "--no-sandbox",  # a container's root has none
                "--use-angle=swiftshader",
                "--enable-unsafe-swiftshader",
                "--hide-scrollbars",
                "--host-resolver-rules=MAP * ~NOTFOUND",
                f"--user-data-dir={profile}",
                f"--window-size={SIZE[0]},{SIZE[1]}",
                f"--virtual-time-budget={BUDGET}",
                f"--screenshot={picture}",
                page.resolve().as_uri(),
            ],
            check=True,
            stderr=subprocess.DEVNULL,
            timeout=180,
        )


def main() -> None:
    """Read the command line, take the picture, make it small."""
    parser = argparse.ArgumentParser(description="Take a picture of a plan's replay page.")
    parser.add_argument("plan", type=Path, help="plan directory with a replay.html")
    parser.add_argument("picture", type=Path, help="PNG file to write")
    arguments = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium on the PATH")
    with tempfile.TemporaryDirectory() as folder:
        full = Path(folder) / "full.png"
        shoot(arguments.plan / "replay.html", full, browser)
        arguments.picture.parent.mkdir(parents=True, exist_ok=True)
        with Image.open(full) as image:
            # 128 colours are enough for a page of flat shades.
            image.convert("RGB").quantize(128).save(arguments.picture, optimize=True)
    print(f"{arguments.picture}: {arguments.picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
