"""The report page in a browser without a network: view, plots and time, and its looks on screen and paper."""

import base64
import csv
import io
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browser import ask, next_frame, open_page, pixels, require_quiet, screen, shows, slide, without_webgl
from obstacle_entries import renamed, with_obstacles
from page_data import hostile, without_shapes
from PIL import ImageColor
from selenium.webdriver import Chrome
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.support.ui import WebDriverWait

from cmbot.collision import Obstacle, Sphere
from cmbot.common.poses import pose
from cmbot.planning import Plan
from cmbot.robot import Kinematics
from cmbot.simulation import Tracking
from cmbot.views import report
from cmbot.views.page import pack

pytestmark = pytest.mark.browser

EVIL = "</script><script>window.hacked=1</script><img src=x onerror='window.hacked=2'>\"'`${hacked}\u2028"


@pytest.fixture
def shown(chrome: Chrome, report_file: Path) -> Chrome:
    """The browser with the page open at the work's beginning, paused, scrolled to its top."""
    if not shows(chrome, report_file):
        open_page(chrome, report_file)
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.compare('ghost'); window.scrollTo(0, 0)")
    slide(chrome, "deflection", 0)  # the rigid arm
    chrome.execute_script("cmbotReplay.seek(cmbotReplay.workStart)")
    next_frame(chrome)  # of another layout of the view, too
    return chrome


def picture(chrome: Chrome) -> np.ndarray:
    with screen(chrome, scale=1):
        next_frame(chrome)
        return pixels(chrome.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"])[..., :3]


def cursors(chrome: Chrome) -> np.ndarray:
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


def tool_of(chrome: Chrome, arm: str) -> np.ndarray:
    link = ask(chrome, "cmbotReplay.links.at(-1)")
    pose = chrome.execute_script("return cmbotReplay.pose(...arguments)", link, arm)
    return np.reshape(pose, (4, 4))[:3, 3]


def test_it_opens_without_an_error_and_asks_for_nothing_but_itself(shown: Chrome, report_file: Path) -> None:
    require_quiet(shown, report_file)
    assert report_file.stat().st_size < 6_000_000


def test_there_is_a_plot_of_everything(shown: Chrome, triangle_plan: Plan) -> None:
    labels = ask(shown, "[...document.querySelectorAll('svg')].map((svg) => svg.getAttribute('aria-label'))")
    large = ["Torque on the guardrail", "Clearance", "Tool's distance from its path"]
    large += [f"Tracking error along {axis}" for axis in "xyz"]
    large += ["Elastic tool's distance from its path", "Torque on the guardrail with sag and vibration"]
    small = [
        f"{quantity} of {joint}"
        for joint in triangle_plan.robot.joints
        for quantity in ("angle", "velocity", "acceleration", "jerk", "torque")
    ]
    assert [label.split(":")[0] for label in labels] == large + small
    peaks = [
        figures.peak_guardrail_torque for figures in (triangle_plan.baseline.figures, triangle_plan.figures)
    ]
    approach = triangle_plan.approach
    highest = [float(number) for number in re.findall(r"to ([\d.]+) Nm", labels[0])]
    peaks[1] = max(peaks[1], approach.certificate.figures.peak_guardrail_torque)
    assert highest == pytest.approx(peaks, abs=0.2)
    drawn = ask(shown, "[...document.querySelectorAll('path.curve')].map((path) => path.getTotalLength())")
    # A rigid baseline is not drawn beside a bent arm's distance from its path.
    assert len(drawn) == 2 * 4 - 1 + 4 * 3 + 2 + 2 * 35
    assert min(drawn) > 20
    # Those of what bends say that the approach is not simulated.
    words = """return [...document.querySelectorAll("#charts-tracking svg")].map((svg) => {
        return [...svg.querySelectorAll("text")].map((text) => text.textContent);
    })"""
    said = shown.execute_script(words)
    assert len(said) == 5
    whys = 3 * ["not simulated"] + ["no tool path", "not simulated"]
    assert all({"approach", why} <= set(texts) for texts, why in zip(said, whys, strict=True))
    elsewhere = shown.execute_script(words.replace("tracking", "torque"))
    assert "approach" in elsewhere[0]
    assert "not simulated" not in elsewhere[0]


def test_a_curve_is_broken_where_it_begins_again(shown: Chrome) -> None:
    numbers = {"t": [0.0, 1.0, 3.0, 4.0], "y": [1.0, 2.0, 6.0, 5.0]}
    curve = {"motion": "baseline", "thin": False, "starts": [2]}
    curve |= {name: pack(np.array(values)) for name, values in numbers.items()}
    draw = """
        const whole = { ...arguments[0], starts: [] }, drawn = [arguments[0], whole].map((source) => {
            const curve = new Curve(source), inside = make("g");
            Chart.prototype.drawCurve.call({ x: (t) => t, y: (y) => y }, curve, inside);
            return [inside.firstChild.getAttribute("d"), [0.5, 2, 3.5].map((time) => curve.at(time))];
        });
        return drawn;
    """
    (broken, at), (line, along) = shown.execute_script(draw, curve)
    assert broken == "M0.0 1.0L1.0 2.0M3.0 6.0L4.0 5.0"
    assert line == broken[0] + broken[1:].replace("M", "L")
    assert (at, along) == ([1.5, None, 5.5], [1.5, 4, 5.5])


@pytest.mark.parametrize("time", [5.0, 13.0, 27.5])
def test_the_slider_moves_arms_and_cursors_together(shown: Chrome, time: float) -> None:
    before = tool_of(shown, "planned")
    slide(shown, "scrub", time)
    start, begin, end = ask(shown, "[cmbotReplay.start, cmbotReplay.workStart, cmbotReplay.end]")
    assert (start, end) == pytest.approx((0.0, begin + 22.0))
    np.testing.assert_allclose(cursors(shown), (time - start) / (end - start), atol=1e-3)
    assert np.linalg.norm(tool_of(shown, "planned") - before) > 0.05
    assert shown.find_element("id", "time").text == f"{time:.2f} / {end:.2f} s"


def wait_for_time(chrome: Chrome, time: float, within: float) -> None:
    """A browser that is busy handles a click later."""
    WebDriverWait(chrome, 60).until(
        lambda driver: abs(ask(driver, "cmbotReplay.time") - time) < within,
        f"the time is not {time:.2f} s",
    )


def test_a_click_and_a_drag_in_a_plot_move_the_time(shown: Chrome) -> None:
    plot = shown.find_element("css selector", "#charts-clearance svg")
    shown.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    start, end = ask(shown, "[cmbotReplay.start, cmbotReplay.end]")
    left, width, whole = shown.execute_script(
        """const frame = arguments[0].querySelector(".frame");
        const [x, width] = ["x", "width"].map((name) => Number(frame.getAttribute(name)));
        return [x, width, arguments[0].clientWidth];""",
        plot,
    )
    offset = round(left + 0.75 * width - 0.5 * whole)
    expected = start + (offset + 0.5 * whole - left) / width * (end - start)
    ActionChains(shown, duration=0).move_to_element_with_offset(plot, offset, 0).click_and_hold().perform()
    wait_for_time(shown, expected, within=0.06)
    ActionChains(shown, duration=0).move_by_offset(-100, 0).release().perform()
    moved = expected - 100 / width * (end - start)
    wait_for_time(shown, moved, within=0.06)
    np.testing.assert_allclose(cursors(shown), (moved - start) / (end - start), atol=3e-3)


def test_the_values_are_those_of_the_plan(
    shown: Chrome, triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 8)")
    texts = [caption.text for caption in shown.find_elements("css selector", ".chart figcaption")]
    values = [[float(x) for x in re.findall(r"(?:planned|baseline) (-?[\d.]+)", text)] for text in texts]

    def both(planned: float, baseline: float, tolerance: float) -> object:
        return pytest.approx([planned, baseline], abs=tolerance)

    k = int(np.argmin(np.abs(triangle_plan.samples.t - 8.0)))
    motions = (triangle_plan.samples, triangle_plan.baseline.samples)
    assert values[0] == both(*(float(np.linalg.norm(m.guardrail_torque[k])) for m in motions), 0.3)
    assert values[1] == both(*(1e3 * float(m.clearance[k]) for m in motions), 0.3)
    i = int(np.argmin(np.abs(triangle_tracking.planned.t - 8.0)))
    for axis in range(3):
        errors = (
            1e3 * float(m.error[i, axis]) for m in (triangle_tracking.planned, triangle_tracking.baseline)
        )
        assert values[3 + axis] == both(*errors, 0.15)
    torque = float(np.linalg.norm(triangle_tracking.planned.base[i, 6:]))
    # The baseline's vibrates between the points that are drawn.
    assert values[7][0] == pytest.approx(torque, abs=0.3)


def test_a_pointer_shows_every_value_and_a_click_a_joint_large(shown: Chrome, triangle_plan: Plan) -> None:
    plot = shown.find_element("css selector", "#charts-torque svg")
    shown.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
    ActionChains(shown, duration=0).move_to_element(plot).perform()
    next_frame(shown)
    texts = ask(shown, "[...document.querySelectorAll('#tip div')].map((line) => line.textContent)")
    time, planned, baseline = (float(re.search(r"[\d.]+", text)[0]) for text in texts)
    samples, begin = triangle_plan.samples, triangle_plan.approach.duration
    torque = np.interp(time - begin, samples.t, np.linalg.norm(samples.guardrail_torque, axis=1))
    assert planned == pytest.approx(torque, abs=0.5)
    assert texts[2].startswith("baseline") and baseline > 0
    small = shown.find_element("css selector", "#joint-grid svg")
    shown.execute_script("arguments[0].scrollIntoView({block: 'center'})", small)
    ActionChains(shown, duration=0).move_to_element(small).click().perform()
    next_frame(shown)
    titles = ask(shown, "[...document.querySelectorAll('#joint-large b')].map((title) => title.textContent)")
    assert titles[0] == "angle of joint_1, deg" and len(titles) == 5
    shown.execute_script("document.querySelector('#joint-large button').click()")
    assert not shown.find_element("id", "joint-large").is_displayed()


def test_the_view_turns_shifts_and_zooms_by_keys(shown: Chrome) -> None:
    def camera() -> list[float]:
        return ask(shown, "cmbotReplay.camera")

    view, time = shown.find_element("id", "view"), ask(shown, "cmbotReplay.time")
    view.send_keys("0")
    before = camera()
    for keys in ("\ue014", "\ue013", "\ue008\ue012", "+", "-"):
        last = camera()
        view.send_keys(keys)
        assert camera() != pytest.approx(last)
    view.send_keys("0")
    assert camera() == pytest.approx(before)
    assert ask(shown, "cmbotReplay.time") == time


def test_what_is_saved_is_the_plans_motion(shown: Chrome, triangle_plan: Plan) -> None:
    rows = list(csv.reader(io.StringIO(ask(shown, "cmbotReplay.csv()"))))
    names, table = rows[0], np.array([[float(cell) for cell in row[:-1]] for row in rows[1:]])
    assert names[0] == "t" and names[1:8] == [f"q{k}" for k in range(1, 8)]
    assert names[-2:] == ["clearance", "segment"]
    trajectory = triangle_plan.job.trajectory
    for order in range(3):
        motion = table[:, 1 + 7 * order : 8 + 7 * order]
        np.testing.assert_allclose(motion, trajectory.evaluate(table[:, 0], order), atol=1e-9)
    assert table[-1, 0] == pytest.approx(triangle_plan.job.duration)
    assert [rows[1][-1], rows[-1][-1]] == ["approach", "work"]
    message = json.loads(ask(shown, "cmbotReplay.ros()"))
    assert message["joint_names"] == list(triangle_plan.robot.joints)
    last = message["points"][-1]
    assert last["positions"] == pytest.approx(list(trajectory.q[-1]))
    seconds = last["time_from_start"]["sec"] + 1e-9 * last["time_from_start"]["nanosec"]
    assert seconds == pytest.approx(triangle_plan.job.duration)


def test_on_a_phone_nothing_is_wider_than_the_screen_and_the_view_scrolls_away(shown: Chrome) -> None:
    with screen(shown, 390):
        width = ask(shown, "document.documentElement.scrollWidth")
        shown.execute_script("document.getElementById('joints').scrollIntoView()")
        bottom = ask(shown, "document.getElementById('view').getBoundingClientRect().bottom")
        bar = ask(shown, "document.getElementById('bar').offsetHeight")
        # The arm fills the view: its foot and its tool are far apart in it.
        shown.find_element("id", "reset").click()
        next_frame(shown)
        spread = shown.execute_script(
            """const { stage } = cmbotReplay, part = stage.parts[0];
            const places = stage.data.focus.points.map((point) => {
                return stage.onScreen(new MeshCat.THREE.Vector3(...point), part);
            });
            const range = (k) => Math.max(...places.map((p) => p[k])) - Math.min(...places.map((p) => p[k]));
            return [range(0) / part.wide, range(1) / part.high];"""
        )
    assert width <= 390
    assert max(spread) > 0.7 and max(spread) < 1
    assert bottom < 0
    assert bar < 90


def test_both_motions_play(shown: Chrome) -> None:
    before = {arm: tool_of(shown, arm) for arm in ("planned", "baseline")}
    shown.execute_script("document.activeElement.blur(); cmbotReplay.seek(cmbotReplay.workStart)")
    shown.find_element("tag name", "body").send_keys(" ")
    reached = shown.execute_async_script(
        """const done = arguments[0];
        const moved = () => cmbotReplay.time > cmbotReplay.workStart + 1.0;
        const wait = () => (moved() ? done(cmbotReplay.playing) : requestAnimationFrame(wait));
        wait();"""
    )
    assert reached is True
    shown.find_element("tag name", "body").send_keys(" ")
    stopped = ask(shown, "cmbotReplay.time")
    next_frame(shown)
    assert ask(shown, "[cmbotReplay.time, cmbotReplay.playing]") == [stopped, False]
    for arm, start in before.items():
        assert np.linalg.norm(tool_of(shown, arm) - start) > 0.002
    shown.find_element("tag name", "body").send_keys("\ue014")  # right
    assert ask(shown, "cmbotReplay.time") == pytest.approx(stopped + 0.1)


def test_the_picture_changes_with_time_and_side_by_side_each_half_has_its_arm(shown: Chrome) -> None:
    start = picture(shown)
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 10)")
    middle = picture(shown)
    assert len(np.unique(start.reshape(-1, 3), axis=0)) > 500  # not blank
    view, plots = np.s_[200:700, 20:480], np.s_[200:700, 560:1240]
    for part, least in ((view, 1000), (plots, 200)):
        assert (np.abs(start[part] - middle[part]).max(axis=2) > 60).sum() > least
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart)")
    assert (np.abs(start - picture(shown)).max(axis=2) > 60).sum() < 50
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


@pytest.mark.parametrize("arm", ["planned", "baseline"])
def test_marks_go_with_the_bent_arm(shown: Chrome, triangle_plan: Plan, arm: str) -> None:
    """The mark of the bent tool ends where the bent arm carries the rigid arm's tool."""
    robot = triangle_plan.robot
    slide(shown, "deflection", 1)
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 5)")
    rigid, carried, bent = shown.execute_script(
        """const [arm, tool] = arguments, { marks, bending } = cmbotReplay.stage;
        const stick = marks.bent[arm], rigid = stick.to.clone().set(...tool);
        rigid.applyMatrix4(bending.drawn[arm].rigid.at(-1));
        const carried = bending.carried(arm, cmbotReplay.links.length, rigid.clone());
        return [rigid, carried, stick.to].map((point) => point.toArray());""",
        arm,
        robot.model.frames[robot.tool_frame_id].placement.translation.tolist(),
    )
    assert np.linalg.norm(np.subtract(bent, rigid)) > 5e-3
    np.testing.assert_allclose(carried, bent, atol=3e-4)


def test_deflection_is_magnified_and_small_plots_are_zoomed(shown: Chrome) -> None:
    shown.execute_script("cmbotReplay.seek(15)")
    pictures = []
    for factor in (0, 100):
        slide(shown, "deflection", factor)
        pictures.append(picture(shown)[200:720, 20:480])
    assert (np.abs(pictures[0] - pictures[1]).max(axis=2) > 60).sum() > 200
    assert shown.find_element("id", "factor").text == "× 100"
    assert shown.find_element("id", "drawn").text == ("bending drawn × 100, pale parts are no obstacles")
    slide(shown, "deflection", 0)
    assert shown.find_element("id", "drawn").text == "pale parts are no obstacles"
    before, zoomed, after = shown.execute_script(
        """const height = () => document.querySelectorAll(".small path.curve")[1].getBBox().height;
        const click = () => { document.getElementById("zoom").click(); return height(); };
        return [height(), click(), click()];"""
    )
    assert zoomed > 2 * before
    assert after == pytest.approx(before)


def test_hostile_names_are_text_and_nothing_else(
    chrome: Chrome, triangle_plan: Plan, triangle_tracking: Tracking, tmp_path: Path
) -> None:
    evil = hostile(without_shapes(triangle_plan), EVIL)
    model = evil.robot.model.copy()
    for number in range(1, model.njoints):
        model.names[number] = f"{EVIL}{number}"
    robot = replace(evil.robot, model=model)
    assert robot.joints[0].startswith(EVIL)
    path = tmp_path / "evil.html"
    # In the arm's way: nearer to it than it is to itself.
    stroke = evil.job.strokes[0]
    point = Kinematics(evil.robot).tool_poses(stroke.trajectory.evaluate([13.0 - stroke.begin]))[0][0]
    thing = Obstacle(name="thing", shape=Sphere(radius=0.02), X_WO=pose(point.tolist(), [0, 0, 0]))
    report(
        replace(
            evil,
            robot=robot,
            scene=renamed(with_obstacles(triangle_plan.scene.changed(obstacles=()), thing), EVIL, [EVIL]),
        ),
        path,
        tracking=triangle_tracking,
    )
    open_page(chrome, path)
    chrome.execute_script("cmbotReplay.seek(13)")
    require_quiet(chrome, path)  # the policy had nothing to stop either
    assert ask(chrome, "window.hacked") is None
    assert ask(chrome, "document.querySelector('h1').textContent") == EVIL
    assert chrome.find_elements("css selector", "img:not(#stills img)") == []
    joints = ask(chrome, "[...document.querySelectorAll('.joint')].map((e) => e.textContent)")
    assert joints == [f"{EVIL}{number}" for number in range(1, 8)]
    seek = "cmbotReplay.seek(13); return document.getElementById('near-label').textContent"
    assert EVIL in chrome.execute_script(seek)


def test_without_simulation_and_approach_there_is_less(
    chrome: Chrome, short_plan: Plan, tmp_path: Path
) -> None:
    path = tmp_path / "short.html"
    report(without_shapes(short_plan), path)
    open_page(chrome, path)
    require_quiet(chrome, path)
    assert ask(chrome, "[cmbotReplay.start, cmbotReplay.end]") == [0, 4]
    assert len(chrome.find_elements("css selector", ".chart:not(.small)")) == 3
    assert not chrome.find_element("id", "charts-tracking").is_displayed()
    # One of them says what holds.
    assert len(chrome.find_elements("css selector", ".card")) == 6


def test_it_is_dark_where_the_system_is(shown: Chrome) -> None:
    light = picture(shown)
    with media(shown, features=[{"name": "prefers-color-scheme", "value": "dark"}]):
        dark, readable = picture(shown), contrast(shown)
        # Paths glow there, so that they are seen before the dark background.
        glow = ask(shown, "cmbotReplay.stage.node('path').children[0].material.emissive.toArray()")
        assert max(glow) > 0.3
    assert light.mean() > 190
    assert dark.mean() < 80
    assert min(readable, contrast(shown)) > 4.5


def contrast(chrome: Chrome) -> float:
    """Smallest contrast (WCAG 2) of a colour of text with the paper."""
    names = ("ink", "faint", "planned-ink", "baseline", "bad", "good", "paper")
    script = """const style = getComputedStyle(document.documentElement);
        return arguments[0].map((name) => style.getPropertyValue(`--${name}`).trim());"""
    rgb = np.array([ImageColor.getrgb(colour) for colour in chrome.execute_script(script, names)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    *texts, paper = linear @ [0.2126, 0.7152, 0.0722]
    return min((max(text, paper) + 0.05) / (min(text, paper) + 0.05) for text in texts)


def test_the_printed_page_is_still_and_shows_every_plot(shown: Chrome) -> None:
    shown.execute_script("cmbotReplay.seek(17)")
    pdf = base64.b64decode(shown.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})["data"])
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 10
    stills = ask(shown, "[...document.querySelectorAll('#stills img')].map((i) => i.src)")
    assert len(stills) == 4 == len(set(stills))  # the ends of the legs
    assert len(np.unique(pixels(stills[0]).reshape(-1, 4), axis=0)) > 300
    assert ask(shown, "cmbotReplay.time") == 17
    with media(shown, media="print"):
        hidden = shown.execute_script(
            """const seen = (name) => document.querySelector(name).getBoundingClientRect().height > 0;
            const kept = [...document.querySelectorAll("svg, .part, #stills")];
            const there = kept.every((element) => element.getBoundingClientRect().height > 20);
            return [["#bar", "#view", "#save", "footer"].filter(seen), there];"""
        )
    assert hidden == [[], True]
    # Nothing but a long table is parted, and what must not be parted is shorter than a page of A4.
    with screen(shown, 703), printing(shown), media(shown, media="print"):  # 186 mm
        kept = shown.execute_script(
            """const names = ".card, .chart, #stills, #joints, .part:not(.long)";
            const kept = [...document.querySelectorAll(names)];
            return kept.map((one) => {
                return [getComputedStyle(one).breakInside, one.getBoundingClientRect().height];
            });"""
        )
        parted = ask(
            shown, "[...document.querySelectorAll('.part.long h2')].map((heading) => heading.textContent)"
        )
    assert {how for how, _ in kept} == {"avoid"}
    assert max(height for _, height in kept) < 273 / 25.4 * 96
    assert parted == ["Simulation"]


@pytest.mark.parametrize("width", [1280, 1024, 390, 320])
def test_nothing_is_written_over_curves_cards_and_controls(shown: Chrome, width: int) -> None:
    with screen(shown, width):
        overlaps, spilling, beyond, covered = shown.execute_script(
            """const box = (element) => element.getBoundingClientRect();
            const all = (names, where = document) => [...where.querySelectorAll(names)];
            const meets = (a, b) => a.left < b.right && b.left < a.right
                && a.top < b.bottom - 2 && b.top < a.bottom - 2;
            const overlaps = all(".small svg").filter((svg) => {
                const texts = all(".corner", svg).map(box);
                const frame = box(svg.querySelector(".frame")), whole = box(svg);
                const out = texts.some(({ left, right }) => left < whole.left - 1 || right > whole.right + 1);
                return out || texts.some((text) => meets(text, frame)) || meets(texts[0], texts[2]);
            });
            const spills = ({scrollWidth, clientWidth}) => clientWidth > 0 && scrollWidth > clientWidth;
            const reaches = (card) => Math.max(...all("*", card).map((part) => {
                return box(part).right - box(card).right;
            }));
            const covered = all("#bar button, #bar select, #bar input").filter((control) => {
                const { x, y, width, height } = box(control);
                if (width === 0) return false;
                return document.elementFromPoint(x + width / 2, y + height / 2) !== control;
            });
            return [overlaps.map((svg) => svg.getAttribute("aria-label")),
                all(".card, .card *").filter(spills).map((part) => part.textContent),
                Math.max(...all(".card").map(reaches)), covered.map((control) => control.id)];"""
        )
    assert (overlaps, spilling, covered) == ([], [], [])
    assert beyond < -8


def test_a_levels_name_is_not_struck_through_by_a_curve_of_few_points(shown: Chrome) -> None:
    t, y = pack(np.array([0.0, 10.0])), pack(np.array([1.08, 1.08]))  # a straight line just above the level
    curve = {"motion": "planned", "thin": False, "t": t, "y": y, "starts": []}
    spec = {"title": "line", "unit": "Nm", "digits": 1, "axis": [0, 2], "bounds": [None, None]}
    spec |= {"curves": [curve], "marks": [[1, "a level's name"]], "free": ""}
    timeline = {"start": 0, "workStart": 0, "workEnd": 10, "end": 10, "legTimes": [], "moves": []}
    level, name = shown.execute_script(
        """const chart = new Chart(arguments[0], arguments[1], () => {});
        document.body.append(chart.figure);
        chart.draw(600);
        const at = (kind) => Number(chart.svg.querySelector(kind[0]).getAttribute(kind[1]));
        const found = [[".mark", "y1"], [".mark-name", "y"]].map(at);
        chart.figure.remove();
        return found;""",
        spec,
        timeline,
    )
    assert name > level + 8  # below it, where no curve is


@pytest.mark.parametrize("size", [(1280, 2000), (1000, 1100)])
def test_a_window_taller_than_wide_has_the_view_above_the_plots(shown: Chrome, size: tuple[int, int]) -> None:
    with screen(shown, *size):
        view, plots = (shown.find_element("id", name).rect for name in ("view", "plots"))
    assert view["width"] == pytest.approx(plots["width"], abs=2)
    assert 0.4 * view["width"] < view["height"] < 0.75 * view["width"]
    assert view["y"] + view["height"] <= plots["y"]


@pytest.mark.parametrize("width", [1280, 390])
def test_tables_keep_words_whole_and_say_that_they_scroll(shown: Chrome, width: int) -> None:
    with screen(shown, width):
        next_frame(shown)
        broken, wider, marked = shown.execute_script(
            """const tables = [...document.querySelectorAll(".part .table")];
            // A word that is broken stands on several lines.
            const lines = (node, from, to) => {
                const range = document.createRange();
                range.setStart(node, from);
                range.setEnd(node, to);
                return new Set([...range.getClientRects()].map(({ top }) => Math.round(top))).size;
            };
            const cells = tables.flatMap((table) => [...table.querySelectorAll("th, td")]);
            const broken = cells.flatMap((cell) => {
                const node = cell.firstChild, words = node ? [...node.data.matchAll(/[A-Za-z]{3,}/g)] : [];
                return words.filter(({ 0: word, index }) => lines(node, index, index + word.length) > 1)
                    .map(([word]) => word);
            });
            const wider = tables.filter((table) => table.scrollWidth > table.clientWidth + 1);
            return [broken, wider.length, wider.filter((table) => table.matches(".sideways")).length];"""
        )
    assert broken == []
    assert marked == wider
    assert (wider > 0) == (width == 390)


def test_a_narrow_window_prints_as_a_wide_one(shown: Chrome) -> None:
    printed = []
    for width in (1280, 390):
        with screen(shown, width):
            before = view_and_plots(shown)
            with printing(shown):
                stills = shown.execute_script(
                    """const stills = [...document.querySelectorAll("#stills img")];
                    return Promise.all(stills.map((image) => image.decode())).then(
                        () => stills.map((image) => [image.naturalWidth, image.naturalHeight]));"""
                )
                printed.append([stills, view_and_plots(shown)[1:]])
            next_frame(shown)
            assert view_and_plots(shown) == before
    assert printed[0] == printed[1]
    assert all(0.7 < wide / high < 1.4 for wide, high in printed[0][0])


def view_and_plots(chrome: Chrome) -> list[object]:
    """Size of the view, px, and what the plots are drawn for."""
    return chrome.execute_script(
        """const view = document.getElementById("view");
        const boxes = [...document.querySelectorAll("svg")].map((svg) => svg.getAttribute("viewBox"));
        return [[view.clientWidth, view.clientHeight], boxes];"""
    )


@contextmanager
def media(chrome: Chrome, **settings: object) -> Iterator[None]:
    """Emulate a medium or its features for a while."""
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", settings)
    try:
        yield
    finally:
        chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "", "features": []})


@contextmanager
def printing(chrome: Chrome) -> Iterator[None]:
    """Prepare the page for the printer for a while."""
    chrome.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    try:
        yield
    finally:
        chrome.execute_script("window.dispatchEvent(new Event('afterprint'))")


def test_without_webgl_the_plots_are_drawn_and_follow(chrome: Chrome, report_file: Path) -> None:
    drawn = "[...document.querySelectorAll('path.curve')].map((path) => path.getTotalLength())"
    open_page(chrome, report_file)
    with_view = ask(chrome, drawn)
    with without_webgl(chrome):
        open_page(chrome, report_file)
        assert "It needs a browser with WebGL." in chrome.find_element("id", "view").text
        assert len(ask(chrome, drawn)) == len(with_view) > 50
        assert min(ask(chrome, drawn)) > 20
        before = cursors(chrome)
        plot = chrome.find_element("css selector", "#charts-torque svg")
        chrome.execute_script("arguments[0].scrollIntoView({block: 'center'})", plot)
        ActionChains(chrome, duration=0).move_to_element_with_offset(plot, 100, 0).click().perform()
        assert (cursors(chrome) != before).all()
        chrome.execute_script("document.querySelector('.joint').click()")
        assert len(ask(chrome, drawn)) > len(with_view)


def test_a_free_move_that_was_simulated_is_not_said_not_to_be(
    chrome: Chrome, strokes_plan: Plan, strokes_tracking: Tracking, tmp_path: Path
) -> None:
    """Approach and return are not; between the strokes there is a sag, but no path to be off."""
    path = tmp_path / "strokes.html"
    report(strokes_plan, path, tracking=strokes_tracking)
    words = """return [...document.querySelectorAll("#charts-tracking svg")].map((svg) => {
        const texts = [...svg.querySelectorAll("text")].map((text) => text.textContent);
        return ["not simulated", "no tool path"].map((why) => texts.filter((text) => text === why).length);
    })"""
    with screen(chrome, width=3600):  # with room for the words
        open_page(chrome, path)
        said = chrome.execute_script(words)
    assert (said[0], said[3], said[4]) == ([2, 0], [0, 3], [2, 0])
