"""The motions of a plan (its job, and the baseline if any) as the pages replay them, at equal time steps."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from cmbot.collision import Clearances
from cmbot.common.arrays import FloatArray, IntArray, interpolated
from cmbot.common.errors import InputError
from cmbot.common.reading.validation import require_type
from cmbot.planning import (
    APPROACH,
    RETURN,
    BaselineSegment,
    MotionMetrics,
    Plan,
    Samples,
    Segment,
    figures,
    job_metrics,
    measure,
)
from cmbot.robot import Kinematics, Robot
from cmbot.simulation import MotionTracking, Tracking
from cmbot.views.charts import floor_name, work_begins, work_ends
from cmbot.views.drawing.bending import Bending, Intervals, drawn_factor, most_factor
from cmbot.views.drawing.bridge import bridge_of, jobs_of
from cmbot.views.drawing.camera import ARROW, focus_of, link_poses
from cmbot.views.drawing.meshcat_scene import Command, bridge_commands, encoded, reach, scene_commands
from cmbot.views.drawing.support import supports
from cmbot.views.page import pack, pack_exactly

FRAME_STEP = 0.02  # between two frames, s, where `MOST_POSES` allows it; the page interpolates
MOST_POSES = 12_000  # frames times links, of the whole job
_PAIR_SEPARATOR = " – "  # two names of a pair
# Links whose distance varies by less than this, m, in so many of a motion's postures are always as near.
_AS_NEAR, _LOOKED_AT = 1e-3, 12
_ALL_TIMES: Intervals = ((0.0, np.inf),)


def replay_data(plan: Plan, tracking: Tracking | None = None) -> dict[str, Any]:
    """Return the page's data, ready for JSON; `Frames.motion` documents each motion.

    All times are on the planned job's clock, on which the baseline begins to work when the planned motion
    does: the work lasts from ``workStart`` to ``workEnd``. Before it, from ``start``, both arms approach, and
    after it, until ``end``, they return; with `tracking`, and without a return, they rest until then.
    ``moves`` are the planned free moves between strokes: name, begin and end, s.
    """
    if tracking is not None:
        require_type(tracking, Tracking, "tracking", "", "a Tracking, as cmbot.simulate returns it")
    begin, work_end = work_begins(plan), work_ends(plan)
    start, back = begin - _seconds(plan, APPROACH), _seconds(plan, RETURN)
    end = work_end if tracking is None else begin + _end(plan, tracking)
    if back > 0:
        end = work_end + back
    step = max(FRAME_STEP, (end - start) * plan.robot.dof / MOST_POSES)
    frames = Frames(plan, tracking=tracking)
    times = frame_times(0.0, work_end - begin, step)
    knots, strokes = plan.job.trajectory, zip(plan.job.strokes, plan.strokes, strict=True)
    legs = [segment.begin + stroke.task.path.leg_times for segment, stroke in strokes]
    motions = {
        "title": plan.scene.name,
        "start": start,
        "workStart": begin,
        "workEnd": work_end,
        "end": end,
        "legTimes": np.unique(np.concatenate(legs)).tolist(),
        "moves": [[each.name, each.begin, each.end] for each in plan.job.moves_between],
        "segments": [[each.name, each.begin, each.end] for each in plan.job.segments],
        "knots": {name: pack_exactly(getattr(knots, name)) for name in ("t", "q", "v", "a")},
        "floor": plan.torque_floor,
        "floorName": floor_name(plan),
        "approach": _approach(plan, frames, frame_times(start, begin, step)) if start < begin else None,
        **_at_work(plan, frames, times, tracking),
        "return": None,
        "rest": None,
    }
    if back > 0:
        label, times = {"label": "return, tool off"}, frame_times(0.0, back, step)
        motions["return"] = label | _free_moves(plan, frames, RETURN, times)
    elif tracking is not None and end > work_end:
        motions["rest"] = _rest(plan, tracking, frames, frame_times(work_end, end, step) - begin)
    return motions | stage_data([plan], [frames])


def stage_data(
    plans: Sequence[Plan], frames: Sequence[Frames], others: Sequence[Command] = ()
) -> dict[str, Any]:
    """Return the data of the 3-D view: what is drawn around the first of some plans, and `others` commands.

    It is asked for with all motions: then it is known how far the arms bend and what is near them.
    """
    first, pairs = plans[0], frames[0].pairs
    length, margin = reach(first.robot), min(plan.options.safety_margin_m for plan in plans)
    bridge = bridge_of(first.scene, jobs_of(plans), margin)
    bending, bent = bending_of(frames, length)
    drawn = [*scene_commands(first), *bridge_commands(bridge), *others]
    return {
        "robot": first.robot.name,
        "base": first.scene.base_name,
        "foot": list(first.robot.foot_point),
        "links": link_names(first.robot),
        "joints": list(first.robot.joints),
        "margin": margin,
        "bending": bending,
        "pairs": list(pairs),
        "pairJoints": pair_joints(first, pairs),
        "focus": focus_of(first, plans, bent, bridge),
        "reach": length,
        "arrow": ARROW * length,
        "around": bool(bridge),
        "commands": encoded(drawn),
    }


class Frames:
    """Samples motions for the page.

    Parameters
    ----------
    plan : Plan
    pairs : dict of str to int, optional
        The names of near pairs of shapes so far with their numbers; others are added.
    tracking : Tracking, optional
        Of that plan.
    """

    def __init__(
        self, plan: Plan, pairs: dict[str, int] | None = None, tracking: Tracking | None = None
    ) -> None:
        self._robot = plan.robot
        self._near = plan.options.avoidance_distance_m
        self.bending = Bending.of(plan, tracking)
        self.clearances = Clearances(plan.robot, plan.scene.all_obstacles)
        self.pairs = {} if pairs is None else pairs
        # Some postures and elastic coordinates of the motions so far.
        self._bent: list[tuple[Bending, FloatArray, FloatArray]] = []

    @property
    def deflection(self) -> float:
        """The largest displacement of the tool by bending in the motions so far, m."""
        tools = [[bent.poses(q, each)[1] for each in (0 * u, u)] for bent, q, u in self._bent]
        return max((float(np.linalg.norm(a - b, axis=1).max()) for a, b in tools), default=0.0)

    def bent(self, factor: float) -> list[FloatArray]:
        """Return poses (K, n, 7) of the links in the motions so far, their bending times a factor."""
        return [bent.poses(q, factor * u)[0] for bent, q, u in self._bent]

    def motion(
        self,
        samples: Samples,
        metrics: MotionMetrics,
        times: FloatArray,
        tracking: MotionTracking | None = None,
        on: Intervals = (),
    ) -> dict[str, Any]:
        """Return a motion at `times` (F,), ready for JSON; arrays are packed, in W and SI units.

        ``poses`` (F, n, 7) are those of the arm's joint frames, as position and quaternion x, y, z, w;
        ``near`` (F, 7) the nearest points on the arm and on the other shape and the distance of that pair,
        ``pair`` (F,) an index into `pairs`, -1 where nothing is near; ``tool`` (F, 3) the expected tool
        point, with its predicted sag where that is compensated, as ``expected`` tells; ``error`` (F, 3) the
        tracking error from there, null without `tracking`; ``q`` (F, n) the joint positions and ``u`` (F, f)
        the elastic coordinates, null where nothing bends, with the tool `on` in these intervals;
        ``load`` (F, n) the joints' torques as shares of their bounds;
        ``hold`` (F,) the share that the arm uses of what the feet bear, null where that is not known;
        ``strain`` the largest of guardrail and links.
        After its last sample the motion rests there.
        """
        q = interpolated(times, samples.t, samples.q)
        near, pair = self._nearest(q)
        dynamic = None if tracking is None else interpolated(times, tracking.t, tracking.dynamic)
        u = None
        if self.bending is not None:
            u = self.bending.coordinates(times, q, dynamic, on)
            some = slice(None, None, max(1, len(q) // _LOOKED_AT))
            self._bent.append((self.bending, q[some], u[some]))
        load = np.abs(interpolated(times, samples.t, samples.joint_torque)) / self._robot.limits.torque
        hold = self._hold(samples)
        expected = samples.expected_tool_point
        kinematics, error = Kinematics(self._robot), None
        tool = kinematics.tool_poses(q)[0] if expected is None else interpolated(times, samples.t, expected)
        shown = kinematics.in_world(q, tool)
        if tracking is not None:
            error = kinematics.in_world(q, tool + interpolated(times, tracking.t, tracking.error)) - shown
        return {
            "poses": pack(link_poses(self._robot, q)),
            "torque": pack(interpolated(times, samples.t, samples.guardrail_torque)),
            "clearance": pack(np.interp(times, samples.t, samples.clearance)),
            "near": pack(near),
            "pair": pack(pair),
            "q": pack(self._robot.coupling.positions(q)),
            "u": None if u is None else pack(u),
            "load": pack(load),
            "hold": None if hold is None else pack(np.interp(times, samples.t, hold)),
            "tool": pack(shown),
            "expected": expected is not None,
            "error": None if error is None else pack(error),
            "strain": 0.0 if u is None or self.bending is None else self.bending.largest_strain(u),
            "peakTorque": metrics.peak_guardrail_torque,
            # Infinite without a pair of shapes that can collide; JSON has no infinity.
            "minClearance": metrics.min_clearance if np.isfinite(metrics.min_clearance) else None,
        }

    def _hold(self, samples: Samples) -> FloatArray | None:
        holding = self._robot.holding
        if holding is None or not holding.bounded:
            return None
        return holding.share(np.hstack([samples.guardrail_force, samples.guardrail_torque]))[0]

    def _nearest(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Nearest points with their distances (F, 7), and pairs (F,) in postures `q` (F, n).

        Links that are always as near to each other tell nothing: then what can be avoided is shown, if near.
        """
        near, pairs = np.zeros((len(q), 7)), np.full(len(q), -1.0)
        smallest = self.clearances.query(q)
        nearest, distance = smallest.pair.copy(), smallest.distance.copy()
        if (fixed := np.isin(nearest, self._fixed(q, nearest))).any():
            other = self.clearances.query(q, avoidable_only=True)
            instead = fixed & (other.distance < self._near)
            nearest[instead], distance[instead] = other.pair[instead], other.distance[instead]
        for k in np.flatnonzero(distance < self._near):
            number = int(nearest[k])
            near[k, :6], shapes = self.clearances.nearest_points(q[k], number), self.clearances.pairs[number]
            pairs[k] = self.pairs.setdefault(f"{shapes.link}{_PAIR_SEPARATOR}{shapes.other}", len(self.pairs))
        near[:, 6] = np.where(pairs < 0, 0.0, distance)
        return near, pairs

    def _fixed(self, q: FloatArray, pairs: IntArray) -> list[int]:
        """Which of `pairs` are as near in all of the postures `q` (F, n), as some of them tell."""
        some = np.unique(np.linspace(0, len(q) - 1, _LOOKED_AT).astype(int))
        found = []
        for pair in np.unique(pairs[pairs >= 0]).tolist():
            distance = self.clearances.distances(q, some, np.full(len(some), pair))
            if np.ptp(distance) < _AS_NEAR:
                found.append(pair)
        return found


def frame_times(start: float, end: float, step: float) -> FloatArray:
    """Return equally spaced times from `start` to `end`, at most `step` apart."""
    return np.linspace(start, end, max(int(np.ceil((end - start) / step)), 1) + 1)


def bending_of(frames: Sequence[Frames], reach: float) -> tuple[dict[str, Any] | None, list[FloatArray]]:
    """Return how the arms bend, with the factors that suit the motions of all; None where none does.

    And poses (K, n, 7) of the arms' links in all motions, as they are bent by the first factor.
    """
    deflection = max(each.deflection for each in frames)
    factor = drawn_factor(deflection, reach)
    poses = [bent for each in frames for bent in each.bent(factor)]
    arms = [each.bending for each in frames]
    if not any(arms):
        return None, poses
    return {
        "chains": [None if arm is None else arm.data() for arm in arms],
        "simulated": any(arm is not None and arm.simulated for arm in arms),
        "factors": (factor, most_factor(deflection, reach)),
    }, poses


def pair_joints(plan: Plan, pairs: Iterable[str]) -> list[list[int]]:
    """Return the joints that carry the two shapes of pairs of `Frames`.

    0: the base; -1: none; -2: the shape bends below the base.
    """
    bodies = {obstacle.name: -2 for obstacle in supports(plan.scene)}
    bodies |= {frame.name: int(frame.parentJoint) for frame in plan.robot.model.frames}
    return [[bodies.get(name, -1) for name in pair.partition(_PAIR_SEPARATOR)[::2]] for pair in pairs]


def link_names(robot: Robot) -> list[str]:
    """Return the name of the link that each joint of the arm moves: its frame is the joint's."""
    bodies = [frame for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    return [
        next((frame.name for frame in bodies if frame.parentJoint == joint), robot.model.names[joint])
        for joint in range(1, robot.model.njoints)
    ]


def _end(plan: Plan, tracking: Tracking) -> float:
    """When the simulation of the work ends, s; an `InputError` with the tracking errors of another plan."""
    durations = {"planned": float(plan.samples.t[-1])}
    if plan.baseline is not None:
        durations["baseline"] = float(plan.baseline.samples.t[-1])
    names = [name for name, _ in tracking.motions]
    if set(names) != durations.keys():
        got, expected = " and ".join(names), f"{' and '.join(durations)}: the tracking errors of this plan"
        raise InputError("tracking", "motions", got, expected)
    for name, motion in reversed(tracking.motions):
        duration = durations[name]
        if not np.isclose(motion.stop, duration, rtol=1e-9, atol=0.0):
            expected = f"{duration:g} s, the plan's duration: the tracking errors of this plan"
            raise InputError("tracking", f"{name}.stop", f"{motion.stop:g} s", expected)
    return max(*durations.values(), *(float(motion.t[-1]) for _, motion in tracking.motions))


def _at_work(plan: Plan, frames: Frames, times: FloatArray, tracking: Tracking | None) -> dict[str, Any]:
    """Return the motions at work; ``motions`` are named where they are not the planned one and a baseline."""
    tracked = {} if tracking is None else dict(tracking.motions)
    on, baseline = _on(plan.job.segments), plan.baseline
    planned = frames.motion(plan.samples, plan.work.figures, times, tracked.get("planned"), on)
    if baseline is None:
        return {"planned": planned, "motions": ["planned"], "names": {}}
    on, figures_of_work = _on(baseline.segments), job_metrics(baseline.work)
    other = frames.motion(baseline.samples, figures_of_work, times, tracked.get("baseline"), on)
    return {"planned": planned, "baseline": other}


def _approach(plan: Plan, frames: Frames, times: FloatArray) -> dict[str, Any]:
    """Return the arms' ways to the work; each arrives when it begins, and rests before."""
    return {"label": "approach, tool off", **_free_moves(plan, frames, APPROACH, times)}


def _free_moves(plan: Plan, frames: Frames, name: str, times: FloatArray) -> dict[str, Any]:
    """Return the arms' free moves of a name: approaches end at the last of `times`, s, returns begin at 0.

    An arm without such a move rests where its work begins or ends.
    """
    end = 0 if name == APPROACH else -1
    moves: dict[str, tuple[Segment | BaselineSegment | None, Samples | None, FloatArray]] = {
        "planned": (plan.job.segment(name), plan.segment_samples.get(name), plan.trajectory.q[end])
    }
    if (other := plan.baseline) is not None:
        move = other.segment(name)
        moves["baseline"] = (move, None if move is None else move.samples, other.samples.q[end])
    shown = {}
    for motion, (segment, samples, q) in moves.items():
        if segment is None or samples is None:
            shown[motion] = _still(plan, frames, q, times[[0, -1]])
        else:
            clock = times - (times[-1] - segment.duration) if name == APPROACH else times
            shown[motion] = frames.motion(samples, segment.figures, clock)
    return shown


def _seconds(plan: Plan, name: str) -> float:
    """How long the arms' free moves of a name take, the longer one, s; 0 without."""
    moves = [plan.job.segment(name), None if plan.baseline is None else plan.baseline.segment(name)]
    return max(0.0 if move is None else move.duration for move in moves)


def _still(plan: Plan, frames: Frames, q: FloatArray, times: FloatArray) -> dict[str, Any]:
    """Return an arm that rests in a posture (n,), its tool off, between two `times` (2,)."""
    posture, off = np.repeat(q[None], 2, axis=0), plan.robot.tool_off
    rates = np.zeros((3, *posture.shape))
    samples = measure(off, plan.task, frames.clearances, times, [posture, *rates])
    return frames.motion(samples, figures(off, samples), times) | {"still": True}


def _rest(plan: Plan, tracking: Tracking, frames: Frames, times: FloatArray) -> dict[str, Any]:
    """Return the arms after the stop: their joints rest while the elastic parts vibrate."""
    rest: dict[str, Any] = {"label": "after the stop"}
    rest["planned"] = frames.motion(plan.samples, plan.figures, times, tracking.planned, _ALL_TIMES)
    if (other := plan.baseline) is not None:
        rest["baseline"] = frames.motion(other.samples, other.figures, times, tracking.baseline, _ALL_TIMES)
    return rest


def _on(segments: Sequence[Segment | BaselineSegment]) -> list[tuple[float, float]]:
    """Return when the tool is on, s, from the beginning of the work."""
    strokes = [segment for segment in segments if segment.kind == "stroke"]
    begin = strokes[0].begin
    return [(segment.begin - begin, segment.end - begin) for segment in strokes]
