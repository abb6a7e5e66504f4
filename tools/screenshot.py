"""Take the pictures of the README: a plan's pages in headless Chromium as PNGs, its motion as a GIF.

Run it with ``python tools/screenshot.py out/triangle docs/images`` after ``make demo`` and
``cmbot simulate out/triangle``. It writes ``replay_NAME.png``, ``report_NAME.png`` and ``NAME.gif``, NAME
being the plan directory's. It needs Chromium with its driver, ffmpeg, selenium and Pillow.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

import cmbot
from cmbot.views import film, replay_page

SIZES = {"replay": (1280, 720), "report": (1500, 1095)}
# Time in which the page may load and draw, ms of its own clock.
BUDGET = 15_000
# How much of the first stroke is over in the pictures: both arms are apart then.
SHARE = 0.45
# Of the GIF; the deflections are drawn so large that one sees the guardrail bend.
GIF_SIZE, GIF_RATE, GIF_SPEED, GIF_BENDING = (800, 450), 10, 4.0, 50.0


def shoot(page: Path, picture: Path, size: tuple[int, int], browser: str, time: float = 0.0) -> None:
    """Draw `page` in a browser that cannot reach any network, at a `time` of the job, s, into `picture`."""
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
                f"--window-size={size[0]},{size[1]}",
                f"--virtual-time-budget={BUDGET}",
                f"--screenshot={picture}",
                f"{page.resolve().as_uri()}#{time:g}",
            ],
            check=True,
            stderr=subprocess.DEVNULL,
            timeout=180,
        )


def time_shown(plan: cmbot.Plan) -> float:
    """Return a time of a plan's job at which both arms are at work and apart, s."""
    stroke = plan.job.strokes[0]
    return stroke.begin + SHARE * stroke.duration


def main() -> None:
    """Read the command line, take the pictures."""
    parser = argparse.ArgumentParser(description="Take pictures of a plan's replay and report.")
    parser.add_argument("plan", type=Path, help="plan directory with its pages")
    parser.add_argument("pictures", type=Path, help="folder for the PNG files")
    arguments = parser.parse_args()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium on the PATH")
    arguments.pictures.mkdir(parents=True, exist_ok=True)
    plan = cmbot.load_plan(arguments.plan)
    for name, size in SIZES.items():
        picture = arguments.pictures / f"{name}_{arguments.plan.resolve().name}.png"
        with tempfile.TemporaryDirectory() as folder:
            full = Path(folder) / "full.png"
            shoot(arguments.plan / f"{name}.html", full, size, browser, time_shown(plan))
            with Image.open(full) as image:
                # No palette: the many shades of the sky take all 256 colours, and what is small, such as the
                # green bracket, gets one of another hue.
                image.convert("RGB").save(picture, optimize=True)
        print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")
    moving = arguments.pictures / f"{arguments.plan.resolve().name}.gif"
    page = replay_page(plan, cmbot.load_tracking(plan, arguments.plan))
    film(page, moving, speed=GIF_SPEED, fps=GIF_RATE, size=GIF_SIZE, bending=GIF_BENDING)
    print(f"{moving}: {moving.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
