"""What is told to be run where an optional package is missing."""

import json
import shlex
from importlib import metadata
from pathlib import Path
from unittest.mock import Mock

import pytest

from cmbot.common import installation
from cmbot.common.errors import MissingExtra
from cmbot.common.installation import install_command


def test_of_a_checkout_the_command_names_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    checkout = tmp_path / "a checkout"
    checkout.mkdir()
    monkeypatch.setattr(installation, "_CHECKOUT", checkout)
    recorded = Mock(read_text=Mock(return_value=None))
    monkeypatch.setattr(metadata, "distribution", lambda _: recorded)
    assert shlex.split(install_command("fast")) == ["pip", "install", "cmbot-planner[fast]"]
    # What pip installed from a folder or a wheel of this machine may be on no index.
    recorded.read_text.return_value = json.dumps({"url": checkout.as_uri(), "dir_info": {}})
    assert shlex.split(install_command("fast")) == ["pip", "install", f"{checkout}[fast]"]
    recorded.read_text.return_value = json.dumps({"url": "https://example.org/cmbot.whl"})
    assert shlex.split(install_command("fast")) == ["pip", "install", "cmbot-planner[fast]"]
    (checkout / "pyproject.toml").touch()
    assert shlex.split(install_command("fast")) == ["pip", "install", "-e", f"{checkout}[fast]"]


def test_a_missing_extra_says_what_to_run() -> None:
    assert str(MissingExtra("piqp", "fast")) == f"piqp is not installed; run: {install_command('fast')}"
    told = str(MissingExtra("ffmpeg", "video", "apt-get install ffmpeg"))
    assert told == "ffmpeg is not installed; run: apt-get install ffmpeg"
