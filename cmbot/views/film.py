"""A replay page as a video: headless Chromium draws the frames, ffmpeg encodes them."""

from __future__ import annotations

import base64
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.common.errors import InputError, MissingExtra, optional_module
from cmbot.views.page import draft_of, write_page

FRAME_RATE = 30
SIZE = (1280, 720)
COLOURS = ("own", "load", "strain")
MOST_RATE, LEAST_SIDE, MOST_SIDE, MOST_BENDING = 120, 120, 3840, 200
# A palette of the film's own colours: GIF has 256 at most.
_GIF_FILTER = (
    "split[a][b];[a]palettegen=max_colors=128:stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4"
)
# Browsers play no other pixel format; the fast preset leaves the processor to the browser.
_VIDEO_OPTIONS = ("-pix_fmt", "yuv420p", "-preset", "veryfast", "-movflags", "+faststart")
_VIDEO_EXTRA = "video"
# A container's root has no sandbox; SwiftShader draws WebGL without a graphics card, but what puts the page
# together is quicker without it; no network is needed.
_ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--no-first-run",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",
)
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")


def film(
    page: str,
    path: str | Path,
    *,
    speed: float = 1.0,
    fps: int = FRAME_RATE,
    size: tuple[int, int] = SIZE,
    bending: float | None = None,
    colours: str = "own",
    progress: Callable[[float], None] = lambda _: None,
) -> int:
    """Film a replay page from its start to its end.

    Parameters
    ----------
    page : str
        HTML, from `replay_page`.
    path : str or Path
        Video to write, in the format of its suffix, such as ``.mp4`` or ``.gif``. It appears whole or not at
        all.
    speed : float
        Seconds of motion in a second of video.
    fps : int
        Frames a second, 1 to 120.
    size : two ints
        Width and height, px, even numbers from 120 to 3840.
    bending : float, optional
        The factor by which deflections are drawn, 0 to 200; left out, that with which the page begins.
    colours : str
        Of the arm: its ``own``, those of its joints' ``load``, or those of the ``strain`` of links and rails,
        where that is known.
    progress : callable
        Called with the share that has been filmed, after every tenth.

    Returns
    -------
    int
        The number of frames.

    Raises
    ------
    MissingExtra
        When selenium, Chromium with its driver, or ffmpeg is not installed.
    InputError
        When `speed`, `fps`, `size`, `bending` or `colours` is out of its bounds, or the video cannot be
        written.
    """
    path = Path(path)
    if not (np.isfinite(speed) and speed > 0):
        raise InputError("film", "speed", speed, "a number above 0")
    if not 1 <= fps <= MOST_RATE:
        raise InputError("film", "fps", fps, f"a whole number from 1 to {MOST_RATE}")
    if not all(LEAST_SIDE <= side <= MOST_SIDE and side % 2 == 0 for side in size):
        raise InputError(
            "film", "size", f"{size[0]}x{size[1]}", f"even numbers from {LEAST_SIDE} to {MOST_SIDE}"
        )
    if bending is not None and not 0 <= bending <= MOST_BENDING:
        raise InputError("film", "bending", bending, f"a number from 0 to {MOST_BENDING}")
    if colours not in COLOURS:
        raise InputError("film", "colours", colours, "one of " + ", ".join(COLOURS))
    encoder = _program("ffmpeg", ("ffmpeg",), "apt-get install ffmpeg")
    browser = _program("chromium", _BROWSERS, "apt-get install chromium chromium-driver")
    driver = _program("chromedriver", ("chromedriver",), "apt-get install chromium-driver")
    with draft_of(path) as draft, _opened(page, browser, driver, size) as chrome:
        look = (None if bending is None else float(bending), float(speed), colours)
        return _encode(encoder, draft, str(path), fps, _frames(chrome, look, speed / fps, progress))


def _program(name: str, names: tuple[str, ...], command: str) -> str:
    found = next(filter(None, map(shutil.which, names)), None)
    if found is None:
        raise MissingExtra(name, _VIDEO_EXTRA, command)
    return found


@contextmanager
def _opened(page: str, browser: str, driver: str, size: tuple[int, int]) -> Iterator[Any]:
    """Open a page without its controls in a new browser."""
    optional_module("selenium", "selenium", _VIDEO_EXTRA)
    from selenium import webdriver

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "page.html"
        write_page(place, page)
        options = webdriver.ChromeOptions()
        options.binary_location = browser
        for argument in (*_ARGUMENTS, f"--user-data-dir={folder}/profile"):
            options.add_argument(argument)
        chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
        try:
            width, height = size
            screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
            chrome.get(place.as_uri())
            yield chrome
        finally:
            chrome.quit()


def _frames(
    chrome: Any, look: tuple[float | None, float, str], step: float, progress: Callable[[float], None]
) -> Iterator[bytes]:
    chrome.execute_script("cmbotReplay.still(...arguments)", *look)
    start, end = chrome.execute_script("return [cmbotReplay.start, cmbotReplay.end]")
    count = max(int(np.ceil((end - start) / step)), 1) + 1
    options = {"format": "jpeg", "quality": 92, "optimizeForSpeed": True}
    for k, time in enumerate(np.linspace(start, end, count)):
        chrome.execute_script("cmbotReplay.seek(arguments[0]); cmbotReplay.draw()", float(time))
        shot = chrome.execute_cdp_cmd("Page.captureScreenshot", options)
        yield base64.b64decode(shot["data"])
        if (10 * k) // count > (10 * (k - 1)) // count:
            progress(k / count)


def _encode(encoder: str, draft: Path, target: str, fps: int, frames: Iterator[bytes]) -> int:
    """Encode the frames; return their number."""
    words = [encoder, "-loglevel", "error", "-nostdin", "-y", "-f", "image2pipe", "-c:v", "mjpeg"]
    words += ["-framerate", str(fps), "-i", "-"]
    gif = draft.suffix.lower() == ".gif"
    words += ["-vf", _GIF_FILTER] if gif else _VIDEO_OPTIONS
    count = 0
    with tempfile.TemporaryFile() as messages:
        process = subprocess.Popen([*words, str(draft.absolute())], stdin=subprocess.PIPE, stderr=messages)
        try:
            with process.stdin or messages as pipe:
                for frame in frames:
                    pipe.write(frame)
                    count += 1
        except BrokenPipeError:
            pass  # ffmpeg's own message has the reason
        finally:
            status = process.wait()
        if status:
            messages.seek(0)
            reason = messages.read().decode("utf-8", "replace").strip().splitlines() or ["no reason given"]
            why = reason[-1].replace(str(draft.absolute()), target)
            expected = "a file that ffmpeg can write, such as FILE.mp4"
            raise InputError(target, "", f"a refusal of ffmpeg ({why})", expected)
    return count
