"""One browser and one set of pages for all tests of this room: both take long to make."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import chromium, screen
from selenium.webdriver import Chrome

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views import replay, report


@pytest.fixture(scope="session")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    """A browser whose window is that of a desktop."""
    with chromium(tmp_path_factory.mktemp("chromium")) as driver, screen(driver):
        yield driver


@pytest.fixture(scope="session")
def replay_file(triangle_plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The replay of the triangle, without its simulation."""
    path = tmp_path_factory.mktemp("page") / "replay.html"
    replay(triangle_plan, path)
    return path


@pytest.fixture(scope="session")
def report_file(
    triangle_plan: Plan, triangle_tracking: Tracking, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """The report of the triangle with its simulation."""
    path = tmp_path_factory.mktemp("page") / "report.html"
    report(triangle_plan, path, tracking=triangle_tracking)
    return path
