"""The overview page in a browser without a network."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import ask, chromium, open_page, severe_messages, slide
from selenium.webdriver import Chrome

from cmbot.campaigns.overview import overview_page

pytestmark = pytest.mark.browser

FIGURES = ("baseline_job", "planned_job", "baseline_work", "planned_work")


@pytest.fixture(scope="module")
def chrome(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


def names(chrome: Chrome) -> list[str]:
    found: list[str] = ask(
        chrome,
        "[...document.querySelectorAll('#rows tr:not(.why) td:first-child')].map((c) => c.textContent)",
    )
    return found


def _row(k: int) -> dict[str, Any]:
    peaks = [400.0 + (k * 7) % 5 - 10 * j for j in range(len(FIGURES))]
    return {
        **{"name": f"bay_{k}", "at_m": 3.0 * k, "ended": "planned", "reason": "", "seconds": 1.0},
        **{"plan": f"plans/aa/bay_{k}", "duration": 20.0, "planned_job.min_clearance": 0.1},
        **{f"{which}.peak_guardrail_torque": peak for which, peak in zip(FIGURES, peaks, strict=True)},
    }


def test_it_sorts_finds_and_tells(chrome: Chrome, tmp_path: Path) -> None:
    rows = [_row(k) for k in range(300)]
    rows[5] |= {"name": "</td><img src=x onerror=alert(1)>", "ended": "no plan", "reason": "out of reach"}
    rows[5] |= {f"{which}.peak_guardrail_torque": None for which in FIGURES} | {"plan": None}
    page = tmp_path / "index.html"
    page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    assert severe_messages(chrome) == []
    box = "document.getElementById('{}').getBoundingClientRect()"
    assert ask(chrome, box.format("key") + ".bottom") <= ask(chrome, box.format("map") + ".top")
    assert names(chrome)[:2] == ["bay_0", "bay_1"]
    assert len(names(chrome)) == 200
    chrome.find_element("id", "more").click()
    assert len(names(chrome)) == 300
    # By the planned peak, the greatest first; those without one are last.
    for _ in range(2):
        chrome.execute_script("document.querySelectorAll('#heads button')[4].click()")
    assert names(chrome)[0] == "bay_2"
    assert names(chrome)[-1].startswith("</td>")
    slide(chrome, "find", "REACH")
    assert len(names(chrome)) == 1
    assert ask(chrome, "document.querySelectorAll('#rows .bad').length") == 1
    assert chrome.find_element("css selector", "#rows .why p").is_displayed()
    assert chrome.find_element("id", "place").text == "Along the rail"
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    sides = "['left', 'right'].map((side) => document.querySelector('.why p').getBoundingClientRect()[side])"
    left, right = ask(chrome, sides)
    chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert 0 < left < right < 390
    summary = ask(chrome, "document.getElementById('summary').textContent")
    assert summary.startswith(
        "The base must bear at most 394.0 Nm (bay_2); the peak of the median job is 2.5 % below"
    )
    # The map has drawn its points, each in its place.
    assert ask(chrome, "points.length") == 300
    colours = (
        "new Set(document.getElementById('map').getContext('2d').getImageData(0, 0, 600, 280).data).size"
    )
    assert ask(chrome, colours) > 5


def test_jobs_without_a_rail_are_not_along_one(chrome: Chrome, tmp_path: Path) -> None:
    rows = [_row(k) | {"at_m": None} for k in range(3)]
    rows[1] |= {"ended": "no plan", "reason": 700 * "x"}
    page = tmp_path / "index.html"
    page.write_text(overview_page("folder", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    assert chrome.find_element("id", "place").text == "Peak torque of each job"
    assert ask(chrome, "document.querySelector('.why p').textContent") == 599 * "x" + "…"


def test_jobs_whose_arms_begin_in_the_heaviest_posture_are_told_by_their_work(
    chrome: Chrome, tmp_path: Path
) -> None:
    rows = [_row(k) for k in range(5)]
    for k, row in enumerate(rows):
        row["planned_job.peak_guardrail_torque"] = row["baseline_job.peak_guardrail_torque"]
        row["planned_work.peak_guardrail_torque"] = (1 - 0.1 * k) * row["baseline_work.peak_guardrail_torque"]
    page = tmp_path / "index.html"
    page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    assert severe_messages(chrome) == []
    summary = ask(chrome, "document.getElementById('summary').textContent")
    assert summary.endswith("is 0.0 % below its baseline's, at work alone 20.0 % below.")
    assert ask(chrome, "document.getElementById('colour').value") == "work"
    assert (
        ask(chrome, "document.getElementById('below').textContent") == "The work alone below the baseline, %"
    )
    slide(chrome, "colour", "gain")
    assert ask(chrome, "document.getElementById('below').textContent") == "Below the baseline, %"
    # One value has one colour.
    assert ask(chrome, "document.getElementById('key').textContent") == "0.0 %not planned"
