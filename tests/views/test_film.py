"""A replay as a video: what is missing is named, and what is filmed is a video."""

import json
import shutil
import subprocess
import sys
from contextlib import nullcontext
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from browser import programs
from command_line import refusal
from page_data import without_shapes
from PIL import Image

from cmbot.common.errors import InputError, MissingExtra
from cmbot.planning import Plan
from cmbot.views import film, replay_page

# The function has the name of its module.
video = import_module("cmbot.views.film")
PROGRAMS = {"ffmpeg", "chromium", "chromedriver"}


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("ffmpeg", "apt-get install ffmpeg"),
        ("chromium", "apt-get install chromium chromium-driver"),
        ("chromedriver", "apt-get install chromium-driver"),
        ("selenium", r"pip install .*\[video\]"),
    ],
)
def test_what_is_missing_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, command: str
) -> None:
    found = PROGRAMS - {name}
    monkeypatch.setattr(shutil, "which", lambda program: f"/bin/{program}" if program in found else None)
    if name == "selenium":
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtra, match=f"{name} is not installed; run: {command}"):
        film("<p>page</p>", tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("speed", speed) for speed in (0.0, -1.0, float("nan"))),
        *(("fps", fps) for fps in (0, 121)),
        *(("size", size) for size in ((1280, 721), (100, 100), (640, 4000))),
        *(("bending", factor) for factor in (-1.0, 201.0, float("nan"))),
        ("colours", "rainbow"),
    ],
)
def test_what_no_film_can_be(tmp_path: Path, name: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"film: {name}"):
        film("<p>page</p>", tmp_path / "film.mp4", **{name: value})


def test_where_no_file_can_be_nothing_is_filmed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video, "_program", lambda *_: "true")
    monkeypatch.setattr(video, "_opened", lambda *_: pytest.fail("opened first"))
    with pytest.raises(
        InputError, match=r"film\.mp4: got a file that cannot be written \(there is no folder \S*/missing\)"
    ):
        film("<p>page</p>", tmp_path / "missing" / "film.mp4")
    assert list(tmp_path.iterdir()) == []


def test_options_of_a_film_are_checked_on_the_command_line(saved_short: Path) -> None:
    assert "--fps: got 10, expected it with --video" in refusal("replay", saved_short, "--fps", "10")
    assert "--size: got big" in refusal("replay", saved_short, "--video", "a.mp4", "--size", "big")
    assert "ends with .gif" in refusal("replay", saved_short, "--gif", "film.mp4")


@pytest.mark.browser
def test_it_films_from_start_to_end_or_says_what_ffmpeg_refuses(
    short_plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs(*PROGRAMS)
    picture = BytesIO()
    Image.new("RGB", (64, 64)).save(picture, "JPEG")
    page, path, shares = replay_page(without_shapes(short_plan)), tmp_path / "film.mp4", []
    count = film(page, path, speed=40.0, fps=25, size=(320, 180), colours="strain", progress=shares.append)
    words = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json"]
    done = subprocess.run([*words, str(path)], capture_output=True, text=True, check=True)
    (stream,) = json.loads(done.stdout)["streams"]
    assert (stream["width"], stream["height"]) == (320, 180)
    assert (
        int(stream["nb_read_frames"]) == count == 4
    )  # 4 s, forty times as fast, 25 a second, with both ends
    assert shares == sorted(shares)
    # No browser is needed to be refused.
    monkeypatch.setattr(video, "_opened", lambda *_: nullcontext())
    monkeypatch.setattr(video, "_frames", lambda *_: iter([picture.getvalue()]))
    with pytest.raises(InputError, match=r"a refusal of ffmpeg \((?!.*/\.)") as caught:
        film(page, tmp_path / "film.nosuch")
    assert caught.value.source == str(tmp_path / "film.nosuch")
    # A GIF by its suffix.
    film(page, gif := tmp_path / "film.gif")
    assert gif.read_bytes().startswith(b"GIF89a")
    assert set(tmp_path.iterdir()) == {path, gif}
