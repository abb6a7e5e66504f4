"""Whether strokes lie within the arm's reach, tested before anything is planned.

What the stretched arm does not reach is out of reach. What it does reach may be so by the joint ranges: there
postures are sought at places along every stroke, and where none was found that is said with the number of
attempts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from math import ceil

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.path.nearest_miss import nearest_miss
from cmbot.planning.request import StrokeRequest, build_request, in_cells, strokes_of, task_of
from cmbot.planning.selfmotion.reachability import REACH_TOLERANCE, out_of_reach
from cmbot.planning.workcell.workcell import robot_of
from cmbot.robot import Finding, Robot
from cmbot.scene import Scene, Stroke

# Leans of a raster's tool that are tried, degrees.
_LEANS = ((0.0, 15.0), (0.0, -15.0), (15.0, 0.0), (-15.0, 0.0))
# Shares of a load that are tried.
_LIGHTER = (0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
# Bounds of feet that are raised one after the other.
_FIRMER_FEET = 6
# By how much more than at rest feet are to bear: a motion asks more, and needs room besides. With clamps for
# a flange below a web no plan was found with 1.05, one in 59 s with 1.1, in 41 s with 1.15 (processor time);
# the triangle and the gusset plate are planned with each of the three, in 3 to 4 s.
_IN_MOTION = 1.15


def beyond_reach(stroke: Stroke, robot: Robot) -> Iterator[tuple[str, FloatArray, float]]:
    """Yield starts and legs' ends that the stretched arm does not reach: keys, places (3,), distances.

    Distances, m, are those from the arm's first joint. What lies between two ends within reach is within
    reach. None are yielded where the tool is fixed, whose distance says nothing.
    """
    if robot.fixed_tool is not None:
        return
    corners = stroke.path.corners
    distances = np.linalg.norm(corners - robot.base_point, axis=1)
    for k in np.flatnonzero(distances > robot.reach * (1 + REACH_TOLERANCE)):
        if k > 0:
            yield stroke.leg_key(int(k) - 1), corners[k], float(distances[k])
        elif stroke.file.start_pose is not None:
            yield f"{stroke.key}.from", corners[k], float(distances[k])


def require_within_reach(request: StrokeRequest) -> None:
    """Refuse a tool path that leaves the reach of the stretched arm; the error names the first such leg."""
    path, robot = request.task.path, request.cell.robot
    for key, place, distance in beyond_reach(request.stroke, robot):
        away = np.linalg.norm(request.goals.point - robot.base_point, axis=1)
        time = float(request.times[np.argmax(away > robot.reach * (1 + REACH_TOLERANCE))])
        as_point, joint = (", ".join(f"{x:.3f}" for x in at) for at in (place, robot.base_point))
        what = "lies" if key.endswith(".from") else "ends"
        raise PathNotFound(
            f"{key} {what} at ({as_point}) m, {distance:.3f} m from the arm's first joint at ({joint}) m, "
            f"{distance - robot.reach:.3f} m out of reach (the arm with its tool stretched out is "
            f"{robot.reach:.3f} m long, in metres)",
            time=time,
            progress=path.progress(time),
            # The stretched arm cannot move further out.
            smallest_singular_value=0.0,
            key=key,
        )


def require_postures(request: StrokeRequest) -> None:
    """Refuse strokes with places for which no posture is found; the error names the worst of the first one.

    The tool has to be held there within the joint ranges; and on strokes after the first one, which is
    planned at once, clear of obstacles and strongly enough.
    """
    for number, stroke in enumerate(request.strokes):
        if not _is_cut(stroke):
            require_posture(request.at_stroke(number), is_clear=number > 0)


def require_posture(request: StrokeRequest, *, is_clear: bool) -> None:
    """Refuse a stroke with places for which no posture is found; the error names the worst of them.

    The tool has to be held there within the joint ranges, and clear of obstacles and strongly enough where
    `is_clear`.
    """
    miss = nearest_miss(request, is_clear=is_clear)
    if miss is None:
        return
    there = replace(request, times=np.array([miss.time]))
    proven = not miss.missed.is_held and bool(out_of_reach(there, 0))
    failure = PathNotFound(
        f"{miss.key} is {miss.reason(proven=proven)}",
        time=miss.first_time,
        progress=request.task.path.progress(miss.first_time),
        smallest_singular_value=0.0,
        pair=miss.pair,
        key=miss.key,
    )
    of = f"this is stroke {request.stroke.name}" if len(request.strokes) > 1 else ""
    # Hints are the last to be shortened.
    for hint in filter(None, (of, miss.remedy())):
        failure.add_hint(hint)
    raise failure


def without_posture(scene: Scene) -> Iterator[Finding]:
    """Yield a finding for each stroke with places for which no posture is found.

    The tool has to be held there within the joint ranges, clear of obstacles and strongly enough. It is an
    error where planning refuses the stroke for it, and where no place has a posture.

    Parameters
    ----------
    scene : Scene
    """
    request = build_request(scene, scene.planner)
    for number, stroke in enumerate(request.strokes):
        if any(beyond_reach(stroke, request.cell.robot)):
            continue
        at = request.at_stroke(number)
        miss = nearest_miss(at, is_clear=True)
        if miss is not None:
            some, is_cut = bool(miss.missed.found.any()), _is_cut(stroke)
            left_out = "rows beyond it are left out" if some and is_cut else ""
            wanted = (
                "feet that bear it" if miss.feet_bind else "joints that bear it" if miss.joints_bind else ""
            )
            remedy = leaning(scene, at) or lighter(scene, at) or firmer(scene, at)
            remedy = remedy or ("" if left_out else miss.remedy())
            remedy = "; ".join(filter(None, (left_out, remedy)))
            is_refused = not some or (not is_cut and (number > 0 or not miss.missed.is_held))
            yield Finding(
                severity="error" if is_refused else "warning",
                key=miss.key,
                got=f"a path that is {miss.reason()}",
                expected=": ".join(filter(None, (wanted or "a path within reach", remedy))),
                remedy=remedy,
            )


def lighter(scene: Scene, request: StrokeRequest) -> str:
    """Return with which part of the process force, or of the payload, every place has a posture.

    Empty where none is found, or where it is not joints that are too weak.
    """
    cell, miss = request.cell, nearest_miss(request, is_clear=True)
    if miss is None or not miss.joints_bind:
        return ""
    q, robot = miss.missed.best[None], scene.robot
    loads = ("tool.process_force_n", scene.tool.process_force_n), ("robot.payload_kg", robot.payload_kg)
    for key, load in loads:
        for share in _LIGHTER if np.any(load) else ():
            each = [float(f"{share * part:.2g}") for part in np.atleast_1d(load)]
            less = each if len(each) > 1 else each[0]
            with_less = replace(cell, robot=robot_of(scene.with_values({key: less})))
            waits = with_less if scene.planner.stays else with_less.tool_off
            at_rest = (with_less, q), (waits, scene.posture[None])
            if not all(each.strong(each.postures.at(posture))[0] for each, posture in at_rest):
                continue
            if nearest_miss(replace(request, cell=with_less), is_clear=True) is None:
                return f"{key} {less} instead of {np.array(load).tolist()} would do at rest"
    return ""


def firmer(scene: Scene, request: StrokeRequest) -> str:
    """Return with which bounds its feet bear the start, and a posture for every place of a stroke.

    Empty where none is found, or where it is not the feet that are too weak.
    """
    asked, values = scene, dict[str, object]()
    for _ in range(_FIRMER_FEET):
        feet = tuple(replace(foot, safety=_IN_MOTION * foot.safety) for foot in robot_of(asked).feet)
        cell = replace(request.cell, robot=replace(request.cell.robot, feet=feet))
        if (holding := cell.robot.holding) is None or not holding.bounded:
            break
        miss = nearest_miss(replace(request, cell=cell), is_clear=True)
        if miss is not None and not miss.feet_bind:
            break
        cases = [(cell.tool_off, scene.posture), *([] if miss is None else [(cell, miss.missed.best)])]
        wrenches = [each.postures.at(q[None]).guardrail_wrench for each, q in cases]
        use = max((holding.most_used(wrench) for wrench in wrenches), key=lambda each: each.share)
        if use.share <= 1.0:
            words = " and ".join(f"{key} {value}" for key, value in values.items())
            room = f"would do at rest, with {_IN_MOTION - 1:.0%} for the motion"
            return words and f"{words} {room}{', or cmbot stand' * scene.is_movable}"
        foot, (key, hold) = holding.feet[use.foot], asked.hold_of(use.foot)
        each = [ceil(bound) for bound in np.atleast_1d(getattr(hold, use.bound))]
        each[use.axis] = 10 * ceil(use.share * each[use.axis] / 10)
        if use.bound == "adhesion_n" and each[0] > foot.most_adhesion:
            return f"no magnet pulls more than {foot.most_adhesion / 1e3:.1f} kN there: a clamp may do"
        values[f"{key}.{use.bound}"] = each if len(each) > 1 else each[0]
        asked = scene.with_values(values)
    return ""


def upright(request: StrokeRequest) -> str:
    """Return what is in the way in the middle of the cone of the tool's axis; empty where nothing is."""
    miss = None if request.task.cone is None else nearest_miss(request.on_axis, is_clear=True)
    return "" if miss is None else f"not leaning, at {miss.where} {miss.at_best}"


def leaning(scene: Scene, request: StrokeRequest) -> str:
    """Return with which lean of a raster's tool every place has a posture; empty where none is found."""
    robot, number, key = request.cell.robot, request.number, request.stroke.key
    files = in_cells(scene, robot).strokes
    raster, keep = files[number].raster, "" if files[number].keep == "axis" else " and keep axis"
    if raster is None or raster.lean_deg is not None:
        return ""
    for lean in _LEANS:
        file = files[number].changed(raster=replace(raster, lean_deg=lean), keep="axis")
        other = scene.with_strokes((*files[:number], file, *files[number + 1 :]))
        strokes = strokes_of(other, robot)
        leant = replace(request, strokes=strokes, task=task_of(strokes[number], other))
        if nearest_miss(leant, is_clear=True) is None:
            angles = ", ".join(f"{angle:g}" for angle in lean)
            return f"with {key}.raster.lean_deg [{angles}]{keep} every place has a posture"
    return ""


def _is_cut(stroke: Stroke) -> bool:
    """Whether a raster is cut to what the arm reaches."""
    raster = stroke.file.raster
    return raster is not None and raster.cover == "reachable" and raster.frame != "tool"
