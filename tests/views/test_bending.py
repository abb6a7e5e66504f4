"""The arm and its guardrail as the pages bend them: chain, elastic coordinates, the shapes of the frame."""

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import ask, open_page, slide
from page_data import data_of, floats
from selenium.webdriver import Chrome

from cmbot.elastic.base import elastic_base, guardrail_frame
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, bending_arm
from cmbot.simulation import Tracking
from cmbot.views import replay_page
from cmbot.views.drawing import Bending
from cmbot.views.replay_data import replay_data


@pytest.fixture(scope="module")
def data(triangle_plan: Plan, triangle_tracking: Tracking) -> dict[str, Any]:
    return replay_data(triangle_plan, triangle_tracking)


def ends(source: dict[str, Any], q: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
    """Frames (4, 4) of the ends of all links, along the page's chain."""
    frames, last = [], pin.SE3.Identity()
    for joint in source["joints"]:
        value = (q if joint["driven"] else u)[joint["index"]]
        last = last * pin.XYZQUATToSE3(np.array(joint["pose"])) * pin.exp6(np.array(joint["axis"]) * value)
        frames.append(last)
    return [
        (frames[link["end"]] * pin.XYZQUATToSE3(np.array(link["pose"]))).homogeneous
        for link in source["links"]
    ]


def tool_along(data: dict[str, Any], plan: Plan, motion: dict[str, Any], frames: range) -> np.ndarray:
    q, u = floats(motion["q"], plan.robot.dof), floats(motion["u"])
    u = u.reshape(len(q), -1)
    tool = plan.robot.model.frames[plan.robot.tool_frame_id].placement.homogeneous
    return np.array([(ends(data["bending"], q[k], u[k])[-1] @ tool)[:3, 3] for k in frames])


def test_the_chain_without_bending_is_the_rigid_arm(data: dict[str, Any], triangle_plan: Plan) -> None:
    model, made = triangle_plan.robot.model, triangle_plan.robot.model.createData()
    q = triangle_plan.samples.q[300]
    pin.forwardKinematics(model, made, q)
    u = np.zeros(sum(not joint["driven"] for joint in data["bending"]["joints"]))
    for frame, rigid in zip(ends(data["bending"], q, u), list(made.oMi)[1:], strict=True):
        np.testing.assert_allclose(frame, rigid.homogeneous, atol=1e-9)


def test_the_bent_tool_is_where_the_simulation_has_it(
    data: dict[str, Any], triangle_plan: Plan, triangle_tracking: Tracking
) -> None:
    frames = range(0, 1001, 50)
    times = np.linspace(0, data["workEnd"] - data["workStart"], 1001)
    for name, tracking in triangle_tracking.motions:
        error = np.stack([np.interp(times, tracking.t, e) for e in tracking.error.T], axis=1)
        expected = floats(data[name]["tool"], 3) + error
        bent = tool_along(data, triangle_plan, data[name], frames)
        assert np.linalg.norm(error, axis=1).max() > 8e-3
        np.testing.assert_allclose(bent, expected[list(frames)], atol=4e-5)
    # After the stop it swings.
    rest = tool_along(data, triangle_plan, data["rest"]["baseline"], range(0, 100, 5))
    assert np.ptp(rest, axis=0).max() > 1e-4


def test_free_moves_and_plans_without_simulation_sag_at_rest(strokes_plan: Plan) -> None:
    data = replay_data(strokes_plan)
    assert not data["bending"]["simulated"]
    for name, arm in (
        ("approach", bending_arm(strokes_plan.scene, strokes_plan.robot.tool_off)),
        ("", bending_arm(strokes_plan.scene, strokes_plan.robot)),
    ):
        motion = (data[name] if name else data)["planned"]
        q = floats(motion["q"], strokes_plan.robot.dof)
        u = floats(motion["u"]).reshape(len(q), -1)
        expected, _, _ = Sag(arm).equilibria(q[:1])
        np.testing.assert_allclose(u[:1], expected, atol=1e-6)
    # Between the strokes the tool is off: there is no process force.
    begin, moves = data["workStart"], data["moves"]
    times = np.linspace(0, data["workEnd"] - begin, len(q))
    k = int(np.argmin(np.abs(times - (np.mean(moves[0][1:]) - begin))))
    off, _, _ = Sag(bending_arm(strokes_plan.scene, strokes_plan.robot.tool_off)).equilibria(q[[k]])
    np.testing.assert_allclose(u[[k]], off, atol=2e-5)


def test_loads_are_shares_of_the_joints_bounds(data: dict[str, Any], triangle_plan: Plan) -> None:
    load = floats(data["planned"]["load"], triangle_plan.robot.dof)
    assert load.max() == pytest.approx(triangle_plan.figures.limit_use.torque, rel=1e-3)


def test_the_rails_move_with_the_foot_and_not_where_they_are_held(triangle_plan: Plan) -> None:
    frame, (foot,) = guardrail_frame(triangle_plan.scene.guardrail)
    shapes = frame.shapes(foot)
    np.testing.assert_allclose(shapes[foot], np.eye(6), atol=1e-9)
    assert not shapes[list(frame.fixed)].any()
    # The springs at the foot store the energy of the whole frame.
    u = np.array([1e-3, 2e-3, -1e-3, 1e-3, -2e-3, 3e-3])
    moved = np.concatenate([shapes[k] @ u for k in range(len(frame.nodes)) if k not in frame.fixed])
    stored = moved @ (frame.stiffness @ moved)
    assert stored == pytest.approx(u @ elastic_base(triangle_plan.scene.guardrail).stiffness @ u, rel=1e-9)


@pytest.mark.browser
def test_the_page_bends_arm_and_rails(
    chrome: Chrome, replay_file: Any, triangle_plan: Plan, data: dict[str, Any]
) -> None:
    if chrome.current_url != replay_file.as_uri():
        open_page(chrome, replay_file)
    plain = data_of(replay_page(triangle_plan))
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.seek(cmbotReplay.workStart)")
    q = floats(plain["planned"]["q"], 7)
    u = floats(plain["planned"]["u"]).reshape(len(q), -1)
    rails = """return (() => {
        const found = [];
        cmbotReplay.stage.node("rails").traverse((mesh) => {
            if (mesh.geometry) found.push(...mesh.geometry.attributes.position.array);
        });
        return found;
    })()"""
    places = {}
    for factor in (0, 50, 0):
        slide(chrome, "deflection", factor)
        pose = np.reshape(ask(chrome, "cmbotReplay.pose('link_7')"), (4, 4))
        np.testing.assert_allclose(pose, ends(plain["bending"], q[0], factor * u[0])[-1], atol=1e-3)
        places[factor] = np.reshape(chrome.execute_script(rails), (-1, 3))
    moved = np.linalg.norm(places[50] - places[0], axis=1)
    assert 0.05 < moved.max() < 1.0
    assert moved.min() < 1e-6  # where the posts are held
    slide(chrome, "deflection", 10)


def choose_colours(chrome: Chrome, kind: str) -> None:
    chrome.execute_script(
        """const colours = document.getElementById("colours");
        colours.value = arguments[0];
        colours.dispatchEvent(new Event("change"));""",
        kind,
    )


@pytest.mark.browser
def test_colours_say_what_links_and_rails_bear(chrome: Chrome, replay_file: Any, triangle_plan: Plan) -> None:
    if chrome.current_url != replay_file.as_uri():
        open_page(chrome, replay_file)
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.seek(cmbotReplay.workStart)")
    own = ask(chrome, "cmbotReplay.stage.colours.parts.map((part) => part.mesh.material.color.getHex())")
    choose_colours(chrome, "load")
    last = "cmbotReplay.stage.colours.parts.find((part) => part.link === 6)"
    red, green, blue = ask(chrome, f"{last}.mesh.material.color.toArray()")
    assert green > max(red, blue)  # the last joint bears next to nothing
    assert "100 %" in chrome.find_element("id", "legend").text

    choose_colours(chrome, "strain")
    bending = Bending.of(triangle_plan, None)
    assert bending is not None
    first = floats(data_of(replay_page(triangle_plan))["planned"]["u"])
    u = bending.coordinates(np.zeros(1), triangle_plan.samples.q[:1])
    assert u[0] == pytest.approx(first[: u.shape[1]], abs=1e-6)
    largest = bending.largest_strain(u)
    assert ask(chrome, "cmbotReplay.stage.colours.largest") == pytest.approx(largest, rel=1e-4)
    assert f"largest now {1e6 * largest:.0f} µε" in chrome.find_element("id", "legend").text
    # The darkest vertex of the rails is at the foot, where they bend most; the last link does not bend.
    darkest, colour = ask(
        chrome,
        """(() => {
            const { mesh, colours } = cmbotReplay.stage.colours.parts.find((part) => part.link === null);
            const { array } = mesh.geometry.attributes.position;
            const sums = Array.from(colours, (red, k) => (k % 3 ? 9 : red + colours[k + 1] + colours[k + 2]));
            const k = sums.indexOf(Math.min(...sums));
            return [[array[k], array[k + 2]], Array.from(colours.slice(k, k + 3))];
        })()""",
    )
    assert np.linalg.norm(darkest) < 0.3
    assert colour[0] > 2 * colour[2]
    assert not ask(chrome, f"{last}.mesh.material.vertexColors")
    choose_colours(chrome, "own")
    assert (
        ask(chrome, "cmbotReplay.stage.colours.parts.map((part) => part.mesh.material.color.getHex())") == own
    )
    assert not chrome.find_element("id", "legend").is_displayed()
