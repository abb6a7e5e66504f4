"""A replay as a video: what is missing is named, and what is filmed is a video."""

import builtins
import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from browser import programs
from page_data import without_shapes

from cmbot.common.errors import InputError, MissingExtra
from cmbot.planning import Plan
from cmbot.views import film, replay_page

PROGRAMS = {"ffmpeg", "chromium", "chromedriver"}


def have(monkeypatch: pytest.MonkeyPatch, programs: set[str]) -> None:
    """Let these programs alone be installed."""
    monkeypatch.setattr(shutil, "which", lambda name: f"/bin/{name}" if name in programs else None)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("ffmpeg", "apt-get install ffmpeg"),
        ("chromium", "apt-get install chromium chromium-driver"),
        ("chromedriver", "apt-get install chromium-driver"),
    ],
)
def test_a_missing_program_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, command: str
) -> None:
    have(monkeypatch, PROGRAMS - {name})
    with pytest.raises(MissingExtra, match=f"{name} is not installed; run: {command}"):
        film("<p>page</p>", tmp_path / "film.mp4")
    assert list(tmp_path.iterdir()) == []


def test_missing_selenium_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    have(monkeypatch, PROGRAMS)
    real: Callable[..., Any] = builtins.__import__

    def without_selenium(name: str, *rest: Any, **more: Any) -> Any:
        if name.startswith("selenium"):
            raise ImportError(name)
        return real(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without_selenium)
    with pytest.raises(MissingExtra, match=r"selenium is not installed; run: pip install .*\[video\]"):
        film("<p>page</p>", tmp_path / "film.mp4")


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan")])
def test_a_speed_that_is_none(tmp_path: Path, speed: float) -> None:
    with pytest.raises(InputError, match="film: speed"):
        film("<p>page</p>", tmp_path / "film.mp4", speed=speed)


@pytest.fixture(scope="module")
def light_page(short_plan: Plan) -> str:
    return replay_page(without_shapes(short_plan))


@pytest.mark.browser
def test_it_films_from_start_to_end(light_page: str, tmp_path: Path) -> None:
    programs(*PROGRAMS)
    path, shares = tmp_path / "film.mp4", []
    film(light_page, path, speed=10.0, progress=shares.append)
    words = ["ffprobe", "-v", "error", "-count_frames", "-show_streams", "-of", "json"]
    done = subprocess.run([*words, str(path)], capture_output=True, text=True, check=True)
    (stream,) = json.loads(done.stdout)["streams"]
    assert (stream["width"], stream["height"]) == (1280, 720)
    assert int(stream["nb_read_frames"]) == 11  # 4 s, ten times as fast, 25 a second, with both ends
    assert shares == sorted(shares)
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.browser
@pytest.mark.parametrize("place", ["film.nosuch", "missing/film.mp4"])
def test_a_video_that_cannot_be_written(light_page: str, tmp_path: Path, place: str) -> None:
    programs(*PROGRAMS)
    with pytest.raises(InputError, match="a refusal of ffmpeg") as caught:
        film(light_page, tmp_path / place, speed=100.0)
    assert caught.value.source == str(tmp_path / place)
    assert list(tmp_path.iterdir()) == []
