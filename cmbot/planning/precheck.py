"""The precheck: problems of a scene that can be named before it is planned."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray
from cmbot.common.errors import MissingExtra, PathNotFound, PlanningError, SceneError
from cmbot.common.installation import install_command
from cmbot.common.reading.validation import counted
from cmbot.common.reading.yaml_reader import line_of, lines_named
from cmbot.common.representation import ShortRepr
from cmbot.elastic.arm import ElasticArm, elastic_arm
from cmbot.elastic.sag import Sag, TooSoftError
from cmbot.hold import LOADS, FootUse
from cmbot.optimization import piqp_module
from cmbot.planning.reach import beyond_reach, without_posture
from cmbot.planning.request import StrokeRequest, end_posture_of, strokes_of, task_of
from cmbot.planning.task import ToolTask, task_dimension
from cmbot.planning.workcell.units import FAR_REACHES, mistaken_units, require_metres, unit_findings
from cmbot.planning.workcell.workcell import (
    bending_arm,
    identified_in_words,
    rigid_parts_remark,
    robot_of,
    standing_point,
    stiffness_point,
)
from cmbot.robot import Dynamics, Finding, Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, Stroke, Tool, coverage_of, mount_entry
from cmbot.toolpath import FaceSurface, ToolPath
from cmbot.trajectory import SUPPORT

MOST_UNKNOWNS = 3000
"""Of a problem for SLSQP, whose dense matrices cost the cube of them: here an exchange iteration takes one to
two minutes, at 4,000 more than three."""

# A stretched arm is not out of its own reach.
_ROUNDING_SHARE = 1e-9
# More sag than this is rather a mistake of the stiffness' unit.
_MUCH_SAG_M = 0.15
# How much of a tool's tip may be in a workpiece that it may touch; at how many of its places that is judged.
_MOST_PRESSED_M, _TIP_PLACES = 0.01, 121
# A tool point that is so near to a workpiece touches it.
_TOUCHED_M = 1e-3
_STIFF = "a base and an arm that bear the weight (N/m and Nm/rad)"
# From here on something is elsewhere, and this much of the way is upright.
_SAME_PLACE_M, _PLUMB_SHARE = 1e-3, 0.99
# Odd, so that the middle of a leg's time is among them.
_SPEED_SAMPLES = 201


# What a scene has, as a name and a value with its unit, or what is wrong.
_Found = tuple[str, str] | Finding


@dataclass(frozen=True, kw_only=True)
class Precheck(ShortRepr):
    """What was found.

    Attributes
    ----------
    found : tuple of (str, str)
        What the scene asks for and how it begins, as names and values with units.
    warnings : tuple of Finding
        Reasons why planning it may fail; of severity ``error``: why it does.
    """

    found: tuple[tuple[str, str], ...]
    warnings: tuple[Finding, ...]


def precheck_scene(scene: Scene) -> Precheck:
    """Check what a scene asks for and how it begins.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    """
    with failures_explained(scene):
        robot = robot_of(scene)
        strokes = strokes_of(scene, robot)
        require_metres(scene, robot)
    task = task_of(strokes[0], scene)
    place = Kinematics(robot).tool_pose(scene.posture).translation
    start: list[_Found] = [(f"tool point in {scene.posture_key}", f"({_point(place)}) m")]
    start += [*_hold_at_start(scene, robot), *_sag_at_start(scene, robot), *_clearance_at_start(scene, robot)]
    start += [*_statics_at_start(scene, robot, task), *_return(scene, robot)]
    found = [*_asked(scene, robot, strokes, task), *(each for each in start if isinstance(each, tuple))]
    warnings = [*_too_strong(scene, robot), *_warnings(start), *_out_of_reach(strokes, robot)]
    units = [*unit_findings(scene, robot)]
    # They may explain the others.
    first = "".join(f"; first see {each.key}, {each.got}" for each in units[:1])
    blocked = (replace(each, expected=f"{each.expected}{first}") for each in without_posture(scene))
    with lines_named(scene.source):
        warnings += [*blocked, *_blocked_feet(scene)]
    for stroke in strokes:
        warnings += [
            *_too_fast(scene.tool, stroke),
            *_too_deep(scene, stroke),
            *_tip_too_short(scene, stroke),
        ]
        warnings += [] if any(beyond_reach(stroke, robot)) else _too_short(stroke, robot)
        warnings += filter(None, [oversized(stroke, robot.dof, scene.planner)])
    warnings += [*precheck_options(scene.planner, scene.tool), *_locked_below(scene, robot)]
    # Rows of a raster share their key, and what is the matter with them.
    return Precheck(found=tuple(found), warnings=tuple(dict.fromkeys([*units, *warnings])))


def _asked(
    scene: Scene, robot: Robot, strokes: Sequence[Stroke], task: ToolTask
) -> Iterator[tuple[str, str]]:
    """What a scene asks for: robot, paths, surroundings, the tool, and what was assumed."""
    joints = counted(robot.dof, "joint")
    workpieces = counted(sum(obstacle.workpiece for obstacle in scene.all_obstacles), "workpiece")
    point = _point(task.path.corners[0])
    yield "scene", f"{scene.name} ({scene.source})"
    yield "robot", f"{robot.name}: {joints}, {robot.mass:.2f} kg ({robot.arm_mass:.2f} kg moving)"
    yield from _paths(strokes)
    tip = scene.tool.contact_mm
    contact = f", which the last {tip:g} mm of the tool may touch" if tip else ""
    yield "obstacles", f"{len(scene.all_obstacles)}, of them {workpieces}{contact}"
    axis = ", ".join(f"{x:g}" for x in np.round(task.path.poses([0.0]).rotation[0, :, 2], 2) + 0.0)
    goal = scene.strokes[0].start_pose
    as_before = goal is not None and goal.rpy_deg is goal.axis is None and task.keep != "position"
    turned = f", turned as in {scene.posture_key}: from has no rpy_deg and no axis" * as_before
    yield "tool point where its path begins", f"({point}) m, its axis along ({axis}){turned}"
    if robot.pushed:
        force = ", ".join(f"{x:g}" for x in robot.tool_force)
        slowly = f", which sets in within {robot.tool_ramp:g} s" if robot.tool_ramp else ""
        yield "process force on the tool", f"({force}) N along its axes{slowly}"
    if scene.tool.max_speed_m_s is not None:
        fastest = max(_speeds(stroke.path).max() for stroke in strokes)
        yield "tool speed", f"{fastest:.4g} of at most {scene.tool.max_speed_m_s:g} m/s"
    if robot.remarks:
        yield "assumed", " ".join(robot.remarks)
    if rigid := rigid_parts_remark(scene, robot):
        yield "bending", rigid
    if at := stiffness_point(scene):
        acts = f"({', '.join(f'{x:g}' for x in at)}) m, {_place(at, scene, robot)}"
        yield f"stiffness of the {scene.base_name} acts at", acts
    if identified := identified_in_words(scene):
        yield "stiffness", identified


def _point(place: FloatArray) -> str:
    return ", ".join(f"{x:.4f}" for x in place + 0.0)


def _place(at: Sequence[float], scene: Scene, robot: Robot) -> str:
    """Where a point (3,), m, is from what the base holds, in words."""
    by = np.array(at) - standing_point(scene, robot)
    away, held = float(np.linalg.norm(by)), "the foot" if scene.on_guardrail else robot.base_frame
    if away <= _SAME_PLACE_M:
        return f"at {held}"
    above = "above" if by[2] > 0 else "below"
    return f"{away:.3g} m {above if abs(by[2]) > _PLUMB_SHARE * away else 'from'} {held}"


def _locked_below(scene: Scene, robot: Robot) -> Iterator[Finding]:
    """Yield what a scene does not say of locked joints before the arm: where they are, what bends."""
    place = "a place of this lift or rail before the arm; 0 m is assumed"
    yield from (_warning(f"robot.locked.{name}", "nothing", place) for name in robot.unplaced)
    lift, at, base = robot.lift, stiffness_point(scene), scene.base_name
    if lift is None or at is None or scene.on_guardrail:
        return
    nothing, tube = f"nothing, and {lift.joint} is locked before the arm:", scene.base and scene.base.tube
    if not (tube or scene.robot.mount) and robot.base_place:
        where = f"{mount_entry(robot.base_pose)}, with W there, if it was measured at {robot.base_frame}"
        got = f"{nothing} the stiffness acts {_place(at, scene, robot)}"
        yield _warning("robot.mount", got, f"{where}; else with xyz {robot.base_place}")
    if scene.robot.carried_from is None and lift.beside_kg:
        floor = f"{lift.link} if they stand on the floor, else {lift.root}"
        load = f"{nothing} {lift.beside_kg:.4g} kg below it load the {base}"
        yield _warning("robot.carried_from", load, floor)


def _warnings(found: Iterable[_Found]) -> Iterator[Finding]:
    return (each for each in found if isinstance(each, Finding))


def _clearance_at_start(scene: Scene, robot: Robot) -> Iterator[_Found]:
    """The smallest distance in the start posture."""
    clearances, margin = Clearances(robot, scene.all_obstacles), scene.planner.safety_margin_m
    smallest = clearances.query(scene.posture[None])
    if smallest.pair[0] < 0:
        return
    pair, distance = clearances.pairs[smallest.pair[0]], float(smallest.distance[0])
    yield "clearance at the start", f"{distance:.4f} m ({pair.link} to {pair.other})"
    if distance < margin:
        clear, near = "a start that is clear by planner.safety_margin_m", pair.describe(distance, margin)
        # No motion begins there, nor an approach.
        yield Finding(severity="error", key=scene.posture_key, got=near, expected=clear)


def _statics_at_start(scene: Scene, robot: Robot, task: ToolTask) -> Iterator[_Found]:
    """How far the start posture is from a singularity, and what the arm asks in it at rest."""
    # Where the work may start elsewhere, the arm waits in the scene's posture with its tool off.
    efforts = Dynamics(robot if scene.planner.stays else robot.tool_off).static_efforts(scene.posture[None])
    use = np.abs(efforts.joint_torque[0]) / robot.limits.torque
    joint = robot.joints[use.argmax()]
    yield "smallest singular value there", f"{task.smallest_singular_value(robot, scene.posture):.4f}"
    yield f"torque on the {scene.base_name} there", f"{np.linalg.norm(efforts.guardrail_torque):.2f} Nm"
    yield "largest joint torque there", f"{use.max():.2f} of the bound of {joint}"
    if use.max() > 1.0:
        effort = "force" if robot.limits.prismatic[use.argmax()] else "torque"
        got = f"{use.max():.2f} of the {effort} that {joint} can bear, at rest"
        yield _warning(scene.posture_key, got, "at most 1")


def _hold_at_start(scene: Scene, robot: Robot) -> Iterator[_Found]:
    """What feet and locked joints bear at rest in the start posture, with the tool off."""
    holding = robot.holding
    wrench = Dynamics(robot.tool_off).static_efforts(scene.posture[None]).guardrail_wrench
    if holding is not None and holding.adhesive and not holding.bounded:
        left = holding.kinds_left(holding.worst(wrench, np.zeros(1)), "the start posture alone")
        yield "holds left for the start alone", f"{left}; cmbot plan says what the job asks"
    if holding is not None and holding.bounded:
        use = holding.most_used(wrench)
        got = use.in_words
        yield "of what the feet bear there, safety included", f"{100 * use.share:.0f} %: {got}"
        yield from _unheld(scene, use, scene.posture_key)
    if robot.holding_joints:
        uses = robot.holding_use(wrench)[0]
        share, joint = float(uses.max()), robot.holding_joints[int(uses.argmax())]
        yield "locked joint that bears most there", f"{joint.name}, {100 * share:.0f} % of {joint.limit:g} Nm"
        if share > 1.0:
            got = f"{100 * share:.0f} % of what the locked {joint.name} holds, {joint.limit:g} Nm, at rest"
            expected = "at most 100 %, or more of holding_torque in the limits file"
            yield Finding(severity="error", key=scene.posture_key, got=got, expected=expected)


def _unheld(scene: Scene, use: FootUse, asks: str) -> Iterator[Finding]:
    """Yield that a foot does not bear what something asks at rest."""
    if use.share > 1.0:
        other = ", or another place, which cmbot stand seeks" * scene.is_movable
        key = f"{scene.hold_of(use.foot)[0]}.{use.bound}"
        expected = f"feet that bear what {asks} asks at rest{other}"
        yield Finding(severity="error", key=key, got=use.in_words, expected=expected)


def _too_strong(scene: Scene, robot: Robot) -> Iterator[Finding]:
    """Yield magnets and clamps with bounds that two poles on this steel, or the member, have not."""
    for number, foot in enumerate(robot.feet, start=1):
        which = f" of foot {number}" * (len(robot.feet) > 1)
        key, hold = scene.hold_of(number - 1)
        for name, moment, bears in zip(LOADS[3:], hold.moment_nm or (), foot.moment or (), strict=False):
            if moment > bears:
                expected = f"at most {bears:.0f}, at which the member yields, of S235; so much is taken"
                yield _warning(f"{key}.moment_nm", f"{moment:g} {name}{which}", expected)
        if foot.adhesion is not None and foot.adhesion > foot.ceiling:
            most = f"{foot.ceiling:.0f} N at most"
            got = f"{foot.adhesion:.0f} N{which}, where a magnet of two poles pulls {most}"
            expected = "what the magnet was measured to pull on this steel; more poles pull more: it is taken"
            yield _warning(f"{key}.adhesion_n", got, expected)


def _blocked_feet(scene: Scene) -> Iterator[Finding]:
    """Yield feet that touch an obstacle where they hold, or as they are put there; members may meet there."""
    stance = scene.guardrail.stance if scene.on_guardrail else None
    places, own = () if stance is None else stance.places, {each.name for each in scene.obstacles}
    for number, place in enumerate(places, start=1):
        if place is not None and (other := scene.in_the_way(place)) in own:
            got = f"a foot that touches {other} at the {place.face} of {place.member}, or as it is put there"
            yield _warning(f"guardrail.stance.foot_{number}", got, "another face, or another place along_m")


def _sag_at_start(scene: Scene, robot: Robot) -> Iterator[_Found]:
    """How far the tool sags in the start posture, at rest with the tool off."""
    arm = bending_arm(scene, robot)
    if arm is None:
        return
    sag = _sag_of(arm, scene.posture)
    got = f"so soft a base or arm that the arm topples in {scene.posture_key}"
    if sag is not None:
        yield "sag of the tool there", f"{1e3 * sag:.2f} mm"
        if sag <= _MUCH_SAG_M:
            return
        got = f"a tool that sags {1e3 * sag:.0f} mm in {scene.posture_key}"
    key, expected = _softest(scene, robot)
    yield _warning(key, got, expected)


def _sag_of(arm: ElasticArm, posture: FloatArray) -> float | None:
    """How far the tool sags at rest in a posture (n,), m, with the tool off; None: the arm topples."""
    try:
        return float(Sag(arm.tool_off).distance(posture[None])[0])
    except TooSoftError:
        return None


def _softest(scene: Scene, robot: Robot) -> tuple[str, str]:
    """The key of what is too soft, and what is expected: the arm where it sags on a rigid base, too."""
    arm, springs = elastic_arm(robot, None), robot.joint_elasticity
    sag = _sag_of(arm, scene.posture) if len(arm.elastic) else 0.0
    if sag is not None and sag <= _MUCH_SAG_M:
        return scene.softest_key, _STIFF
    expected = "stiffness in its elasticity file with which the arm bears its weight"
    if springs:
        name, spring = min(springs.items(), key=lambda each: each[1].stiffness)
        expected += f"; {name} has {spring.stiffness:g} Nm/rad: Nm/arcmin?"
    return "identified" if scene.identified else "robot.elasticity", expected


def _out_of_reach(strokes: Sequence[Stroke], robot: Robot) -> Iterator[Finding]:
    """Keys of legs that end farther from the arm's first joint than the arm is long."""
    within = (
        f"at most {robot.reach:.3f} m from there, with arm and tool stretched out; where the tool's pose "
    )
    within += "is kept, less (lengths are in metres)"
    furthest: dict[str, tuple[float, FloatArray]] = {}
    for stroke in strokes:
        for key, place, away in beyond_reach(stroke, robot):
            if key not in furthest or away > furthest[key][0]:
                furthest[key] = away, place
    for key, (away, place) in furthest.items():
        end, joint = (", ".join(f"{x:.3f}" for x in at) for at in (place, robot.base_point))
        got = f"an end at ({end}) m, {away:.3f} m from the arm's first joint, at ({joint}) m"
        yield Finding(severity="error", key=key, got=got, expected=within)
        if away > FAR_REACHES * robot.reach:
            return  # what comes after it is as far


def _paths(strokes: Sequence[Stroke]) -> Iterator[tuple[str, str]]:
    """What each stroke is made of, and the number of its via-points."""
    for stroke in strokes:
        path = stroke.path
        name = "tool path" if len(strokes) == 1 else f"stroke {stroke.name}"
        yield (
            name,
            f"{stroke.file.in_words}, {path.lengths.sum():.3f} m in {_seconds(path)}, "
            f"keeps the tool's {stroke.file.keep}",
        )
    surfaces = {stroke.file.part_of or stroke.name: stroke.surface for stroke in strokes}
    for name, covers in coverage_of(strokes).items():
        if isinstance(surface := surfaces[name], FaceSurface):
            left_out = f"{covers.left_out:.3g} m2" if covers.left_out else "none"
            said = f"{covers.area:.4g} m2, left out of them {left_out}"
            said += f"; {surface.found}" if surface.found else ""
            yield f"faces of {Path(str(surface.raster.mesh)).name}", said
    yield "via-points", " + ".join(str(len(stroke.via_times)) for stroke in strokes)


def _seconds(path: ToolPath) -> str:
    """How long a path takes, in words."""
    if not path.open_legs:
        return f"{path.duration:.6g} s"
    given = sum(seconds for k, seconds in enumerate(path.seconds) if k not in path.open_legs)
    return "the shortest time" + (f" and {given:.6g} s" if given else "")


def _return(scene: Scene, robot: Robot) -> Iterator[_Found]:
    """Where the arm goes after the work, and what it asks there at rest."""
    end = end_posture_of(scene, robot)
    if end is not None:
        efforts = Dynamics(robot.tool_off).static_efforts(end[None])
        torque = np.linalg.norm(efforts.guardrail_torque)
        yield "return", f"to {scene.return_to}: {torque:.2f} Nm on the {scene.base_name} there"
        if robot.holding is not None and robot.holding.bounded and (end != scene.posture).any():
            yield from _unheld(scene, robot.holding.most_used(efforts.guardrail_wrench), "the return")


def precheck_options(options: PlannerOptions, tool: Tool | None = None) -> Iterator[Finding]:
    """Yield reasons why planning with some options may fail.

    Parameters
    ----------
    options : PlannerOptions
    tool : Tool, optional
        The scene's: a process force may have a torque about z, and seldom pulls the tool forward.
    """
    pushed = tool is not None and any(tool.process_force_n)
    if options.objective == "torque" and not any(options.axis_weights[:2]) and not pushed:
        weights = ", ".join(f"{weight:g}" for weight in options.axis_weights)
        yield _warning(
            "planner.axis_weights",
            f"[{weights}]: gravity has no torque about z, so only what the motion itself asks would be "
            "minimised, and slowly",
            "a weight above 0 for x or y, as in [1, 1, 1]",
        )
    if tool is not None and tool.process_force_n[2] > 0:
        got = f"[{', '.join(f'{x:g}' for x in tool.process_force_n)}], which pulls the tool forward"
        expected = "a negative z: a nozzle's recoil, and what the tool is pressed against, push it back"
        yield _warning("tool.process_force_n", got, expected)


@contextmanager
def failures_explained(scene: Scene) -> Iterator[None]:
    """Add to errors about a scene, or its plan, the line in its file and what may have been mistaken."""
    try:
        with lines_named(scene.source):
            try:
                yield
            except TooSoftError as error:
                soft = f"so soft a base or arm that on its path there is {error.got}"
                key, expected = _softest(scene, robot_of(scene))
                raise SceneError(scene.source, key, soft, expected) from error
    except (PlanningError, SceneError) as error:
        robot = robot_of(scene) if isinstance(error, PlanningError) else None
        if robot is not None:
            if near := [*_warnings(_clearance_at_start(scene, robot))]:
                error.add_source(_with_line(scene, near[0].key))
                if not error.hints:
                    error.add_hint(f"expected {near[0].expected}")
            elif line := isinstance(error, PathNotFound) and line_of(Path(scene.source), error.key):
                error.add_source(f"line {line}")
            for warning in _warnings(_hold_at_start(scene, robot)):
                # What does not even hold at rest comes first.
                error.add_source(f"the start asks {warning.got}")
                error.add_source(_with_line(scene, warning.key))
            for warning in _warnings(_sag_at_start(scene, robot)):
                error.add_hint(f"{_with_line(scene, warning.key)} has {warning.got}")
        block = None if isinstance(error, PlanningError) else error.key.partition(".")[0]
        for number, (key, looks, units) in enumerate(mistaken_units(scene, robot)):
            told, where = f"looks like {looks}, it is in {units}", _with_line(scene, key)
            if block is None and number == 0:
                # It may explain the failure: it comes before what else would do.
                error.add_source(told)
                error.add_source(where)
            elif block in (None, key.partition(".")[0]):
                error.add_hint(f"{where} {told}")
        raise


def _with_line(scene: Scene, key: str) -> str:
    """A key, with its line before it where the scene's file has it."""
    line = line_of(Path(scene.source), key)
    return f"line {line}: {key}" if line else key


def require_sound_path(scene: Scene, stroke: Stroke) -> None:
    """Refuse a stroke on which the tool is faster than allowed, or deep in a workpiece: a `SceneError`."""
    for found in (*_too_fast(scene.tool, stroke), *_too_deep(scene, stroke)):
        raise SceneError(scene.source, found.key, found.got, found.expected)


def require_seconds(request: StrokeRequest) -> None:
    """Refuse a stroke whose seconds no motion of the joints keeps: a `PathNotFound`."""
    for found in _too_short(request.stroke, request.cell.robot):
        reason = f"{found.key}: got {found.got}, expected {found.expected}"
        raise request.path_not_found(reason, request.state.posture, key=found.key)


def _too_short(stroke: Stroke, robot: Robot) -> Iterator[Finding]:
    """Yield a stroke whose seconds no motion of the joints keeps."""
    path = stroke.path
    length, seconds = float(path.lengths.sum()), float(path.duration)
    if not path.open_legs and seconds < (least := robot.least_seconds(length)):
        # The fastest leg's, unless what is blended has one time for all.
        fastest = int(np.argmax(path.lengths / path.seconds))
        key = stroke.leg_key(fastest) if stroke.file.legs else stroke.key
        if key != f"{stroke.key}.legs":
            key += ".seconds" if stroke.asked_speed(fastest) is None else ".speed_m_s"
        got = f"{length:.3g} m in {seconds:.3g} s"
        expected = f"seconds: auto; in less than {_rounded_up(least)} s no arm of this reach keeps its limits"
        yield Finding(severity="error", key=key, got=got, expected=expected)


def _too_fast(tool: Tool, stroke: Stroke) -> Iterator[Finding]:
    """Yield the legs that are too fast for the tool."""
    path, most = stroke.path, tool.max_speed_m_s
    if most is None:
        return
    speeds = _speeds(path)
    for k in np.flatnonzero(speeds > most * (1 + _ROUNDING_SHARE)):
        key, name = stroke.leg_key(int(k)) if stroke.file.legs else stroke.key, "speed_m_s"
        got, expected = f"{speeds[k]:.4g} m/s", f"at most {most:g} m/s, as tool.max_speed_m_s says"
        if stroke.asked_speed(int(k)) is None:
            name, got = "seconds", f"{path.seconds[k]:g} s, in which the tool reaches {got}"
            least = _rounded_up(path.seconds[k] * speeds[k] / most)
            expected = f"at least {least} s, for tool.max_speed_m_s {most:g}"
        yield _warning(f"{key}.{name}", got, expected)


def _too_deep(scene: Scene, stroke: Stroke) -> Iterator[Finding]:
    """Yield the workpieces that the tip may touch, and a path holds it in: nothing else keeps it out."""
    times, path = stroke.via_times, stroke.path
    tip, ahead = path.position(times), path.rotation(times)[..., 2]
    for obstacle in scene.touched:
        back = np.linspace(0.0, obstacle.contact, _TIP_PLACES)
        places = tip[:, None] - back[:, None] * np.broadcast_to(ahead, tip.shape)[:, None]
        inside = obstacle.contains(places.reshape(-1, 3)).reshape(len(tip), -1).mean(axis=1)
        k = int(inside.argmax())
        if (length := obstacle.contact * inside[k]) > _MOST_PRESSED_M:
            where = ", ".join(f"{x:.3f}" for x in tip[k])
            got = f"{1e3 * length:.0f} mm of the tip in {obstacle.name}, the tool point at ({where}) m"
            expected = f"at most {1e3 * _MOST_PRESSED_M:g} mm, by which a tool is pressed"
            if stroke.file.raster is not None:
                expected += "; on a raster it points against u x v, which u and v exchanged turn round"
            key = stroke.leg_key(path.leg_to(float(times[k])))
            yield Finding(severity="error", key=key, got=got, expected=expected)


def _tip_too_short(scene: Scene, stroke: Stroke) -> Iterator[Finding]:
    """Yield that the tool point touches where the rest of the tool then cannot keep the margin."""
    margin, poses = scene.planner.safety_margin_m, stroke.path.poses(stroke.via_times)
    ahead = poses.point + _TOUCHED_M * poses.rotation[..., 2]
    for obstacle in scene.touched:
        if obstacle.contact <= margin and obstacle.contains(ahead).any():
            got = f"{scene.tool.contact_mm:g}, and the tool point touches {obstacle.name}"
            expected = (
                f"more than planner.safety_margin_m, {1e3 * margin:g} mm: the rest of the tool keeps it"
            )
            yield _warning("tool.contact_mm", got, expected)


def _speeds(path: ToolPath) -> FloatArray:
    """Largest speeds (L,) on the legs, m/s: of straight ones in the middle, of curved ones at samples."""
    times = np.linspace(path.leg_times[:-1], path.leg_times[1:], _SPEED_SAMPLES, axis=1)
    speeds = np.linalg.norm(path.velocity(times.ravel()), axis=1)
    return np.asarray(speeds.reshape(times.shape).max(axis=1))


def _rounded_up(seconds: float) -> str:
    """To three digits."""
    digit = 10.0 ** (np.floor(np.log10(seconds)) - 2)
    return f"{np.ceil(seconds / digit - _ROUNDING_SHARE) * digit:g}"


def solver_of(options: PlannerOptions) -> Literal["sqp", "slsqp"]:
    """Return the solver that the options ask for, or with ``auto`` the best that is installed.

    Raises
    ------
    MissingExtra
        When it is ``sqp`` and PIQP is not installed.
    """
    if options.solver == "slsqp":
        return "slsqp"
    try:
        piqp_module()
    except MissingExtra:
        if options.solver == "auto":
            return "slsqp"
        raise
    return "sqp"


def oversized(stroke: Stroke, joints: int, options: PlannerOptions) -> Finding | None:
    """Return what is wrong when a problem is too large for the solver that `options` would plan it with."""
    try:
        solver = solver_of(options)
    except MissingExtra:
        return None
    slides = max(joints - task_dimension(stroke.file.keep), 0) if options.knots == "sliding" else 0
    # `SplineSpace.dimension` unknowns a joint, and the slides.
    count = stroke.via_points
    unknowns = (count - SUPPORT) * joints + count * slides
    if solver == "sqp" or unknowns <= MOST_UNKNOWNS:
        return None
    most = (MOST_UNKNOWNS + SUPPORT * joints) // (joints + slides)
    how = "" if importlib.util.find_spec("piqp") is not None else f" ({install_command('fast')})"
    return _warning(
        f"{stroke.key}.via_points",
        f"{count} with solver: slsqp, whose time grows with the cube of their number",
        f"at most {most}, or planner.solver: sqp{how}, whose time grows in proportion",
    )


def require_reasonable_size(scene: Scene, stroke: Stroke, joints: int, options: PlannerOptions) -> None:
    """Refuse a stroke that is `oversized`: a `SceneError` with what to do about it."""
    found = oversized(stroke, joints, options)
    if found is not None:
        raise SceneError(scene.source, found.key, found.got, found.expected)


def _warning(key: str, got: str, expected: str) -> Finding:
    return Finding(severity="warning", key=key, got=got, expected=expected)
