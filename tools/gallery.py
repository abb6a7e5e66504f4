"""Write docs/gallery.md and its pictures: every shipped job planned, with figures and a picture of each.

Run ``python tools/gallery.py`` after a change that moves figures, or ``python tools/gallery.py pipe line``
for some jobs; it takes minutes. It needs ``chromium`` on the PATH, and Pillow.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from document_figures import ROOT, write_between
from PIL import Image
from screenshot import shoot, time_shown

import cmbot
from cmbot.common.installation import scene_folder
from cmbot.scene import shipped_scenes
from cmbot.stances import StandOptions
from cmbot.views import replay_page, walk_replay_page

PAGE, PICTURES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "gallery"
TOURS = {"two_brackets": StandOptions(members=("top_rail",), pair_spacing=0.15)}
"""Scenes that no stance does alone, and where feet hold at work."""
LARGEST = 150_000
"""Of a picture, bytes."""
# Pixels of a picture, and numbers of colours that are tried until it is small.
_SIZE, _COLOURS = (800, 450), (256, 128, 64)


def figures(plan: cmbot.Plan, planning: float) -> Iterator[str]:
    """Yield what a job asks, each figure with its name and unit."""
    job = plan.job.figures
    if (accuracy := plan.accuracy) is not None:
        probability = 100 * accuracy.probability
        yield f"tool within {accuracy.within_mm:.3g} mm of its path with {probability:g} %"
    yield f"peak torque {job.peak_guardrail_torque:.1f} Nm"
    yield f"clearance {1e3 * job.min_clearance:.1f} mm"
    if plan.coverage:
        area, covered, unreached = (
            sum(getattr(one, name) for one in plan.coverage.values())
            for name in ("area", "covered", "unreached")
        )
        yield f"{covered:.4g} of {area:.4g} m2 covered" + (f", {unreached:.4g} not reached" * (unreached > 0))
    yield f"{plan.job.duration:.1f} s, planned in {planning:.0f} s of processor time"


def section(name: str, sentences: Iterable[str]) -> str:
    """Return the section of a job: its picture, and what it asks."""
    return f"![{name}](gallery/{name}.png)\n\n{textwrap.fill(' '.join(sentences), 118)}"


def tour_sentences(tour: cmbot.Tour) -> list[str]:
    """Return what is said of a tour, without where its feet hold."""
    first, _, *others = tour.in_words()
    return [first, *others]


def picture(page_text: str, time_of_it: float, path: Path, browser: str) -> None:
    """Write a picture of a replay with no more than `LARGEST` bytes."""
    with tempfile.TemporaryDirectory() as folder:
        page, full = Path(folder) / "replay.html", Path(folder) / "full.png"
        # As in a film: without controls.
        page.write_text(page_text.replace("<body>", '<body class="film">'), encoding="utf-8")
        shoot(page, full, _SIZE, browser, time_of_it)
        with Image.open(full) as image:
            small = image.convert("RGB")
    small.save(path, optimize=True)
    for colours in _COLOURS:
        if path.stat().st_size <= LARGEST:
            return
        small.quantize(colours, dither=Image.Dither.NONE).save(path, optimize=True)


def main() -> None:
    """Plan the jobs, write page and pictures."""
    parser = argparse.ArgumentParser(description="Write the gallery of the shipped jobs.")
    parser.add_argument("names", nargs="*", help="default: all")
    parser.add_argument("--figures", action="store_true", help="leave the pictures as they are")
    arguments = parser.parse_args()
    names = arguments.names or shipped_scenes()
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("no Chromium on the PATH")
    PICTURES.mkdir(exist_ok=True)
    for name in names:
        scene = cmbot.load_scene(scene_folder() / f"{name}.yaml")
        if name in TOURS:
            try:
                tour = cmbot.tour(scene, TOURS[name])
            except cmbot.PlanningError as refused:
                print(f"{name}: left as it is: {refused}")
                continue
            (walk,) = tour.walks
            picture(walk_replay_page(walk), 0.4 * walk.seconds, PICTURES / f"{name}.png", browser)
            write_between(PAGE, name, section(name, tour_sentences(tour)))
            continue
        begin = time.process_time()
        plan = cmbot.plan(scene)
        planning = time.process_time() - begin
        if not arguments.figures:
            picture(replay_page(plan), time_shown(plan), PICTURES / f"{name}.png", browser)
        said = "; ".join(figures(plan, planning))
        said = f"{said[0].upper()}{said[1:]}."
        write_between(PAGE, name, section(name, [said]))
        print(f"{name}: {(PICTURES / f'{name}.png').stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
