"""A headless Chromium that cannot reach any network, for the tests of HTML pages, and what they ask of it."""

import base64
import io
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from selenium.webdriver import Chrome, ChromeOptions, ChromeService

# A container's root has no sandbox; SwiftShader draws WebGL without a graphics card; the rest keeps it quiet.
ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--host-resolver-rules=MAP * ~NOTFOUND",
    "--window-size=720,560",
)
# Only so that nothing waits for ever, s: a frame may take seconds where many processes draw on few cores.
_PATIENCE = 300
# Of the screen for one of a page: the processor draws, so that fewer are drawn sooner.
_PIXELS = 0.25


def programs(*names: str) -> list[str]:
    """Paths of programs; without one the test is skipped, or fails where CMBOT_REQUIRE_BROWSER is 1."""
    found = [shutil.which(name) for name in names]
    if None in found:
        reason = f"{' or '.join(names)} is not on the PATH"
        if os.environ.get("CMBOT_REQUIRE_BROWSER") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return [path for path in found if path is not None]


@contextmanager
def chromium(folder: Path) -> Iterator[Chrome]:
    """Start a browser with its profile in `folder`, and quit it at the end.

    Without Chromium the test is skipped, or fails where CMBOT_REQUIRE_BROWSER is 1.
    """
    browser, driver = programs("chromium", "chromedriver")
    options = ChromeOptions()
    options.binary_location = browser
    for argument in (*ARGUMENTS, f"--user-data-dir={folder}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    chrome = Chrome(options=options, service=ChromeService(driver))
    chrome.set_script_timeout(_PATIENCE)
    try:
        chrome.get("about:blank")  # its own first page asks for things of its own
        yield chrome
    finally:
        chrome.quit()


@contextmanager
def screen(chrome: Chrome, width: int = 1280, height: int = 800, scale: float = _PIXELS) -> Iterator[None]:
    """Another size of the window for a while; then a desktop's again, for the next test.

    With `scale` 1 for what is asked of the pictures themselves.
    """
    _resize(chrome, width, height, scale)
    try:
        yield
    finally:
        _resize(chrome, 1280, 800, _PIXELS)


@contextmanager
def without_webgl(chrome: Chrome) -> Iterator[None]:
    """Let pages that are opened meanwhile find no WebGL, as in a browser that lacks it."""
    script = """const given = HTMLCanvasElement.prototype.getContext;
        HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
            return kind.includes("webgl") ? null : given.call(this, kind, ...rest);
        };"""
    added = chrome.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": script})
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)
        chrome.get("about:blank")


def _resize(chrome: Chrome, width: int, height: int, scale: float) -> None:
    metrics = {"width": width, "height": height, "deviceScaleFactor": scale, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    next_frame(chrome)


def open_page(chrome: Chrome, page: Path) -> None:
    for kind in ("browser", "performance"):
        chrome.get_log(kind)  # of the page before
    chrome.get(page.as_uri())
    next_frame(chrome)


def shows(chrome: Chrome, page: Path) -> bool:
    """Whether a page is open, at whatever time and with whatever view its address has."""
    return chrome.current_url.partition("#")[0] == page.as_uri()


def next_frame(chrome: Chrome) -> None:
    chrome.execute_async_script(
        "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))"
    )


def require_quiet(chrome: Chrome, page: Path) -> None:
    """The page shows no failure, reported no error, and asked for nothing but itself and data in it."""
    chrome.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 5)")
    next_frame(chrome)
    assert severe_messages(chrome) == []
    events = [json.loads(entry["message"])["message"] for entry in chrome.get_log("performance")]
    asked = {e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"}
    asked |= {e["params"]["url"] for e in events if e["method"] == "Network.webSocketCreated"}
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {page.as_uri()}
    assert chrome.find_elements("id", "failure") == []


def severe_messages(chrome: Chrome) -> list[str]:
    """The errors on the page's console since it was opened."""
    return [entry["message"] for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]


def ask(chrome: Chrome, expression: str) -> Any:

    return chrome.execute_script(f"return {expression}")


def pixels(png: str) -> np.ndarray:
    """Those of a picture (height, width, 4), from its data's base 64 or its URL."""
    picture = Image.open(io.BytesIO(base64.b64decode(png.rpartition(",")[2])))
    return np.asarray(picture.convert("RGBA")).astype(int)


def slide(chrome: Chrome, slider: str, value: float | str) -> None:
    """Move a slider of a page as a person would."""
    chrome.execute_script(
        """const slider = document.getElementById(arguments[0]);
        slider.value = arguments[1];
        slider.dispatchEvent(new Event("input"));""",
        *(slider, value),
    )
