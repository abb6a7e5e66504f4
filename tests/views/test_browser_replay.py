"""The replay page in a browser without a network: it shows the plan, at any time, and nothing else runs."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from browser import ask, next_frame, open_page, pixels, require_quiet, screen, shows, slide, without_webgl
from page_data import without_shapes
from plan_folders import without_approach
from selenium.webdriver import Chrome

from cmbot.collision import Clearances
from cmbot.planning import Plan
from cmbot.robot import Dynamics, Robot
from cmbot.views import replay

pytestmark = pytest.mark.browser


@pytest.fixture
def shown(chrome: Chrome, replay_file: Path) -> Chrome:
    """The browser with the page open at the work's beginning, paused."""
    if not shows(chrome, replay_file):
        open_page(chrome, replay_file)
    slide(chrome, "deflection", 0)  # the rigid arm
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.seek(cmbotReplay.workStart)")
    return chrome


def drawn_pose(chrome: Chrome, link: str, arm: str) -> np.ndarray:
    return np.reshape(chrome.execute_script("return cmbotReplay.pose(...arguments)", link, arm), (4, 4))


def test_it_opens_without_an_error_and_asks_for_nothing_but_itself(shown: Chrome, replay_file: Path) -> None:
    require_quiet(shown, replay_file)


def test_its_policy_forbids_connections(shown: Chrome) -> None:
    for address in ("http://127.0.0.1:9/x", "ws://127.0.0.1:9/x"):
        blocked = shown.execute_async_script(
            """const [address, done] = arguments;
            const report = (event) => done(event.effectiveDirective);
            document.addEventListener("securitypolicyviolation", report, {once: true});
            address.startsWith("ws") ? new WebSocket(address) : fetch(address).catch(() => {});""",
            address,
        )
        assert blocked == "connect-src"
    shown.get_log("browser")


@pytest.mark.parametrize("time", [0.0, 3.333, 10.0, 16.87, 20.0])
def test_the_arms_are_drawn_where_the_kinematics_puts_them(
    shown: Chrome, triangle_plan: Plan, time: float
) -> None:
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart + arguments[0])", time)
    baseline = triangle_plan.baseline.samples
    postures = {
        "planned": triangle_plan.trajectory.evaluate(np.array([time]), 0)[0],
        "baseline": np.array([np.interp(time, baseline.t, q) for q in baseline.q.T]),
    }
    require_drawn(shown, triangle_plan.robot, postures)


def require_drawn(shown: Chrome, robot: Robot, postures: dict[str, np.ndarray]) -> None:
    model, data = robot.model, robot.model.createData()
    for arm, q in postures.items():
        pin.forwardKinematics(model, data, q)
        for joint, link in enumerate(ask(shown, "cmbotReplay.links"), start=1):
            X_WL = data.oMi[model.frames[model.getFrameId(link)].parentJoint].homogeneous
            np.testing.assert_allclose(data.oMi[joint].homogeneous, X_WL)
            np.testing.assert_allclose(drawn_pose(shown, link, arm), X_WL, atol=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_approach_is_before_the_work(shown: Chrome, triangle_plan: Plan, share: float) -> None:
    approach = triangle_plan.approach
    assert ask(shown, "[cmbotReplay.start, cmbotReplay.workStart]") == [0, approach.duration]
    now = np.array([share * approach.duration])
    shown.execute_script("cmbotReplay.seek(arguments[0])", now[0])
    q = approach.trajectory.evaluate(now, 0)
    first = triangle_plan.scene.posture
    require_drawn(shown, triangle_plan.robot, {"planned": q[0] if share else first, "baseline": first})
    v, a = (approach.trajectory.evaluate(now, order) for order in (1, 2))
    torque = np.linalg.norm(Dynamics(triangle_plan.robot).efforts(q, v, a).guardrail_torque[0])
    assert number(shown, "planned-torque") == pytest.approx(torque, abs=0.2)
    clearances = Clearances(triangle_plan.robot, triangle_plan.scene.all_obstacles)
    distance = clearances.query(q).distance[0]
    assert number(shown, "planned-clearance") == pytest.approx(1e3 * distance, abs=0.2)
    for name, figures in (
        ("planned", triangle_plan.job.figures),
        ("baseline", triangle_plan.baseline.job_figures),
    ):
        assert number(shown, f"{name}-peak") == pytest.approx(figures.peak_guardrail_torque, abs=0.06)
        assert number(shown, f"{name}-closest") == pytest.approx(1e3 * figures.min_clearance, abs=0.06)
    assert "approach, tool off" in shown.find_element("id", "subtitle").text
    assert shown.find_element("id", "time").text == f"{now[0]:.2f} / {approach.duration + 20:.2f} s"


def number(shown: Chrome, cell: str) -> float:
    return float(shown.find_element("id", cell).text.split()[0])


def plotted(chrome: Chrome) -> np.ndarray:
    """The plot's pixels (height, width, 4) with the time at its end."""
    script = "cmbotReplay.seek(cmbotReplay.end); return document.getElementById('plot').toDataURL()"
    with screen(chrome, scale=1):
        return pixels(chrome.execute_script(script))


def test_the_plot_shades_the_approach_and_draws_the_floor(
    chrome: Chrome, replay_file: Path, triangle_plan: Plan, tmp_path: Path
) -> None:
    bare, plots = without_shapes(triangle_plan), []
    for floor in (triangle_plan.objective.floor, None):
        path = tmp_path / f"{len(plots)}.html"
        replay(replace(without_approach(bare), objective=replace(bare.objective, floor=floor)), path)
        open_page(chrome, path)
        assert ask(chrome, "[cmbotReplay.start, cmbotReplay.workStart, cmbotReplay.time]") == [0, 0, 0]
        plots.append(plotted(chrome))
    assert (plots[0] != plots[1]).any(axis=(0, 2)).mean() > 0.4  # dashes all along
    assert not plots[1][0, 20].any()
    open_page(chrome, replay_file)
    begin, end, time = ask(chrome, "[cmbotReplay.workStart, cmbotReplay.end, cmbotReplay.time]")
    assert time == begin > 0
    top = plotted(chrome)[0]
    assert top[20, 3] == 255
    assert (top == top[20]).all(axis=1).mean() == pytest.approx(begin / end, abs=0.02)


def test_the_baseline_has_no_torque_on_the_approach(shown: Chrome) -> None:
    plot, (begin, end) = plotted(shown), ask(shown, "[cmbotReplay.workStart, cmbotReplay.end]")
    border = round(begin / end * (plot.shape[1] - 16)) + 8
    red, blue = plot[..., 0], plot[..., 2]
    # Where something is drawn in the baseline's blue, and in the planned motion's orange.
    baseline, planned = ((colour > 100).any(axis=0) for colour in (blue - red, red - blue))
    assert not baseline[12 : border - 4].any()
    assert planned[12 : border - 4].mean() > 0.95
    assert planned[border + 4 : -12].mean() > 0.8
    # Where both ask the same the planned motion's curve lies on the baseline's.
    drawn = np.flatnonzero(baseline[:-12])
    assert border - 4 <= drawn[0] <= border + 8
    assert drawn[-1] >= len(baseline) - 24


def test_the_numbers_are_those_of_the_plan(shown: Chrome, triangle_plan: Plan) -> None:
    samples, figures = triangle_plan.samples, triangle_plan.job.figures
    shown.execute_script("cmbotReplay.seek(cmbotReplay.workStart + 8)")
    texts = {
        key: shown.find_element("id", f"planned-{key}").text
        for key in ("torque", "peak", "clearance", "closest")
    }
    k = int(np.argmin(np.abs(samples.t - 8.0)))
    assert texts == {
        "torque": f"{np.linalg.norm(samples.guardrail_torque[k]):.1f} Nm",
        "peak": f"{figures.peak_guardrail_torque:.1f} Nm",
        "clearance": f"{1e3 * samples.clearance[k]:.1f} mm",
        "closest": f"{1e3 * figures.min_clearance:.1f} mm",
    }
    begin = triangle_plan.approach.duration
    assert shown.find_element("id", "time").text == f"{begin + 8:.2f} / {begin + 20:.2f} s"
    peak = triangle_plan.baseline.figures.peak_guardrail_torque
    assert shown.find_element("id", "baseline-peak").text == f"{peak:.1f} Nm"


def test_it_plays_pauses_stops_at_the_end_and_starts_anew_from_there(shown: Chrome) -> None:
    reached = shown.execute_async_script(
        """const done = arguments[0];
        cmbotReplay.seek(cmbotReplay.workStart - 0.1), document.getElementById("play").click();
        const moved = () => cmbotReplay.time > cmbotReplay.workStart + 0.05;
        const wait = () => (moved() ? done(cmbotReplay.playing) : requestAnimationFrame(wait));
        wait();"""
    )
    assert reached is True
    shown.find_element("id", "play").click()
    stopped = ask(shown, "cmbotReplay.time")
    next_frame(shown)
    assert ask(shown, "[cmbotReplay.time, cmbotReplay.playing]") == [stopped, False]
    ended = shown.execute_async_script(
        """const done = arguments[0];
        cmbotReplay.seek(cmbotReplay.end - 0.02);
        cmbotReplay.play();
        const wait = () => (cmbotReplay.playing ? requestAnimationFrame(wait) : done(cmbotReplay.time));
        wait();"""
    )
    assert ended == ask(shown, "cmbotReplay.end")
    assert shown.execute_script("cmbotReplay.play(); return cmbotReplay.time") == 0


def test_keys_slider_and_seeking(shown: Chrome) -> None:
    def time() -> float:
        return ask(shown, "cmbotReplay.time")

    shown.execute_script("document.activeElement.blur(); cmbotReplay.seek(5)")
    body = shown.find_element("tag name", "body")
    start, end = ask(shown, "[cmbotReplay.start, cmbotReplay.end]")
    body.send_keys("\ue014")  # right
    assert time() == pytest.approx(5.1)
    body.send_keys("\ue008\ue012")  # shift, left
    assert time() == pytest.approx(4.1)
    body.send_keys("\ue010")  # end
    assert time() == end
    body.send_keys("\ue011")  # home
    assert time() == start == 0
    for playing in (True, False):
        body.send_keys(" ")
        assert ask(shown, "cmbotReplay.playing") is playing
    slide(shown, "scrub", 7.25)
    assert time() == pytest.approx(7.25)
    # Within the ends, whatever is asked for.
    for asked, reached in (("-1e9", start), ("1e9", end), ("NaN", 0.0), ("'x'", 0.0)):
        shown.execute_script(f"cmbotReplay.pause(); cmbotReplay.seek(0); cmbotReplay.seek({asked})")
        assert time() == reached


def test_backs_of_triangles_are_drawn_behind_fronts(shown: Chrome) -> None:
    """Without a ghost, which has its own materials: each front has one back, of the same shape."""
    front, back, offset, alike = shown.execute_script(
        """const found = { 0: [], 1: [], 2: [] };
        for (const name of ["robot", "rails"]) {
            cmbotReplay.stage.node(name).traverse((mesh) => {
                if (mesh.geometry) found[mesh.material.side].push(mesh);
            });
        }
        const shapes = (meshes) => new Set(meshes.map(({ geometry }) => geometry.uuid));
        const [fronts, backs] = [shapes(found[0]), shapes(found[1])];
        return [found[0].length, found[1].length, found[1].every(({ material }) => material.polygonOffset),
            found[2].length === 0 && fronts.symmetricDifference(backs).size === 0];"""
    )
    assert front == back > 10
    assert offset and alike


@pytest.mark.parametrize("how", ["ghost", "beside"])
@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_card_and_bar_cover_nothing_of_what_is_shown(shown: Chrome, size: tuple[int, int], how: str) -> None:
    with screen(shown, *size):
        shown.execute_script("cmbotReplay.compare(arguments[0]); cmbotReplay.resetView()", how)
        parts, covers = shown.execute_script(
            """const { stage } = cmbotReplay, { onDrawn } = stage, parts = [];
            stage.onDrawn = (part) => parts.push(stage.data.focus.points.map((point) =>
                stage.onScreen(new MeshCat.THREE.Vector3(...point), part)));
            cmbotReplay.draw();
            stage.onDrawn = onDrawn;
            const box = (id) => document.getElementById(id).getBoundingClientRect();
            const edges = ({ left, right, top, bottom }) => [left, right, top, bottom];
            return [parts, ["card", "bar"].map(box).map(edges)];"""
        )
    shown.execute_script("cmbotReplay.compare('ghost')")
    assert len(parts) == (2 if how == "beside" else 1)
    points = np.concatenate(parts)
    assert (points > 0).all() and (points < size).all()
    for left, right, top, bottom in covers:
        x, y = points.T
        assert not ((x > left) & (x < right) & (y > top) & (y < bottom)).any()
    # As large as that allows.
    assert max(np.ptp(parts[0], axis=0) / size) > 0.25


def test_the_address_keeps_time_and_view(shown: Chrome, replay_file: Path) -> None:
    """Who opens it sees the same; without a view of one's own it is fitted to the window."""
    wait = "setTimeout(arguments[0], 350)"  # until time and view rest
    shown.execute_script("cmbotReplay.resetView(); cmbotReplay.seek(3.25)")
    shown.execute_async_script(wait)
    assert shown.current_url == f"{replay_file.as_uri()}#3.25"
    shown.execute_script("cmbotReplay.stage.turn(0.4, 0.1)")
    shown.execute_async_script(wait)
    address, camera = shown.current_url, ask(shown, "cmbotReplay.camera")
    shown.execute_script("cmbotReplay.resetView(); cmbotReplay.seek(cmbotReplay.workStart)")
    assert ask(shown, "cmbotReplay.camera") != pytest.approx(camera, abs=0.05)
    shown.execute_async_script(wait)
    assert shown.current_url == replay_file.as_uri()
    shown.execute_script("window.location.hash = arguments[0]", address.partition("#")[2])
    shown.execute_async_script(wait)
    assert ask(shown, "cmbotReplay.time") == 3.25
    assert ask(shown, "cmbotReplay.camera") == pytest.approx(camera, abs=2e-3)
    shown.execute_script("cmbotReplay.resetView()")


def test_keys_are_listed_and_one_hides_what_is_no_obstacle(shown: Chrome) -> None:
    body, around = shown.find_element("tag name", "body"), "cmbotReplay.stage.node('around').visible"
    assert not shown.find_element("id", "help").is_displayed()
    body.send_keys("?")
    assert "hide or show what is no obstacle" in shown.find_element("id", "help").text
    for visible in (False, True):
        body.send_keys("b")
        assert ask(shown, around) is visible
    body.send_keys("?")
    assert not shown.find_element("id", "help").is_displayed()


def test_what_takes_long_is_played_faster_at_first(chrome: Chrome, replay_file: Path) -> None:
    open_page(chrome, replay_file)
    speeds = "return [20, 120, 121, 1395, 4000, 1e6].map(speedFor)"
    assert chrome.execute_script(speeds) == [1, 1, 2, 30, 100, 100]
    offered = "[...document.querySelectorAll('#speed option')].map((option) => Number(option.value))"
    assert ask(chrome, offered) == [0.25, 0.5, 1, 2, 4]
    assert ask(chrome, "document.getElementById('speed').value") == "1"


def test_without_webgl_the_torque_is_drawn(chrome: Chrome, replay_file: Path) -> None:
    with without_webgl(chrome):
        open_page(chrome, replay_file)
        told = chrome.find_element("id", "failure").text
        assert re.fullmatch(r"The 3-D view cannot be shown: .*[^.]\. It needs a browser with WebGL\.", told)
        assert len(np.unique(pixels(ask(chrome, "document.getElementById('plot').toDataURL()")))) > 20
    open_page(chrome, replay_file)
    require_quiet(chrome, replay_file)
