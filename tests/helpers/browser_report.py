"""The report page in a browser, for the tests of it."""

import base64
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from browser import chromium, next_frame, open_page
from PIL import Image
from selenium import webdriver

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views import report


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[webdriver.Chrome]:
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        screen = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}
        driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
        yield driver


@pytest.fixture(scope="module")
def page(triangle_plan: Plan, triangle_tracking: Tracking, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "report.html"
    report(triangle_plan, path, tracking=triangle_tracking)
    return path


@pytest.fixture
def shown(chrome: webdriver.Chrome, page: Path) -> webdriver.Chrome:
    """The browser with the page open at time 0, paused, scrolled to its top."""
    if chrome.current_url != page.as_uri():
        open_page(chrome, page)
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.compare('ghost'); window.scrollTo(0, 0)")
    chrome.execute_script("cmbotReplay.seek(0)")
    return chrome


def slide(chrome: webdriver.Chrome, slider: str, value: float) -> None:
    """Move a slider of a page as a person would."""
    chrome.execute_script(
        """const slider = document.getElementById(arguments[0]);
        slider.value = arguments[1];
        slider.dispatchEvent(new Event("input"));""",
        slider,
        value,
    )


def picture(chrome: webdriver.Chrome) -> np.ndarray:
    next_frame(chrome)
    png = chrome.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"]
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")).astype(int)
