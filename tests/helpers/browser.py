"""A headless Chromium that cannot reach any network, for the tests of HTML pages, and what they ask of it."""

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver

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
def chromium(folder: Path) -> Iterator[webdriver.Chrome]:
    """Start a browser with its profile in `folder`, and quit it at the end.

    Without Chromium the test is skipped, or fails where CMBOT_REQUIRE_BROWSER is 1.
    """
    browser, driver = programs("chromium", "chromedriver")
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for argument in (*ARGUMENTS, f"--user-data-dir={folder}"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    chrome = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    chrome.set_script_timeout(_PATIENCE)
    try:
        chrome.get("about:blank")  # its own first page asks for things of its own
        yield chrome
    finally:
        chrome.quit()


@contextmanager
def screen(chrome: webdriver.Chrome, width: int = 1280, height: int = 800) -> Iterator[None]:
    """Another size of the window for a while; then a desktop's again, for the next test."""
    _resize(chrome, width, height)
    try:
        yield
    finally:
        _resize(chrome, 1280, 800)


def _resize(chrome: webdriver.Chrome, width: int, height: int) -> None:
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    next_frame(chrome)


def open_page(chrome: webdriver.Chrome, page: Path) -> None:
    for kind in ("browser", "performance"):
        chrome.get_log(kind)  # of the page before
    chrome.get(page.as_uri())
    next_frame(chrome)


def shows(chrome: webdriver.Chrome, page: Path) -> bool:
    """Whether a page is open, at whatever time and with whatever view its address has."""
    return chrome.current_url.partition("#")[0] == page.as_uri()


def next_frame(chrome: webdriver.Chrome) -> None:
    chrome.execute_async_script(
        "const done = arguments[0]; requestAnimationFrame(() => requestAnimationFrame(() => done()))"
    )


def require_quiet(chrome: webdriver.Chrome, page: Path) -> None:
    """The page shows no failure, reported no error, and asked for nothing but itself and data in it."""
    chrome.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 5)")
    next_frame(chrome)
    assert severe_messages(chrome) == []
    events = [json.loads(entry["message"])["message"] for entry in chrome.get_log("performance")]
    asked = {e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"}
    asked |= {e["params"]["url"] for e in events if e["method"] == "Network.webSocketCreated"}
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {page.as_uri()}
    assert chrome.find_elements("id", "failure") == []


def severe_messages(chrome: webdriver.Chrome) -> list[str]:
    """The errors on the page's console since it was opened."""
    return [entry["message"] for entry in chrome.get_log("browser") if entry["level"] == "SEVERE"]


def ask(chrome: webdriver.Chrome, expression: str) -> Any:

    return chrome.execute_script(f"return {expression}")


def slide(chrome: webdriver.Chrome, slider: str, value: float | str) -> None:
    """Move a slider of a page as a person would."""
    chrome.execute_script(
        """const slider = document.getElementById(arguments[0]);
        slider.value = arguments[1];
        slider.dispatchEvent(new Event("input"));""",
        slider,
        value,
    )
