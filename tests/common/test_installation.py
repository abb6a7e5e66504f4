"""What is told to be run where an optional package is missing."""

import shlex
from pathlib import Path

import pytest

from cmbot.common import installation
from cmbot.common.errors import MissingExtra
from cmbot.common.installation import install_command


def test_of_a_checkout_the_command_names_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    checkout = tmp_path / "a checkout"
    checkout.mkdir()
    monkeypatch.setattr(installation, "_CHECKOUT", checkout)
    assert shlex.split(install_command("fast")) == ["pip", "install", "cmbot-planner[fast]"]
    (checkout / "pyproject.toml").touch()
    assert shlex.split(install_command("fast")) == ["pip", "install", "-e", f"{checkout}[fast]"]


def test_a_missing_extra_says_what_to_run() -> None:
    assert str(MissingExtra("piqp", "fast")) == f"piqp is not installed; run: {install_command('fast')}"
    told = str(MissingExtra("ffmpeg", "video", "apt-get install ffmpeg"))
    assert told == "ffmpeg is not installed; run: apt-get install ffmpeg"
