"""The arm and its guardrail as the pages bend them: chain, elastic coordinates, the shapes of the frame."""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from browser import ask, open_page, shows, slide
from hypothesis import given, strategies as st
from page_data import data_of, floats
from scipy.interpolate import CubicHermiteSpline
from selenium.webdriver import Chrome
from small_scenes import short_scene, tool_points

from cmbot.elastic.base import elastic_base, guardrail_frame
from cmbot.elastic.sag import Sag
from cmbot.planning import Plan, bending_arm
from cmbot.scene import load_scene
from cmbot.simulation import Tracking
from cmbot.views import replay_page
from cmbot.views.drawing.bending import Bending, drawn_factor, most_factor
from cmbot.views.drawing.support import pole_of, supports
from cmbot.views.drawing.surfaces import Surface, sliced
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
    return np.array([(ends(data["bending"]["chains"][0], q[k], u[k])[-1] @ tool)[:3, 3] for k in frames])


def test_the_chain_without_bending_is_the_rigid_arm(data: dict[str, Any], triangle_plan: Plan) -> None:
    model, made = triangle_plan.robot.model, triangle_plan.robot.model.createData()
    q = triangle_plan.samples.q[300]
    pin.forwardKinematics(model, made, q)
    (chain,) = data["bending"]["chains"]
    u = np.zeros(sum(not joint["driven"] for joint in chain["joints"]))
    for frame, rigid in zip(ends(chain, q, u), list(made.oMi)[1:], strict=True):
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
        np.testing.assert_allclose(bent, expected[list(frames)], atol=4e-5)
        rigid = tool_points(triangle_plan.robot, floats(data[name]["q"], triangle_plan.robot.dof)[frames])
        assert np.linalg.norm(bent - rigid, axis=1).max() > 8e-3
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
    frame, (foot,) = guardrail_frame(triangle_plan.scene.elastic_guardrail)
    shapes = frame.shapes(foot)
    np.testing.assert_allclose(shapes[foot], np.eye(6), atol=1e-9)
    assert not shapes[list(frame.fixed)].any()
    # The springs at the foot store the energy of the whole frame.
    u = np.array([1e-3, 2e-3, -1e-3, 1e-3, -2e-3, 3e-3])
    moved = np.concatenate([shapes[k] @ u for k in range(len(frame.nodes)) if k not in frame.fixed])
    stored = moved @ (frame.stiffness @ moved)
    assert stored == pytest.approx(
        u @ elastic_base(triangle_plan.scene.elastic_guardrail).stiffness @ u, rel=1e-9
    )


@given(deflection=st.floats(0.0, 10.0), reach=st.floats(0.05, 5.0))
def test_the_first_factor_draws_a_small_share_of_the_reach(deflection: float, reach: float) -> None:
    factor, most = drawn_factor(deflection, reach), most_factor(deflection, reach)
    assert factor <= most <= 200
    assert factor == 1 or factor * deflection <= 0.08 * reach
    assert factor == 200 or 2.5 * factor * deflection > 0.08 * reach  # the next is too large
    assert most in (2, 200) or reach - deflection < most * deflection <= reach


MAST = {"name": "mast", "cylinder": [0.05, 2.5], "xyz": [0, 0, -1.25]}


@pytest.mark.parametrize(
    ("obstacles", "held"),
    [
        ([MAST], [[0, 0, -2.5]]),
        ([MAST | {"xyz": [0, 0, 1.25]}], [[0, 0, 2.5]]),  # it hangs from a ceiling
        ([MAST | {"xyz": [0.06, 0, 0]}], [[0.06, 0, -1.25]]),  # it holds an upright pole from its side
        (
            [{"name": "bar", "box": [2, 0.1, 0.1], "xyz": [0.3, 0, -0.05]}],
            [[-0.7, 0, -0.05], [1.3, 0, -0.05]],
        ),
        ([{"name": "boom", "capsule": [0.04, 2], "xyz": [1, 0, 0], "rpy_deg": [0, 90, 0]}], [[2, 0, 0]]),
        ([MAST | {"xyz": [0.3, 0, -1.25]}], None),  # beside it
        ([{"name": "floor", "box": [3, 2, 0.1], "xyz": [0, 0, -0.05]}], None),
        ([{"name": "ball", "sphere": 0.3, "xyz": [0, 0, -0.3]}, MAST], [[0, 0, -2.5]]),
    ],
    ids=("mast", "hanging", "pole", "bar", "boom", "beside", "floor", "ball"),
)
def test_a_pole_is_a_slender_obstacle_at_the_foot(
    obstacles: list[dict[str, Any]], held: list[list[float]] | None
) -> None:
    scene = short_scene(obstacles=obstacles, guardrail={"bays": 0})
    pole = pole_of(scene)
    if held is None:
        assert pole is None
        return
    assert pole is not None
    np.testing.assert_allclose(pole.beams[:, 0], held, atol=1e-12)
    along = pole.beams[0, 1] - pole.beams[0, 0]
    assert along @ pole.beams[0, 1] == pytest.approx(0.0, abs=1e-12)  # its other end is at the foot, 0
    assert [each.name for each in supports(scene)] == [pole.name]


def test_a_tube_bends_where_it_holds_the_arm_wherever_the_world_is() -> None:
    """Clamped at the origin of W, it is drawn bent at its upper end."""
    data = load_scene("mast_inspection").as_data()
    data["robot"] |= {"mount": {"xyz": [0, 0, 2.5], "rpy_deg": [0, 0, 0]}}
    data["base"]["tube"] |= {"start_m": [0, 0, 0], "end_m": [0, 0, 2.5]}
    pole = pole_of(load_scene(data | {"obstacles": [MAST | {"xyz": [0, 0, 1.25]}]}))
    assert pole is not None
    np.testing.assert_allclose(pole.beams, [[[0, 0, 0], [0, 0, 2.5]]], atol=1e-12)


def mesh_mast(tmp_path: Path, turned: bool) -> dict[str, Any]:
    """An obstacle: a cylindrical mast as a mesh of long triangles, whose top is at the foot."""
    mast = trimesh.creation.cylinder(0.05, 2.5, sections=24)
    if turned:  # its file has it along x
        mast.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    mast.export(tmp_path / "mast.stl")
    turn = {"rpy_deg": [0, 90, 0]} if turned else {}
    return {"name": "mast", "mesh": str(tmp_path / "mast.stl"), "xyz": [0, 0, -1.25], **turn}


@pytest.mark.parametrize("turned", [False, True])
def test_a_mast_given_as_a_mesh_is_a_pole(tmp_path: Path, turned: bool) -> None:
    scene = short_scene(obstacles=[mesh_mast(tmp_path, turned)], guardrail={"bays": 0})
    pole = pole_of(scene)
    assert pole is not None
    np.testing.assert_allclose(pole.beams, [[[0, 0, -2.5], [0, 0, 0]]], atol=1e-6)
    away = short_scene(
        obstacles=[mesh_mast(tmp_path, turned) | {"xyz": [0.3, 0, -1.25]}], guardrail={"bays": 0}
    )
    assert pole_of(away) is None


@pytest.mark.parametrize("longest", [0.1, 0.4])
def test_what_is_bent_is_cut_into_slices_and_not_torn(longest: float) -> None:
    whole = trimesh.creation.cylinder(0.05, 2.5, sections=12)
    along = np.array([0.0, 0.0, 1.0])
    found = sliced(Surface(np.array(whole.vertices), np.array(whole.faces)), along, longest)
    cut = trimesh.Trimesh(found.vertices, found.faces, process=False)
    assert np.ptp(cut.vertices[cut.faces][..., 2], axis=1).max() <= longest + 1e-9
    # What is new lies in the planes, whose points all move alike: nothing opens between two slices.
    new = np.abs(np.abs(cut.vertices[:, 2]) - 1.25) > 1e-9
    count = np.ceil(2.5 / longest)
    share = (cut.vertices[new, 2] + 1.25) * count / 2.5
    np.testing.assert_allclose(share, np.round(share), atol=1e-6)
    assert cut.volume == pytest.approx(whole.volume, rel=1e-9)
    assert cut.area == pytest.approx(whole.area, rel=1e-9)
    assert len(cut.faces) < 3 * len(whole.faces) * 2.5 / longest


BEND = """return arguments[0].map(([from, to, shift, turn, factor]) => {
    const tip = mapAt(vector(to), vector(shift), vector(turn));
    return bentBeam(vector(from), vector(to), tip, factor).map((map) => map.transpose().toArray());
})"""


def bent(chrome: Chrome, beams: list[tuple[Any, ...]]) -> np.ndarray:
    """Maps (K, 13, 4, 4) of cross-sections along beams: from, to, shift and turn of its end, factor."""
    rows = [[np.asarray(each).tolist() for each in beam] for beam in beams]
    return np.reshape(chrome.execute_script(BEND, rows), (len(rows), -1, 4, 4))


@pytest.mark.browser
def test_beams_bend_as_clamped_ones_and_are_never_torn_or_stretched(
    chrome: Chrome, replay_file: Path, rng: np.random.Generator
) -> None:
    if not shows(chrome, replay_file):
        open_page(chrome, replay_file)
    beams = []
    for factor in (0.0, 0.5, 1.0, 8.0, 50.0, 200.0):
        for size in (1e-5, 1e-3, 0.02, 0.2):
            ends = rng.uniform(-1, 1, (2, 3))
            along = ends[1] - ends[0]
            turn, shift = size * rng.uniform(-1, 1, 3), size * np.cross(along, rng.uniform(-1, 1, 3))
            beams.append((*ends, shift, turn, factor))
    for (start, end, shift, turn, factor), maps in zip(beams, bent(chrome, beams), strict=True):
        R, share = maps[:, :3, :3], np.linspace(0, 1, len(maps))[:, None]
        length = np.linalg.norm(end - start)
        np.testing.assert_allclose(np.swapaxes(R, 1, 2) @ R, np.tile(np.eye(3), (len(maps), 1, 1)), atol=1e-9)
        np.testing.assert_allclose(maps[0], np.eye(4), atol=1e-9)  # where it is clamped
        np.testing.assert_allclose(R[-1], pin.exp3(factor * turn), atol=1e-6)
        rest = start + share * (end - start)
        places = np.einsum("kij,kj->ki", R, rest) + maps[:, :3, 3]
        if factor <= 1:
            np.testing.assert_allclose(
                places[-1], end + factor * shift, atol=2 * length * max(turn @ turn, 1e-9)
            )
        if factor == 1:
            np.testing.assert_allclose(places[-1], end + shift, atol=1e-9)
        # Its pieces are as long as they were, but for terms of second order in the true bending.
        pieces = np.linalg.norm(np.diff(places, axis=0), axis=1) / (length / (len(maps) - 1))
        second = (np.linalg.norm(turn) + 3 * np.linalg.norm(shift) / length) ** 2
        np.testing.assert_allclose(pieces, 1.0, atol=second + 1e-9)
        if factor * max(np.linalg.norm(turn), np.linalg.norm(shift)) < 1e-2:  # small: the cubic of the beam
            cubic = CubicHermiteSpline([0, 1], [0 * shift, shift], [0 * shift, np.cross(turn, end - start)])
            moved = (places - rest) / factor if factor else 0 * rest
            slack = 0.01 * np.abs(moved).max() + 3e-2 * np.linalg.norm(turn) * length
            np.testing.assert_allclose(moved, cubic(share[:, 0]) if factor else 0 * rest, atol=slack)


@pytest.mark.browser
def test_a_pole_leads_the_foot_and_two_halves_follow_it(chrome: Chrome, replay_file: Path) -> None:
    if not shows(chrome, replay_file):
        open_page(chrome, replay_file)
    shift, turn = [0.11, 0.02, -0.01], [0.01, 0.24, 0.05]
    mast = [[[0, 0, -2.5], [0, 0, 0]]]
    halves = [[[0, -1, 0], [0, 0, 0]], [[0, 1.4, 0], [0, 0, 0]]]
    for beams, factor in ((mast, 1), (mast, 4), (halves, 4)):
        foot, maps, stations = chrome.execute_script(
            """const [beams, shift, turn, factor, points] = arguments, pole = new Pole(beams);
            const rows = (X) => X.clone().transpose().toArray(), origin = vector([0, 0, 0]);
            const times = (by) => mapAt(origin, ...[shift, turn].map((v) => vector(v).multiplyScalar(by)));
            const tip = times(1), foot = pole.footOf(tip, factor) ?? times(factor);
            const stations = Array.from(pole.stationsOf(points));
            return [rows(foot), pole.mapsOf(foot, tip, factor).map(rows), stations];""",
            beams,
            shift,
            turn,
            factor,
            [coordinate for beam in beams for point in beam for coordinate in point],
        )
        foot, maps = np.reshape(foot, (4, 4)), np.reshape(maps, (-1, 13, 4, 4))
        assert len(maps) == len(beams)
        np.testing.assert_allclose(maps[:, 0], np.tile(np.eye(4), (len(maps), 1, 1)), atol=1e-9)
        np.testing.assert_allclose(maps[:, -1], np.tile(foot, (len(maps), 1, 1)), atol=1e-6)
        np.testing.assert_allclose(foot[:3, :3], pin.exp3(factor * np.array(turn)), atol=1e-6)
        if factor == 1:
            np.testing.assert_allclose(foot[:3, 3], shift, atol=1e-6)
        # Held ends are the first stations of their beams, the foot is the end of each.
        assert stations == ([0, 12] if len(beams) == 1 else [0, 25, 13, 25])


def drawn_ends(
    source: dict[str, Any], foot: np.ndarray, q: np.ndarray, u: np.ndarray, f: float
) -> list[pin.SE3]:
    """Frames of the ends of all links, their bending times a factor, along finely cut beams."""

    def moved(pose: pin.SE3, k: int, factor: float) -> pin.SE3:
        joint = source["joints"][k]
        value = (q if joint["driven"] else factor * u)[joint["index"]]
        return pose * pin.XYZQUATToSE3(np.array(joint["pose"])) * pin.exp6(np.array(joint["axis"]) * value)

    base = pin.SE3.Identity()
    for k in range(6):
        base = moved(base, k, 1.0)
    pose, following, found = (
        pin.SE3(pin.exp3(f * pin.log3(base.rotation)), foot + f * (base.translation - foot)),
        6,
        [],
    )
    for link in source["links"]:
        while following <= link["start"]:
            pose, following = moved(pose, following, f), following + 1
        bend, X = pin.SE3.Identity(), pin.XYZQUATToSE3(np.array(link["pose"]))
        while following <= link["end"]:
            bend, following = moved(bend, following, 1.0), following + 1
        bend = bend * X
        if link["tube"]:
            start, end = np.reshape(link["tube"], (2, 3))
            along = end - start
            turn = pin.log3(bend.rotation)
            slope = CubicHermiteSpline(
                [0, 1], [0 * end, bend.act(end) - end], [0 * end, np.cross(turn, along)]
            ).derivative()
            axis = along / np.linalg.norm(along)

            def leads(
                factor: float, slope: Any = slope, axis: Any = axis, along: Any = along, turn: Any = turn
            ) -> Any:
                shares = (np.arange(400) + 0.5) / 400
                across = np.cross(axis, slope(shares)) / np.linalg.norm(along)
                turns = across + np.outer(shares, axis) * (axis @ turn)
                return np.mean([pin.exp3(factor * each) @ along for each in turns], axis=0)

            place = start + leads(f) + min(f, 1.0) * (bend.act(end) - start - leads(1.0))
            R = pin.exp3(f * turn)
            bend = pin.SE3(R, place - R @ end)
        found.append(pose * bend)
        pose = pose * bend * X.inverse()
    return found


@pytest.mark.browser
def test_the_page_bends_arm_and_rails(
    chrome: Chrome, replay_file: Any, triangle_plan: Plan, data: dict[str, Any]
) -> None:
    if not shows(chrome, replay_file):
        open_page(chrome, replay_file)
    plain = data_of(replay_page(triangle_plan))
    (source,) = plain["bending"]["chains"]
    chrome.execute_script("cmbotReplay.pause(); cmbotReplay.seek(cmbotReplay.workStart)")
    q = floats(plain["planned"]["q"], 7)[0]
    u = floats(plain["planned"]["u"])
    u = u[: sum(not joint["driven"] for joint in source["joints"])]
    rails = """return (() => {
        const found = [];
        cmbotReplay.stage.node("rails").traverse((mesh) => {
            if (mesh.geometry) found.push(...mesh.geometry.attributes.position.array);
        });
        return found;
    })()"""
    # The tip of the last link, and the foot: as it is drawn, and as the rails have it.
    drawn = """return (({ bending: { drawn: { planned: { links, foot, tip, factor } }, chains } }) => {
        const { support } = chains.planned;
        const { place, maps } = links.at(-1), ends = support.mapsOf(foot, tip, factor);
        const at = support.members.findIndex(([a]) => support.nodes[a].distanceTo(support.feet[0]) < 1e-9);
        const tool = place.clone().multiply(maps.at(-1));
        return [tool, foot, ends[2 * at]].map((X) => X.clone().transpose().toArray());
    })(cmbotReplay.stage)"""
    places = {}
    foot = np.array(triangle_plan.robot.foot_point)
    for factor in (0, 1, 50, 200, 0):
        slide(chrome, "deflection", factor)
        tip, moved, held = np.reshape(chrome.execute_script(drawn), (3, 4, 4))
        if factor:
            expected = drawn_ends(source, foot, q, u, factor)[-1].homogeneous
            np.testing.assert_allclose(tip, expected, atol=1e-6 if factor == 1 else 4e-3)
            np.testing.assert_allclose(moved, held, atol=1e-5)
        if factor == 1:
            np.testing.assert_allclose(tip, ends(source, q, u)[-1], atol=1e-6)
        places[factor] = np.reshape(chrome.execute_script(rails), (-1, 3))
    shifts = np.linalg.norm(places[50] - places[0], axis=1)
    assert 0.05 < shifts.max() < 1.0
    assert shifts.min() < 1e-6  # where the posts are held
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
    if not shows(chrome, replay_file):
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
