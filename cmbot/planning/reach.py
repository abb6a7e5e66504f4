"""Whether strokes lie within the arm's reach, tested before anything is planned.

What the stretched arm does not reach is out of reach. What it does reach may be so by the joint ranges: there
postures are sought at places along every stroke, and where none was found that is said with the number of
attempts.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound
from cmbot.planning.context import PlanningContext, build_context
from cmbot.planning.path.place_search import MissedPlace, worst_missed
from cmbot.planning.selfmotion.reachability import out_of_reach
from cmbot.robot import Finding, Robot
from cmbot.scene import Scene, Stroke

__all__ = ["beyond_reach", "require_postures", "require_within_reach", "without_posture"]

# A stretched arm is not out of its own reach.
_ROUNDING = 1e-9
# Places along a stroke at which postures are sought, and along all strokes; ends of legs come on top.
_PLACES, _ALL_PLACES, _FEWEST = 32, 480, 6
# One for each so long a way, m, and so large a turn of the tool, rad, as `via_points: auto` has them.
_WAY, _TURN = 0.05, np.radians(15)
# Samples of a leg between which its way is taken for straight.
_STEPS = 40


def beyond_reach(stroke: Stroke, robot: Robot) -> Iterator[tuple[str, float]]:
    """Yield the starts and the legs' ends that the stretched arm does not reach: keys, and distances, m.

    Distances are those from the arm's first joint. What lies between two ends within reach is within reach.
    """
    distances = np.linalg.norm(stroke.path.corners[1:] - robot.base_point, axis=1)
    start = float(np.linalg.norm(stroke.path.corners[0] - robot.base_point))
    if stroke.file.start_pose is not None and start > robot.reach * (1 + _ROUNDING):
        yield f"{stroke.key}.from", start
    for k in np.flatnonzero(distances > robot.reach * (1 + _ROUNDING)):
        yield stroke.leg_key(int(k)), float(distances[k])


def require_within_reach(context: PlanningContext) -> None:
    """Refuse a tool path that leaves the reach of the stretched arm; the error names the first such leg."""
    path, robot = context.task.path, context.robot
    for key, distance in beyond_reach(context.stroke, robot):
        away = np.linalg.norm(context.goals.point - robot.base_point, axis=1)
        time = float(context.times[np.argmax(away > robot.reach * (1 + _ROUNDING))])
        remedy = "shorten the leg (lengths are in metres), or take another start posture"
        if context.stroke.begins_elsewhere:
            remedy = "move the tool path (lengths are in metres)"
        what = "lies" if key.endswith(".from") else "ends"
        raise PathNotFound(
            f"{key} {what} {distance:.3f} m from the arm's first joint, {distance - robot.reach:.3f} m out "
            f"of reach (the arm with its tool stretched out is {robot.reach:.3f} m long); {remedy}",
            time=time,
            progress=path.progress(time),
            # The stretched arm cannot move further out.
            smallest_singular_value=0.0,
        )


def require_postures(context: PlanningContext, scene: Scene) -> None:
    """Refuse strokes with places for which no posture is found; the error names the worst of the first one.

    The tool has to be held there within the joint ranges; and on strokes after the first one, which is
    planned at once, clear of obstacles and strongly enough.
    """
    for number, stroke in enumerate(context.strokes):
        at = context.at_stroke(number, scene, context.posture, 0.0, 0.0)
        missed = None if _is_cut(stroke) else _worst_missed(at, clear=number > 0)
        if missed is None:
            continue
        times = _times(at)
        time, first = float(times[missed.place]), float(times[~missed.found][0])
        proven = not missed.is_held and bool(out_of_reach(at, int(np.abs(at.times - time).argmin())))
        failure = PathNotFound(
            f"{stroke.leg_key(_leg(stroke, time))} is {_reason(at, missed, time, proven=proven)}; "
            f"{_remedy(at, missed)}",
            time=first,
            progress=stroke.path.progress(first),
            smallest_singular_value=0.0,
        )
        if len(context.strokes) > 1:
            failure.add_hint(f"this is stroke {stroke.name}")
        raise failure


def without_posture(scene: Scene) -> Iterator[Finding]:
    """Yield a warning for each stroke with places for which no posture is found.

    The tool has to be held there within the joint ranges, clear of obstacles and strongly enough.
    """
    context = build_context(scene, scene.planner)
    for number, stroke in enumerate(context.strokes):
        if any(beyond_reach(stroke, context.robot)):
            continue
        at = context.at_stroke(number, scene, context.posture, 0.0, 0.0)
        missed = _worst_missed(at, clear=True)
        if missed is not None:
            time = float(_times(at)[missed.place])
            remedy = "planning cuts its rows to what is" if _is_cut(stroke) else _remedy(at, missed)
            yield Finding(
                severity="warning",
                key=stroke.leg_key(_leg(stroke, time)),
                got=f"a path that is {_reason(at, missed, time)}",
                expected=f"a path within reach: {remedy}",
            )


def _worst_missed(context: PlanningContext, *, clear: bool) -> MissedPlace | None:
    goals, margin = context.task.goals(_times(context)), context.options.safety_margin_m

    def violation(q: FloatArray) -> FloatArray:
        weak = context.use_at_rest(context.postures.at(q)) - 1.0
        near = (margin - context.clearances.smallest(q).distance) / max(margin, _ROUNDING)
        return np.asarray(np.maximum(np.maximum(weak, near), 0.0))

    return worst_missed(context.robot, context.task, goals, context.posture, violation if clear else None)


def _is_cut(stroke: Stroke) -> bool:
    """Whether a raster is cut to what the arm reaches."""
    raster = stroke.file.raster
    return raster is not None and raster.cover == "reachable" and raster.frame != "tool"


def _times(context: PlanningContext) -> FloatArray:
    """Times (k,), s, of places along the stroke, even in length and turn, whatever its via-points are."""
    path = context.stroke.path
    most = max(min(_PLACES, _ALL_PLACES // len(context.strokes)), _FEWEST)
    legs = np.linspace(path.leg_times[:-1], path.leg_times[1:], _STEPS, endpoint=False, axis=1)
    fine = np.append(legs.ravel(), path.leg_times[-1])
    steps = np.linalg.norm(np.diff(path.position(fine), axis=0), axis=1) / _WAY
    if path.turns:
        chords = np.linalg.norm(np.diff(path.rotation(fine), axis=0), axis=(1, 2)) / np.sqrt(8)
        steps += 2 * np.arcsin(np.minimum(chords, 1.0)) / _TURN
    way = np.concatenate([[0.0], np.cumsum(steps)])
    number = int(np.clip(np.ceil(way[-1]) + 1, _FEWEST, most))
    ends = path.section_times
    ends = ends[np.unique(np.linspace(0, len(ends) - 1, most).round().astype(np.intp))]
    return np.unique(np.concatenate([ends, np.interp(np.linspace(0, way[-1], number), way, fine)]))


def _leg(stroke: Stroke, time: float) -> int:
    """The leg that leads to a time."""
    edges = stroke.path.leg_times
    return int(np.clip(np.searchsorted(edges, time) - 1, 0, len(edges) - 2))


def _place(stroke: Stroke, time: float) -> str:
    point = ", ".join(f"{x:.3f}" for x in stroke.path.position([time])[0])
    return f"({point}) m"


def _reason(context: PlanningContext, missed: MissedPlace, time: float, *, proven: bool = False) -> str:
    """What is the matter with a place, by how much, and how many are like it."""
    keep = context.stroke.file.keep
    kept = keep if isinstance(keep, str) else "axis"
    also = f"{int((~missed.found).sum())} of {len(missed.found)} places are like it"
    if missed.is_held:
        smallest, margin = context.clearances.smallest(missed.best[None]), context.options.safety_margin_m
        use = float(context.use_at_rest(context.postures.at(missed.best[None]))[0])
        pair = context.clearances.pairs[int(smallest.pair[0])]
        best = pair.describe(float(smallest.distance[0]), margin)
        if use > 1.0:
            best = f"{context.weakest_joint(missed.best[None])} uses {use:.0%} of its torque"
        return (
            f"blocked at {_place(context.stroke, time)}: none of {missed.attempts} attempts to hold the "
            f"tool's {kept} is clear and strong enough, at best {best}; {also}"
        )
    held = f"no posture within the joint ranges that holds the tool's {kept} was found in {missed.attempts}"
    held = f"{held} attempts"
    if proven:
        held = f"no posture within the joint ranges holds the tool's {kept} (proven)"
    off = f"{1e3 * missed.distance:.3g} mm"
    if kept != "position":
        off += f" and {np.degrees(missed.angle):.2g} deg"
    end = f" ({missed.joint} at an end)" if missed.joint else ""
    return f"out of reach at {_place(context.stroke, time)}: {held}, the nearest is {off} off{end}; {also}"


def _remedy(context: PlanningContext, missed: MissedPlace) -> str:
    what = "obstacles or tool path" if missed.is_held else "the tool path"
    return f"move {what}, or keep less of the pose ({context.stroke.key}.keep)"
