"""A replay as a video: what is missing is named, and what is filmed is a video."""

import json
import shutil
import subprocess
import sys
from contextlib import nullcontext
from importlib import import_module
from io import BytesIO
from pathlib import Path

import pytest
from browser import programs
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


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_none(tmp_path: Path, speed: float) -> None:
    with pytest.raises(InputError, match="film: speed"):
        film("<p>page</p>", tmp_path / "film.mp4", speed=speed)


@pytest.mark.browser
def test_it_films_from_start_to_end_or_says_what_ffmpeg_refuses(
    short_plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs(*PROGRAMS)
    picture = BytesIO()
    Image.new("RGB", (64, 64)).save(picture, "JPEG")
    page, path, shares = replay_page(without_shapes(short_plan)), tmp_path / "film.mp4", []
    film(page, path, speed=40.0, progress=shares.append)
    words = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json"]
    done = subprocess.run([*words, str(path)], capture_output=True, text=True, check=True)
    (stream,) = json.loads(done.stdout)["streams"]
    assert (stream["width"], stream["height"]) == (1280, 720)
    assert int(stream["nb_read_frames"]) == 4  # 4 s, forty times as fast, 25 a second, with both ends
    assert shares == sorted(shares)
    # No browser is needed to be refused.
    monkeypatch.setattr(video, "_opened", lambda *_: nullcontext())
    monkeypatch.setattr(video, "_frames", lambda *_: iter([picture.getvalue()]))
    for place in ("film.nosuch", "missing/film.mp4"):
        with pytest.raises(InputError, match="a refusal of ffmpeg") as caught:
            film(page, tmp_path / place)
        assert caught.value.source == str(tmp_path / place)
    assert list(tmp_path.iterdir()) == [path]
