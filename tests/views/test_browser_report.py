"""The report page in a browser without a network: view, plots and time go together, and nothing else runs."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import connections, console_errors, next_frame, open_page
from browser_report import chrome as chrome
from browser_report import page as page
from browser_report import picture, slide
from browser_report import shown as shown
from page_data import hostile, without_shapes
from selenium import webdriver
from selenium.webdriver.common.action_chains import ActionChains

from cmbot.planning import Plan
from cmbot.simulation import Tracking
from cmbot.views import report

pytestmark = pytest.mark.browser

EVIL = "</script><script>window.hacked=1</script><img src=x onerror='window.hacked=2'>\"'`${hacked}\u2028"


def cursors(chrome: webdriver.Chrome) -> np.ndarray:
    """Where the cursor of every plot is, as a share of the plot's width."""
    return np.array(
        chrome.execute_script(
            """return [...document.querySelectorAll("svg")].map((svg) => {
                const frame = svg.querySelector(".frame"), left = Number(frame.getAttribute("x"));
                const x = Number(svg.querySelector(".cursor").getAttribute("x1"));
                return (x - left) / Number(frame.getAttribute("width"));
            })"""
        )
    )


def tool_of(chrome: webdriver.Chrome, arm: str) -> np.ndarray:
    link = chrome.execute_script("return cmbotReplay.links.at(-1)")
    pose = chrome.execute_script("return cmbotReplay.pose(...arguments)", link, arm)
    return np.reshape(pose, (4, 4))[:3, 3]


def test_it_opens_without_an_error_and_asks_for_nothing_but_itself(
    chrome: webdriver.Chrome, page: Path
) -> None:
    open_page(chrome, page)
    chrome.execute_script("cmbotReplay.seek(5)")
    next_frame(chrome)
    assert connections(chrome) == {page.as_uri()}
    assert console_errors(chrome) == []
    assert chrome.find_elements("id", "failure") == []
    assert page.stat().st_size < 6_000_000


def test_there_is_a_plot_of_everything(shown: webdriver.Chrome, triangle_plan: Plan) -> None:
    labels = shown.execute_script(
        "return [...document.querySelectorAll('svg')].map((svg) => svg.getAttribute('aria-label'))"
    )
    large = ["Torque on the guardrail", "Clearance", "Tool's distance from its path"]
    large += [f"Tracking error along {axis}" for axis in "xyz"] + ["Elastic tool's distance from its path"]
    small = [
        f"{quantity} of {joint}"
        for joint in triangle_plan.robot.joints
        for quantity in ("angle", "velocity", "acceleration", "jerk", "torque")
    ]
    assert [label.split(":")[0] for label in labels] == large + small
    peaks = [
        figures.peak_guardrail_torque for figures in (triangle_plan.baseline_figures, triangle_plan.figures)
    ]
    approach = triangle_plan.approach
    assert approach is not None
    highest = [float(number) for number in re.findall(r"to ([\d.]+) Nm", labels[0])]
    peaks[1] = max(peaks[1], approach.certificate.figures.peak_guardrail_torque)
    assert highest == pytest.approx(peaks, abs=0.2)
    drawn = shown.execute_script(
        "return [...document.querySelectorAll('path.curve')].map((path) => path.getTotalLength())"
    )
    assert len(drawn) == 2 * 4 + 4 * 3 + 2 * 35
    assert min(drawn) > 20


@pytest.mark.parametrize("time", [-5.0, 3.0, 17.5])
def test_the_slider_moves_arms_and_cursors_together(shown: webdriver.Chrome, time: float) -> None:
    before = tool_of(shown, "planned")
    slide(shown, "scrub", time)
    start, end = shown.execute_script("return [cmbotReplay.start, cmbotReplay.end]")
    assert end == pytest.approx(22.0)
    np.testing.assert_allclose(cursors(shown), (time - start) / (end - start), atol=1e-3)
    assert np.linalg.norm(tool_of(shown, "planned") - before) > 0.05
    assert shown.find_element("id", "time").text == f"{time:.2f} / {end:.2f} s"


def test_a_click_and_a_drag_in_a_plot_move_the_time(shown: webdriver.Chrome) -> None:
    plot = shown.find_element("css selector", "#charts-clearance svg")
    start, end = shown.execute_script("return [cmbotReplay.start, cmbotReplay.end]")
    left, width, whole = shown.execute_script(
        """const frame = arguments[0].querySelector(".frame");
        const [x, width] = ["x", "width"].map((name) => Number(frame.getAttribute(name)));
        return [x, width, arguments[0].clientWidth];""",
        plot,
    )
    offset = round(left + 0.75 * width - 0.5 * whole)
    expected = start + (offset + 0.5 * whole - left) / width * (end - start)
    ActionChains(shown, duration=0).move_to_element_with_offset(plot, offset, 0).click_and_hold().perform()
    assert shown.execute_script("return cmbotReplay.time") == pytest.approx(expected, abs=0.06)
    ActionChains(shown, duration=0).move_by_offset(-100, 0).release().perform()
    moved = expected - 100 / width * (end - start)
    assert shown.execute_script("return cmbotReplay.time") == pytest.approx(moved, abs=0.06)
    np.testing.assert_allclose(cursors(shown), (moved - start) / (end - start), atol=3e-3)


def test_the_values_are_those_of_the_plan(
    shown: webdriver.Chrome, triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    shown.execute_script("cmbotReplay.seek(8)")
    texts = [caption.text for caption in shown.find_elements("css selector", ".chart figcaption")]
    values = [[float(x) for x in re.findall(r"(?:planned|baseline) (-?[\d.]+)", text)] for text in texts]

    def both(planned: float, baseline: float, tolerance: float) -> object:
        return pytest.approx([planned, baseline], abs=tolerance)

    k = int(np.argmin(np.abs(triangle_plan.samples.t - 8.0)))
    motions = (triangle_plan.samples, triangle_plan.baseline)
    assert values[0] == both(*(float(np.linalg.norm(m.guardrail_torque[k])) for m in motions), 0.3)
    assert values[1] == both(*(1e3 * float(m.clearance[k]) for m in motions), 0.3)
    i = int(np.argmin(np.abs(triangle_tracking.planned.t - 8.0)))
    for axis in range(3):
        errors = (
            1e3 * float(m.error[i, axis]) for m in (triangle_tracking.planned, triangle_tracking.baseline)
        )
        assert values[3 + axis] == both(*errors, 0.15)


def test_both_motions_play(shown: webdriver.Chrome) -> None:
    before = {arm: tool_of(shown, arm) for arm in ("planned", "baseline")}
    shown.execute_script("document.activeElement.blur()")
    shown.find_element("tag name", "body").send_keys(" ")
    reached = shown.execute_async_script(
        """const done = arguments[0];
        const wait = () => (cmbotReplay.time > 1.5 ? done(cmbotReplay.playing) : requestAnimationFrame(wait));
        wait();"""
    )
    assert reached is True
    shown.find_element("tag name", "body").send_keys(" ")
    stopped = shown.execute_script("return cmbotReplay.time")
    next_frame(shown)
    assert shown.execute_script("return [cmbotReplay.time, cmbotReplay.playing]") == [stopped, False]
    for arm, start in before.items():
        assert np.linalg.norm(tool_of(shown, arm) - start) > 0.02
    shown.find_element("tag name", "body").send_keys("\ue014")  # right
    assert shown.execute_script("return cmbotReplay.time") == pytest.approx(stopped + 0.1)


def test_the_picture_is_not_blank_and_changes_with_time(shown: webdriver.Chrome) -> None:
    start = picture(shown)
    shown.execute_script("cmbotReplay.seek(10)")
    middle = picture(shown)
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 500
    view, plots = np.s_[200:700, 20:480], np.s_[200:700, 560:1240]
    for part, least in ((view, 1000), (plots, 200)):
        assert (np.abs(start[part] - middle[part]).max(axis=2) > 60).sum() > least


def test_side_by_side_each_half_has_its_arm(shown: webdriver.Chrome) -> None:
    shown.execute_script("cmbotReplay.compare('beside')")
    halves = picture(shown)[200:700]
    planned, baseline = halves[:250, 20:480], halves[-250:, 20:480]
    assert shown.find_element("id", "half-baseline").is_displayed()
    assert len(np.unique(baseline.reshape(-1, 3), axis=0)) > 300
    assert (np.abs(planned - baseline).max(axis=2) > 60).sum() > 500
    pose = {arm: tool_of(shown, arm) for arm in ("planned", "baseline")}
    shown.execute_script("cmbotReplay.compare('ghost')")
    next_frame(shown)
    for arm, before in pose.items():  # drawn with a borrowed pose, and given back
        np.testing.assert_allclose(tool_of(shown, arm), before, atol=1e-9)


def test_deflection_is_magnified(shown: webdriver.Chrome) -> None:
    shown.execute_script("cmbotReplay.seek(5)")
    pictures = []
    for factor in (0, 100):
        slide(shown, "deflection", factor)
        pictures.append(picture(shown)[200:720, 20:480])
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 60).sum() > 200
    assert shown.find_element("id", "factor").text == "× 100"


def test_small_plots_can_be_zoomed(shown: webdriver.Chrome) -> None:
    first = "return document.querySelectorAll('.small path.curve')[1].getBBox().height"
    before = shown.execute_script(first)
    shown.execute_script("document.getElementById('zoom').click()")
    assert shown.execute_script(first) > 2 * before
    shown.execute_script("document.getElementById('zoom').click()")
    assert shown.execute_script(first) == pytest.approx(before)


def test_plots_of_what_bends_say_that_the_approach_is_not_simulated(shown: webdriver.Chrome) -> None:
    words = """return [...document.querySelectorAll("#charts-tracking svg")].map((svg) => {
        return [...svg.querySelectorAll("text")].map((text) => text.textContent);
    })"""
    said = shown.execute_script(words)
    assert len(said) == 4
    assert all({"approach", "not simulated"} <= set(texts) for texts in said)
    elsewhere = shown.execute_script(words.replace("tracking", "torque"))
    assert "approach" in elsewhere[0]
    assert "not simulated" not in elsewhere[0]


def test_hostile_names_are_text_and_nothing_else(
    chrome: webdriver.Chrome, triangle_plan: Plan, triangle_tracking: Tracking, tmp_path: Path
) -> None:
    evil = hostile(without_shapes(triangle_plan), EVIL)
    model = evil.robot.model.copy()
    for number in range(1, model.njoints):
        model.names[number] = f"{EVIL}{number}"
    robot = replace(evil.robot, model=model)
    assert robot.joints[0].startswith(EVIL)
    path = tmp_path / "evil.html"
    report(replace(evil, robot=robot), path, tracking=triangle_tracking)
    open_page(chrome, path)
    chrome.execute_script("cmbotReplay.seek(3)")
    next_frame(chrome)
    assert chrome.execute_script("return window.hacked") is None
    assert chrome.execute_script("return document.querySelector('h1').textContent") == EVIL
    assert chrome.find_elements("css selector", "img:not(#stills img)") == []
    joints = chrome.execute_script(
        "return [...document.querySelectorAll('.joint')].map((e) => e.textContent)"
    )
    assert joints == [f"{EVIL}{number}" for number in range(1, 8)]
    assert EVIL in chrome.execute_script("return document.getElementById('near-label').textContent")
    assert console_errors(chrome) == []  # the policy had nothing to stop either


def test_without_simulation_and_approach_there_is_less(
    chrome: webdriver.Chrome, short_plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "short.html"
    report(without_shapes(short_plan), path)
    open_page(chrome, path)
    assert console_errors(chrome) == []
    assert chrome.execute_script("return [cmbotReplay.start, cmbotReplay.end]") == [0, 4]
    assert len(chrome.find_elements("css selector", ".chart:not(.small)")) == 3
    assert not chrome.find_element("id", "bending").is_displayed()
    assert not chrome.find_element("id", "charts-tracking").is_displayed()
    assert len(chrome.find_elements("css selector", ".card")) == 5
