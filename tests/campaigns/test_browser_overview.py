"""The overview page in a browser without a network."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import ask, chromium, open_page, screen, severe_messages, slide
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


def labels(chrome: Chrome, page: Path, width: int) -> list[str]:
    """All that is written on the map of a page so wide."""
    open_page(chrome, page)
    with screen(chrome, width, 844):
        chrome.execute_script(
            """window.written = [];
            const write = CanvasRenderingContext2D.prototype.fillText;
            CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {
              window.written.push(text);
              write.call(this, text, ...at);
            };
            drawMap();"""
        )
    assert severe_messages(chrome) == []
    written: list[str] = ask(chrome, "window.written")
    return written


def test_a_phones_map_has_a_scale_around_the_peaks(chrome: Chrome, tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    for places in ([3.0 * k for k in range(1, 10)], [1.0, 9.0], [0.0, 900.0], [0.0, 21.0, 33.0]):
        rows = [_row(k) | {"at_m": place} for k, place in enumerate(places)]
        page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
        numbers = [float(text) for text in labels(chrome, page, 390) if text[-1].isdigit()]
        heights = [number for number in numbers if 100 < number < 800]
        peaks = [row["planned_job.peak_guardrail_torque"] for row in rows]
        if max(places) < 100:
            assert min(heights) <= min(peaks) <= max(peaks) <= max(heights)
            assert len(numbers) - len(heights) >= 3
            assert max(heights) - min(heights) < 50
        else:
            assert {0.0, 500.0} <= {*numbers}
    # From and to say what of it is shown.
    slide(chrome, "from", -1)
    slide(chrome, "to", 10)
    assert ask(chrome, "points.length") == 1


def test_what_is_not_on_the_map_is_said(chrome: Chrome, tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    rows = [_row(k) | {"at_m": None if k % 3 == 0 else 3.0 * k} for k in range(9)]
    page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    shown = chrome.find_element("id", "unplaced").text
    assert shown == "Not on the map, without a place (at_m): 3 of 9 jobs."
    assert "not planned" not in chrome.find_element("id", "key").text


def test_without_a_plan_there_is_no_torque_to_draw(chrome: Chrome, tmp_path: Path) -> None:
    none = {f"{which}.peak_guardrail_torque": None for which in FIGURES}
    rows = [_row(k) | none | {"ended": "no plan", "reason": "far", "plan": None} for k in range(3)]
    page = tmp_path / "index.html"
    page.write_text(overview_page("span", rows[:1], tmp_path), encoding="utf-8")
    assert "<p>1 job: 1 no plan</p>" in page.read_text(encoding="utf-8")
    page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
    assert "Peak torque, Nm" not in labels(chrome, page, 390)
    assert not chrome.find_element("id", "histograms").is_displayed()
    assert ask(chrome, "points.length") == 3
    assert chrome.find_element("id", "key").text == "not planned"


def test_a_name_leads_to_the_report_or_the_folder_is_named(chrome: Chrome, tmp_path: Path) -> None:
    rows = [_row(k) for k in range(2)]
    (tmp_path / rows[0]["plan"]).mkdir(parents=True)
    (tmp_path / rows[0]["plan"] / "report.html").touch()
    page = tmp_path / "index.html"
    page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    links = "[...document.querySelectorAll('#rows a')].map((link) => link.getAttribute('href'))"
    assert ask(chrome, links) == ["plans/aa/bay_0/report.html"]
    last = "[...document.querySelectorAll('#rows td:last-child')].map((cell) => cell.textContent)"
    assert ask(chrome, last) == ["plans/aa/bay_0", "plans/aa/bay_1"]


def test_jobs_without_a_rail_are_not_along_one(chrome: Chrome, tmp_path: Path) -> None:
    rows = [_row(k) | {"at_m": None} for k in range(3)]
    rows[1] |= {"ended": "no plan", "reason": "too far; " * 100}
    page = tmp_path / "index.html"
    page.write_text(overview_page("folder", rows, tmp_path), encoding="utf-8")
    open_page(chrome, page)
    assert chrome.find_element("id", "place").text == "Peak torque of each job"
    assert ask(chrome, "document.querySelector('.why p').textContent") == "; ".join(66 * ["too far"])


def test_no_reduction_is_stated_where_the_baseline_breaks_a_limit(chrome: Chrome, tmp_path: Path) -> None:
    fault = "breaks joint limits"
    every = {"baseline_job_faults": fault, "baseline_work_faults": fault}
    page = tmp_path / "index.html"
    reductions = "[...document.querySelectorAll('#rows td:nth-child(6)')].map((cell) => cell.textContent)"
    note = "For {} of 3 jobs none is stated over the whole job, as the baseline breaks a limit."
    for broken, begins, shown in (
        (1, "; the peak of the median job is 2.5 % below its baseline's, at work alone 2.6 % below.", 2),
        (3, ".", 0),
    ):
        rows = [_row(k) | (every if k < broken else {}) for k in (0, 0, 0)[:broken]]
        rows += [_row(0) for _ in range(3 - broken)]
        page.write_text(overview_page("span", rows, tmp_path), encoding="utf-8")
        open_page(chrome, page)
        assert severe_messages(chrome) == []
        assert sum(cell != "" for cell in ask(chrome, reductions)) == shown
        summary = ask(chrome, "document.getElementById('summary').textContent")
        assert summary.startswith("The base must bear at most 390.0 Nm (bay_0)")
        assert summary.partition("(bay_0)")[2] == begins
        assert note.format(broken) in ask(chrome, "document.getElementById('none').textContent")


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
    assert ask(chrome, "document.getElementById('below').textContent") == "Reduction at work, %"
    slide(chrome, "colour", "gain")
    assert ask(chrome, "document.getElementById('below').textContent") == "Reduction of the peak torque, %"
    # One value has one colour.
    assert ask(chrome, "document.getElementById('key').textContent") == "0.0 %"
