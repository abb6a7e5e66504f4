"""Draw the figures of the documentation from real runs.

Run it with ``python tools/plot_figures.py`` after a change that moves them. It needs matplotlib and Pillow.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from PIL import Image

import cmbot
from cmbot.views import figure_files

IMAGES = Path(__file__).resolve().parent.parent / "docs" / "images"
SCENE = "triangle"
SHOWN = ("guardrail_torque", "joints", "tracking_error")


def main() -> None:
    """Plan, simulate, draw what is shown, make it small."""
    plan = cmbot.plan(cmbot.load_scene(SCENE))
    figures = (*cmbot.plot(plan), *cmbot.plot(cmbot.simulate(plan)))
    shown = [figure for figure in figures if figure.get_label() in SHOWN]
    for name, content in figure_files(shown):
        if name.endswith(".png"):
            picture = IMAGES / name.replace(".png", f"_{SCENE}.png")
            with Image.open(BytesIO(content)) as image:
                # 64 colours are enough for lines on white.
                image.convert("RGB").quantize(64).save(picture, optimize=True)
            print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
