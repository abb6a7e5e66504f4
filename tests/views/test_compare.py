"""Several plans on one page, with and without a browser."""

import base64
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import umsgpack
from browser import ask, open_page, require_quiet, shows, slide
from command_line import output, refusal
from obstacle_entries import with_obstacles
from page_data import data_of, floats, without_shapes
from selenium.webdriver import Chrome
from small_scenes import short_scene

from cmbot.archive import save
from cmbot.collision import Box, Obstacle
from cmbot.common.errors import InputError
from cmbot.common.poses import pose
from cmbot.elastic import elastic_base
from cmbot.planning import Plan, held_guardrail, robot_of
from cmbot.scene import IdentifiedStiffness
from cmbot.simulation import Tracking
from cmbot.views import compare_page, unlike


@pytest.fixture(scope="module")
def text(short_plan: Plan, strokes_plan: Plan) -> str:
    return compare_page({"<short>": without_shapes(short_plan), "strokes": without_shapes(strokes_plan)})


def test_each_plan_is_a_motion_on_its_jobs_clock(text: str, short_plan: Plan, strokes_plan: Plan) -> None:
    data = data_of(text)
    assert (data["motions"], data["end"]) == (["planned", "plan_2"], strokes_plan.job.duration)
    for key, plan in (("planned", short_plan), ("plan_2", strokes_plan)):
        poses = floats(data[key]["poses"], 7, 7)
        times = np.linspace(0, data["end"], len(poses))
        q = plan.job.trajectory.evaluate(np.minimum(times, plan.job.duration), 0)
        made = plan.robot.model.createData()
        for k in range(0, len(poses), 200):
            pin.forwardKinematics(plan.robot.model, made, q[k])
            np.testing.assert_allclose(poses[k, -1, :3], made.oMi[plan.robot.dof].translation, atol=1e-3)
    torque = data["charts"][0]["curves"]
    assert [curve["motion"] for curve in torque] == ["plan_2", "planned"]  # the first is drawn last
    peak = strokes_plan.job.figures.peak_guardrail_torque
    assert floats(torque[0]["y"]).max() == pytest.approx(peak, rel=1e-3)


def test_verdicts_and_figures_stand_side_by_side(text: str, short_plan: Plan, strokes_plan: Plan) -> None:
    assert " open><summary><b>&lt;short&gt;.</b> Every promise is kept" in text
    row = re.search(r"<th[^>]*>peak torque at work, Nm</th>(.*?)</tr>", text)
    assert row is not None
    values = [float(value) for value in re.findall(r">([\d.]+)<", row[1])]
    peaks = [plan.figures.peak_guardrail_torque for plan in (short_plan, strokes_plan)]
    assert values == pytest.approx(peaks, abs=0.01)


def test_cards_say_which_plan_is_ahead(text: str, short_plan: Plan, strokes_plan: Plan) -> None:
    seconds = [plan.job.duration for plan in (short_plan, strokes_plan)]
    card = re.search(r"<h2>Time of the whole job</h2><p>(.*?) s</p><p>(.*?)</p>", text)
    assert card is not None
    shown = re.findall(r'<(b|span) class="(\w+)" title="[^"]*">([\d.]+)</', card[1])
    assert [(key, value) for _, key, value in shown] == [
        ("planned", f"{seconds[0]:.1f}"),
        ("plan_2", f"{seconds[1]:.1f}"),
    ]
    ahead = int(np.argmin(seconds))
    assert [tag for tag, *_ in shown].index("b") == ahead
    assert card[2] == f"{('&lt;short&gt;', 'strokes')[ahead]}: {abs(seconds[0] - seconds[1]):.1f} s less"
    plan = without_shapes(short_plan)
    alike = compare_page({"one": plan, "two": plan})
    assert alike.count("<p>the same in all</p>") == alike.count('class="card each"') >= 3


def test_verdict_and_curve_say_where_the_bent_tool_leaves_its_path(
    short_plan: Plan, short_tracking: Tracking, compensated_short: tuple[Plan, Tracking]
) -> None:
    plan, compensated = without_shapes(short_plan), without_shapes(compensated_short[0])
    # Of feet, whose hold is not promised, nothing is said.
    compensated = replace(compensated, robot=replace(compensated.robot, feet=()))
    page = compare_page({"bent": plan, "straight": compensated}, {"bent": short_tracking})
    simulated = short_tracking.planned
    off = f"{1e3 * simulated.largest_off_path:.2f} mm off its path"
    assert re.search(
        r'class="verdict worse"[^>]*><summary><b>bent.</b> Every promise[^<]*' + re.escape(off), page
    )
    assert f"Uncompensated sag: {1e3 * plan.bent_offsets[1]:.3g} mm." in page
    assert re.search(r'class="verdict good"[^>]*><summary><b>straight.</b> Every promise is kept', page)
    curves = {curve["motion"]: floats(curve["y"]) for curve in data_of(page)["charts"][2]["curves"]}
    assert curves["plan_2"].max() < 0.2
    # At rest: beside it the simulated tool sways.
    sway = simulated.largest(simulated.dynamic)
    assert 1e-3 * curves["planned"].max() == pytest.approx(simulated.largest_off_path, abs=sway)


@pytest.fixture(scope="module")
def page_file(text: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("compare") / "compare.html"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.browser
def test_it_shows_every_plan(chrome: Chrome, page_file: Path) -> None:
    open_page(chrome, page_file)
    require_quiet(chrome, page_file)
    chrome.execute_script("cmbotReplay.compare('beside')")
    assert [label.text for label in chrome.find_elements("css selector", ".half")] == ["<short>", "strokes"]
    tools = [ask(chrome, f"cmbotReplay.pose('link_7', '{arm}')") for arm in ("planned", "plan_2")]
    assert tools[0] != pytest.approx(tools[1], abs=1e-3)
    assert not chrome.find_element("id", "save-csv").is_displayed()


@pytest.mark.browser
def test_a_ghost_stands_on_what_carries_it(chrome: Chrome, page_file: Path) -> None:
    """Its rails bend with its own sag, not with that of the arm that is drawn whole."""
    if not shows(chrome, page_file):
        open_page(chrome, page_file)
    chrome.execute_script("cmbotReplay.compare('ghost')")
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.seek(0.4 * cmbotReplay.end)")
    slide(chrome, "deflection", 50)
    feet, bases, rails = chrome.execute_script(
        """const { bending, grounds } = cmbotReplay.stage, names = ["planned", "plan_2"];
        const rails = (name) => { let found; grounds[name][0].rails.traverse((mesh) => {
            found = mesh.geometry ? Array.from(mesh.geometry.attributes.position.array) : found; });
            return found; };
        return [names.map((name) => bending.drawn[name].foot.elements.slice(12, 15)),
            names.map((name) => grounds[name][0].base.position.toArray()), names.map(rails)];"""
    )
    np.testing.assert_allclose(bases, feet, atol=1e-9)
    first, second = np.reshape(rails, (2, -1, 3))
    apart = np.linalg.norm(first - second, axis=1)
    assert 1e-3 < np.linalg.norm(np.subtract(*feet)) < 0.5
    assert apart.max() > 1e-3
    assert apart.min() < 1e-6  # where the posts are held


@pytest.mark.browser
def test_an_arm_that_stands_elsewhere_brings_its_base(
    chrome: Chrome, short_plan: Plan, tmp_path: Path
) -> None:
    robot = without_shapes(short_plan).robot
    moved = np.add(robot.foot_point, (0.5, 0.0, 0.0))
    other = replace(without_shapes(short_plan), robot=replace(robot, foot_point=tuple(map(float, moved))))
    text = compare_page({"here": without_shapes(short_plan), "there": other})
    data = data_of(text)
    assert data["owners"] == ["plan_2"]
    assert data["feet"] == {"planned": list(robot.foot_point), "plan_2": moved.tolist()}
    path = tmp_path / "compare.html"
    path.write_text(text, encoding="utf-8")
    open_page(chrome, path)
    require_quiet(chrome, path)
    chrome.execute_script("cmbotReplay.compare('beside')")
    shown = """const { stage } = cmbotReplay, seen = {};
        stage.posed(arguments[0], () => {
            for (const name of ["planned", "plan_2"]) seen[name] = stage.grounds[name].at(-1).rails.visible;
            seen.arrow = stage.arrow.group.position.x;
        });
        return seen;"""
    for motion, foot in data["feet"].items():
        seen = chrome.execute_script(shown, motion)
        assert (seen["planned"], seen["plan_2"]) == (motion == "planned", motion == "plan_2")
        assert seen["arrow"] == pytest.approx(foot[0], abs=0.1)


@pytest.mark.browser
def test_plans_with_long_names_fit_a_phone(chrome: Chrome, short_plan: Plan, tmp_path: Path) -> None:
    plan = without_shapes(short_plan)
    text = compare_page({f"a_folder_with_a_rather_long_name_indeed_{k}": plan for k in range(2)})
    path = tmp_path / "compare.html"
    path.write_text(text, encoding="utf-8")
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": True}
    desktop = {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    try:
        chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        open_page(chrome, path)
        assert ask(chrome, "document.documentElement.scrollWidth") == 390
        # The verdicts, which a desktop shows whole, are folded: most of the view is seen above the bar.
        assert not chrome.find_elements("css selector", ".verdict[open]")
        top, bar = (
            ask(chrome, f"document.getElementById('{name}').getBoundingClientRect().top")
            for name in ("view", "bar")
        )
        assert bar - top > 200
    finally:
        chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", desktop)


def test_the_page_says_whose_surroundings_it_shows(text: str, short_plan: Plan) -> None:
    """And shows the paths of all plans."""
    alike = compare_page({"one": without_shapes(short_plan), "two": without_shapes(short_plan)})
    wall = Obstacle(name="wall", shape=Box(size=(0.1, 1.0, 1.0)), X_WO=pose((-3.0, 0.0, 0.0)))
    plan = without_shapes(short_plan)
    scene = with_obstacles(plan.scene, wall)
    other = compare_page({"<one>": plan, "two": replace(plan, scene=scene)})
    assert "(the surroundings are those of &lt;one&gt;)" in other
    assert "surroundings" not in alike
    paths = ["/path", "/others/plan_2/path"]
    for page, shown in ((text, paths), (alike, paths[:1])):
        commands = [umsgpack.unpackb(base64.b64decode(command)) for command in data_of(page)["commands"]]
        assert [each["path"] for each in commands if each["path"].endswith("/path")] == shown


def test_a_base_that_was_measured_is_compared_as_it_is(short_plan: Plan) -> None:
    """With the legs' compliance, which is in what was measured; the same either way."""
    scene = short_scene(robot={"joints": "elastic"})
    robot = robot_of(scene)
    modelled = replace(without_shapes(short_plan), scene=scene, robot=robot)
    base = elastic_base(held_guardrail(scene, robot))
    assert base is not None and robot.leg_compliance is not None
    found = {"footholds": [[0.0, 0.0, 0.0]], "stiffness": (0.8 * base.stiffness).tolist()}
    data = {"base": found | {"mass": base.mass.tolist()}, "covariance": (1e-4 * np.eye(21)).tolist()}
    known = IdentifiedStiffness.model_validate_json(json.dumps(data))
    measured = replace(modelled, scene=scene.model_copy(update={"identified": known}))
    for first, second, times in ((modelled, measured, "0.8"), (measured, modelled, "1.25")):
        said, _ = unlike({"one": first, "two": second})
        assert said == f"Beside one, in two the stiffness of the guardrail is {times} times as large."


def test_plans_on_other_bases_are_not_compared_without_a_word(short_plan: Plan, strokes_plan: Plan) -> None:
    """What differs is said before the verdicts; that an arm stands elsewhere is what plans may differ by."""
    plan = without_shapes(short_plan)
    soft = replace(plan, scene=plan.scene.changed(guardrail={"stiffness_factor": 0.5}))
    loaded = replace(plan, robot=replace(plan.robot, payload=2.0, elasticity={}))
    said, todo = unlike({"<one>": plan, "soft": soft, "loaded": loaded})
    assert "Beside <one>, in soft the stiffness of the guardrail is 0.5 times as large; in loaded" in said
    assert "the payload, kg, is 2 in place of 0" in said
    assert "of the links nothing bends" in said
    command = "cmbot evaluate SCENE --motion soft judges the motion of soft by the scene of <one>."
    assert todo.endswith(command)
    read = {"one": plan, "soft": replace(soft, scene=soft.scene.with_source("out/soft/plan.json"))}
    assert "cmbot evaluate SCENE --motion out/soft judges" in unlike(read)[1]
    # The stiffness that was measured judges the other's motion.
    link = {"name": "link_1", "modelled": 1e4, "factor": 1.0}
    known = IdentifiedStiffness.model_validate({"links": (link,), "covariance": ((0.01,),)})
    measured = replace(soft, scene=soft.scene.model_copy(update={"identified": known}))
    judged = unlike({"one": plan, "soft": measured})[1]
    assert judged.endswith("--motion one judges the motion of one by the scene of soft, which was measured.")
    page = compare_page({"<one>": plan, "soft": soft})
    for other, ranked in ((plan, True), (soft, False)):
        (card,) = re.findall(r"<h2>Tool within</h2>.*?</article>", compare_page({"one": plan, "two": other}))
        assert ("not ranked" in card) != ranked, card
        assert "<b " not in card
    assert 0 < page.index("Beside &lt;one&gt;, in soft") < page.index("Every promise")
    moved = replace(plan, scene=plan.scene.changed(guardrail={"foot": {"offset_m": 0.3}}))
    assert unlike({"one": plan, "moved": moved}) == ()
    # Its tool is pushed, and its feet hold elsewhere.
    pushed, _ = unlike({"one": plan, "strokes": strokes_plan})
    assert "in strokes the process force, N, is 0, 0, -40 in place of 0, 0, 0." in pushed
    assert "Not one arm" not in compare_page({"one": plan, "two": plan})


def test_what_is_refused(short_plan: Plan, saved_short: Path, tmp_path: Path) -> None:
    model = short_plan.robot.model.copy()
    model.names[1] = "shoulder"
    other = replace(short_plan, robot=replace(short_plan.robot, model=model))
    said = r"^cmbot compare: b: got another arm \(cmbot\), expected that of a \(cmbot\)$"
    with pytest.raises(InputError, match=said):
        compare_page({"a": short_plan, "b": other})
    with pytest.raises(InputError, match=r"^cmbot compare: got 1 plan, expected 2 to 6 different plans$"):
        compare_page({"a": short_plan})
    page = tmp_path / "page.html"
    page.touch()
    other_folder = shutil.copytree(saved_short, tmp_path / "other")
    assert "already there" in refusal("compare", saved_short, other_folder, "--html", page)


def test_the_command_names_plans_by_their_folders(
    short_plan: Plan, saved_short: Path, tmp_path: Path
) -> None:
    for folder in ("one", "two"):
        save(without_shapes(short_plan), tmp_path / folder)
    page = tmp_path / "page.html"
    folders = tmp_path / "one", tmp_path / "two"
    for flag in ("-o", "--output", "--html"):
        assert output("compare", *folders, flag, page, "--force") == f"Written to {page}.\n"
    assert data_of(page.read_text(encoding="utf-8"))["names"] == {"planned": "one", "plan_2": "two"}
