"""The walk's replay in a browser: the robot where the walk has it, what its feet bear."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import ask, next_frame, open_page, severe_messages
from command_line import run
from selenium.webdriver import Chrome
from walks import one_step

from cmbot.archive import WALK_FILE, write_results
from cmbot.stances.walking import walk_data, walk_samples
from cmbot.views import walk_page
from cmbot.views.walk_replay import _decimated

pytestmark = pytest.mark.browser


def test_few_places_are_drawn_of_a_long_way() -> None:
    still = np.zeros((500, 3))
    way = np.vstack([still, np.linspace([0, 0, 0], [1, 0, 0], 5000), still + np.array([1.0, 0.0, 0.0])])
    drawn = _decimated(way)
    assert len(drawn) <= 160
    np.testing.assert_allclose(drawn[[0, -1]], [[0, 0, 0], [1, 0, 0]])
    assert np.linalg.norm(np.diff(drawn, axis=0), axis=1).max() < 0.02


def test_the_walk_is_shown(chrome: Chrome, tmp_path: Path) -> None:
    write_results(tmp_path, WALK_FILE, walk_data(one_step()), {})
    done = run("replay", tmp_path)
    assert done.status == 0, done.err
    open_page(chrome, tmp_path / "replay.html")
    parts = list(walk_samples(one_step()))
    part, at = parts[1], 7
    chrome.execute_script("cmbotReplay.seek(arguments[0])", float(part.t[at]))
    next_frame(chrome)
    for k in (1, 2):
        pose = chrome.execute_script("return cmbotReplay.pose(arguments[0], 'planned')", f"foot_{k}")
        np.testing.assert_allclose(np.reshape(pose, (4, 4))[:3, 3], part.feet[at, k - 1], atol=2e-3)
    texts = ask(
        chrome, "['subtitle', 'foot-1', 'foot-2'].map((id) => document.getElementById(id).textContent)"
    )
    assert texts[:2] == ["step 1 of 1: foot 1 swings", "free"]
    assert texts[2] == f"{100 * part.share[at, 1]:.0f} %"
    assert chrome.find_element("id", "drawn").text == "pale parts are no obstacles"
    assert severe_messages(chrome) == []


def test_the_table_of_steps_ends_with_the_arms_own_move() -> None:
    """Steps and seconds add up to the walk's."""
    walk = one_step()
    arm = replace(walk.moves[0], kind="arm")
    page = walk_page(replace(walk, last=arm))
    rows = re.findall(r"<tr>(<th class=\"text\" scope=\"row\">.*?)</tr>", page)
    cells = [re.findall(r">([^<]*)</t", row) for row in rows]
    assert [row[1] for row in cells] == ["foot 1", "arm"]
    seconds = sum(float(row[5]) for row in cells)
    assert seconds == pytest.approx(walk.seconds + arm.segment.duration, abs=0.11)
    assert float(cells[1][4]) == pytest.approx(walk.seconds, abs=0.06)


def test_tables_of_still_pages_stay_readable_on_a_phone(chrome: Chrome, tmp_path: Path) -> None:
    path = tmp_path / "walk.html"
    path.write_text(walk_page(one_step()), encoding="utf-8")
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        chrome.get(path.as_uri())
        assert ask(chrome, "document.documentElement.scrollWidth") == 390
        head, row = ask(
            chrome, "['thead', 'tbody'].map((part) => document.querySelector(`${part} tr`).offsetHeight)"
        )
        assert max(head, row) < 70  # two or three lines
    finally:
        chrome.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
