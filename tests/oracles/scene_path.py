"""The timed tool path of a scene by another route than `cmbot.scene`: what a second opinion compares with.

Rotations are products of elementary ones, circles the solution of linear equations, orientations on a line
Rodrigues' formula, and what a profile covers is integrated from phases of constant jerk.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import InputError
from oracles.face_rows import face_rows, tool_direction
from oracles.rotations import rodrigues, rpy, skew
from oracles.speed_laws import (
    TimedLeg,
    covered,
    cruise_share,
    found,
    led,
    led_row,
    reversed_leg,
    with_seconds,
)

__all__ = ["ScenePath"]

_Points = Callable[[FloatArray], FloatArray]
# Neighbouring waypoints that are nearer, m, are one.
_SAME_PLACE = 1e-4
# Durations whose shares agree to this many digits are the same.
_DIGITS = 9
# The largest turn of a rounded corner, rad.
_SHARPEST = float(np.arccos(-0.866))


class _Axis(NamedTuple):
    """Where the tool's axis points, as a pose of the file has it."""

    axis: tuple[float, float, float]
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frame: str = "world"
    rpy_deg: None = None


class _Way(NamedTuple):
    """A straight leg, as the file has it."""

    by: tuple[float, float, float]
    seconds: float | None
    speed_m_s: float | None
    to: None = None
    arc: None = None
    pause: None = None

    @property
    def given_seconds(self) -> float:
        return self.seconds or 0.0


class ScenePath:
    """Where a scene has the tool along a stroke.

    From its pose `p` (3,), m, and `R` (3, 3) in the scene's posture through the strokes before.
    """

    def __init__(self, scene: Any, p: FloatArray, R: FloatArray, number: int = 0) -> None:
        shapes = ((each.name, each.shape, each.X_WO) for each in scene.all_obstacles)
        self._meshes = {name: (shape, X) for name, shape, X in shapes if type(shape).__name__ == "Mesh"}
        for file in scene.strokes[: number + 1]:
            self._file, self._frames = with_seconds(file), {"world": (np.zeros(3), np.eye(3)), "tool": (p, R)}
            for name, frame in scene.frames:
                self._frames[name] = np.array(frame.xyz), rpy(frame.rpy_deg)
            self._legs: list[TimedLeg] = []
            self._follow(p, R)
            p, R = self._lead()
            if file.backwards:
                p, R = self._turn_round()
            once = self._legs
            for _ in range(1, file.passes or 1):
                p, R = self._turn_round()
                once = [*once, *self._legs]
            self._legs = once
            for law in file.time_laws or ():
                self._legs[law.leg] = found(self._legs[law.leg], law)

    def _follow(self, p: FloatArray, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Put the legs together; where the tool is after them."""
        file = self._file
        if file.start_pose is not None:
            p, R = self._goal(file.start_pose, R)
            self._frames["tool"] = p, R
        if file.waypoints is not None:
            return self._add_spline(np.array(file.waypoints, dtype=float))
        if file.raster is not None and file.raster.cylinder is not None:
            return self._add_pipe(file.raster, file.raster.cylinder, R)
        if file.raster is not None and file.raster.mesh is not None:
            rows = self._face_rows(file.raster)
            if any(len(points) > 2 for points, _ in rows):
                return self._add_face_rows(rows, R)
            (p, *_), (axis, *_) = rows[0]
            R = self._goal(_Axis(_three(axis)), R)[1]
            ends = np.vstack([points for points, _ in rows])
            return self._add_legs(p, R, self._timed_legs(np.diff(ends, axis=0)))
        legs = file.legs
        if file.raster is not None:
            p, R, legs = self._raster(file.raster, R)
        return self._add_legs(p, R, legs)

    def _add_legs(self, p: FloatArray, R: FloatArray, legs: Sequence[Any]) -> tuple[FloatArray, FloatArray]:
        """Put straight legs, arcs and pauses together, with rounded corners."""
        file = self._file
        straight: list[FloatArray] = []
        given = cruising = 0.0
        for leg in legs:
            seconds, points, orientations, end, length = self._leg(leg, p, R)
            bends = file.blend_radius_m is not None and leg.pause is None and leg.arc is None
            bends = bends and bool(np.allclose(end[1], R, rtol=0, atol=1e-12))
            bends = bends and float(np.linalg.norm(end[0] - p)) >= 1e-6
            if bends and straight and _turn(straight[-2], p, end[0]) < _SHARPEST:
                self._legs.pop()
                straight.append(end[0])
                points, length = _blended(np.array(straight), file.blend_radius_m or 0.0)
                sides = float(np.linalg.norm(np.diff(straight, axis=0), axis=1).sum())
                given += leg.given_seconds
                cruising += 0.0 if leg.speed_m_s is None else seconds
                # A given speed is that along the rounded corners.
                seconds = given + cruising * length / sides
            else:
                straight = [p, end[0]] if bends else []
                given, cruising = (seconds, 0.0) if leg.speed_m_s is None else (0.0, seconds)
            cruises = given == 0 if straight else leg.speed_m_s is not None
            self._legs.append(TimedLeg(seconds, points, orientations, length, cruises))
            p, R = end
        return p, R

    def _turn_round(self) -> tuple[FloatArray, FloatArray]:
        """Go through the legs from the last to the first; where the tool is after them."""
        self._legs = [reversed_leg(leg) for leg in reversed(self._legs)]
        return self._end()

    def _lead(self) -> tuple[FloatArray, FloatArray]:
        """Add leads; where the tool is after them."""
        file, legs, last = self._file, self._legs, len(self._legs) - 1
        if file.raster is not None and file.blend_radius_m is None:
            if file.speed_tolerance is not None:
                for k in range(0, last + 1, 2):
                    legs[k] = led_row(legs[k], file.speed_profile, file.raster.overscan_m)
            return self._end()
        for k in {0, last}:
            before = (file.lead_in_m or 0.0) if k == 0 else 0.0
            after = (file.lead_out_m or 0.0) if k == last else 0.0
            if before or after:
                legs[k] = led(legs[k], file.speed_profile, before, after)
        return self._end()

    def _end(self) -> tuple[FloatArray, FloatArray]:
        """Where the tool is after the last leg."""
        last = self._legs[-1]
        return last.points(np.ones(1))[0], last.orientations(np.ones(1))[0]

    def process_speeds(self, times: FloatArray) -> FloatArray:
        """Speeds (N,), m/s, that the process has at times (N,), s; zero where there is none."""
        speeds, end = np.zeros(len(times)), 0.0
        for leg in self._legs:
            if leg.phases is not None:
                begin = end + leg.phases[0] * leg.seconds
                inside = (times >= begin) & (times <= begin + leg.phases[1] * leg.seconds)
                speeds[inside] = leg.speed
            end += leg.seconds
        return speeds

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points (N, 3), m, and orientations (N, 3, 3): at rest at the ends of each leg."""
        ends = np.cumsum([each.seconds for each in self._legs])
        leg = np.minimum(np.searchsorted(ends, times), len(ends) - 1)
        p, R = np.empty((len(times), 3)), np.empty((len(times), 3, 3))
        for k in np.unique(leg):
            one = self._legs[k]
            here = leg == k
            left = np.clip((ends[k] - times[here]) / one.seconds, 0.0, 1.0)
            # What is left is what the way back would cover from the start.
            share = 1 - covered(reversed_leg(one), self._file.speed_profile, left)
            p[here], R[here] = one.points(share), one.orientations(share)
        return p, R

    def via_times(self) -> FloatArray:
        """Times of the via-points (k,), s: the ends of the legs, and equal steps within each.

        Each leg has a segment; every further one goes to the leg whose segments are then the longest
        (D'Hondt). A leg with leads counts as three.
        """
        parts = list[float]()
        for leg in self._legs:
            parts += [share * leg.seconds for share in leg.phases or (1.0,)]
        seconds = np.array(parts)
        segments = np.ones(len(seconds), dtype=np.intp)
        shares = np.round(seconds / seconds.sum(), _DIGITS)
        number = self._file.via_points
        if not isinstance(number, int):
            raise InputError("second_opinion", "via_points", number, "a number, as in the scene of a plan")
        for _ in range(number - 1 - len(seconds)):
            segments[np.argmax(shares / (segments + 1))] += 1
        ends = np.cumsum(seconds)
        begins = np.concatenate([[0.0], ends[:-1]])
        steps = (
            begin + (end - begin) * np.arange(number) / number
            for begin, end, number in zip(begins, ends, segments, strict=True)
        )
        return np.concatenate([*steps, ends[-1:]])

    def _leg(
        self, leg: Any, p: FloatArray, R: FloatArray
    ) -> tuple[float, _Points, _Points, tuple[FloatArray, FloatArray], float]:
        """Seconds, points, orientations, the pose at the end and the length of a leg."""
        if leg.arc is not None:
            points, axis, angle, length = self._arc(leg.arc, p)
            turn = axis * angle if leg.arc.turns else np.zeros(3)
        else:
            end, turn = p, np.zeros(3)
            if leg.to is not None:
                end, turn = self._point(leg.to), self._turn_to(leg.to, R)
            way = np.array(leg.by) if leg.by is not None else end - p
            length = float(np.linalg.norm(way))

            def points(share: FloatArray) -> FloatArray:
                return np.asarray(p + share[:, None] * way)

        def orientations(share: FloatArray) -> FloatArray:
            return np.array([rodrigues(s * turn) @ R for s in share])

        seconds = leg.given_seconds or self._cruise(length, leg.speed_m_s)
        pose = points(np.ones(1))[0], orientations(np.ones(1))[0]
        return seconds, points, orientations, pose, length

    def _cruise(self, length: float, speed: float | None) -> float:
        """Seconds in which a leg is covered when the tool cruises at a speed between two ramps."""
        return length / ((speed or np.nan) * cruise_share(self._file.speed_profile))

    def _goal(self, goal: Any, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """A pose in W, from the orientation `R` before."""
        return self._point(goal), rodrigues(self._turn_to(goal, R)) @ R

    def _point(self, goal: Any) -> FloatArray:
        """The point of a pose in W."""
        p_frame, R_frame = self._frames[goal.frame]
        return np.asarray(p_frame + R_frame @ np.array(goal.xyz))

    def _turn_to(self, goal: Any, R: FloatArray) -> FloatArray:
        """The rotation vector in W from the orientation `R` to that of a pose."""
        R_frame = self._frames[goal.frame][1]
        if goal.rpy_deg is not None:
            return np.asarray(Rotation.from_matrix(R_frame @ rpy(goal.rpy_deg) @ R.T).as_rotvec())
        if goal.axis is None:
            return np.zeros(3)
        z = R_frame @ np.array(goal.axis) / np.linalg.norm(goal.axis)
        cross, cosine = np.cross(R[:, 2], z), float(R[:, 2] @ z)
        sine = float(np.linalg.norm(cross))
        if cosine < 0 and sine < 1e-12:
            cross = np.cross(R[:, 2], np.eye(3)[np.abs(R[:, 2]).round(9).argmin()])
            # Its matrix does not say which way half a turn goes.
            return np.asarray(np.pi * cross / np.linalg.norm(cross))
        K = skew(cross)
        # 1 / (1 + cosine), which loses its digits near half a turn.
        share = 1 / (1 + cosine) if cosine > 0 else (1 - cosine) / sine**2
        return np.asarray(Rotation.from_matrix(np.eye(3) + K + share * K @ K).as_rotvec())

    def _arc(self, arc: Any, p: FloatArray) -> tuple[_Points, FloatArray, float, float]:
        """Points by the share, the axis, the angle and the length of an arc from `p`."""
        p_frame, R_frame = self._frames[arc.frame]
        if arc.via is not None and arc.to is not None:
            via, end = (p_frame + R_frame @ np.array(x) for x in (arc.via, arc.to))
            axis = np.cross(via - p, end - p)
            axis /= np.linalg.norm(axis)
            A = np.stack([via - p, end - p, axis])
            b = np.array([(via @ via - p @ p) / 2, (end @ end - p @ p) / 2, axis @ p])
            centre = np.linalg.solve(A, b)
        else:
            axis = R_frame @ np.array(arc.axis) / np.linalg.norm(np.array(arc.axis))
            centre = p_frame + R_frame @ np.array(arc.centre)
            centre = centre + ((p - centre) @ axis) * axis
        arm = p - centre
        if arc.angle_deg is not None:
            angle = float(np.radians(arc.angle_deg))
        else:
            last = end - centre
            angle = float(np.arctan2(np.cross(arm, last) @ axis, arm @ last)) % (2 * np.pi)

        def points(share: FloatArray) -> FloatArray:
            return np.array([centre + rodrigues(s * angle * axis) @ arm for s in share])

        return points, axis, angle, float(np.linalg.norm(arm) * abs(angle))

    def _raster(self, raster: Any, R: FloatArray) -> tuple[FloatArray, FloatArray, tuple[_Way, ...]]:
        """Where a raster begins, and its rows and steps as legs."""
        p_frame, R_frame = self._frames[raster.frame]
        origin, *edges = map(np.array, raster.rectangle or ())
        u, v = (R_frame @ edge for edge in edges)
        width, height = float(np.linalg.norm(u)), float(np.linalg.norm(v))
        out = np.cross(u / width, v / height)
        along, rows = u / width, raster.rows
        out = tool_direction(raster, u / width, v / height, out)
        begin = p_frame + R_frame @ origin + raster.stand_off_m * out
        corners = [begin + x * along + row * v / (rows - 1) for row, x in _ends(raster, width)]
        local = _Axis(_three(-out))
        return corners[0], self._goal(local, R)[1], self._timed_legs(np.diff(corners, axis=0))

    def _timed_legs(self, ways: Sequence[FloatArray] | FloatArray) -> tuple[_Way, ...]:
        """Straight legs of a raster."""
        total = sum(float(np.linalg.norm(way)) for way in ways)
        legs = []
        for way in ways:
            share = float(np.linalg.norm(way)) / total
            seconds = None if self._file.given_time is None else self._file.given_time * share
            legs.append(_Way(_three(way), seconds, self._file.speed_m_s))
        return tuple(legs)

    def _face_rows(self, raster: Any) -> list[tuple[FloatArray, FloatArray]]:
        """Rows over faces of a mesh, each with its points and axes."""
        if raster.mesh in self._meshes:
            mesh, X_WM = self._meshes[raster.mesh]
        else:
            mesh, X_WM = SimpleNamespace(path=Path(str(raster.mesh)), scale=1.0), np.eye(4)
            X_WM[:3, 3], X_WM[:3, :3] = self._frames[raster.frame]
        return face_rows(raster, mesh, X_WM, *self._frames[raster.frame])

    def _add_face_rows(
        self, rows: list[tuple[FloatArray, FloatArray]], R: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Rows on splines with straight steps between them, on which the tool turns."""
        legs: list[tuple[float, _Points, _Points, tuple[float, float] | None]] = []

        def turned(axis: FloatArray, R: FloatArray) -> FloatArray:
            return self._goal(_Axis(_three(axis)), R)[1]

        R = turned(rows[0][1][0], R)
        for k, (points, axes) in enumerate(rows):
            if k > 0:
                before, way, R_before = rows[k - 1][0][-1], points[0] - rows[k - 1][0][-1], R
                R = turned(axes[0], R)
                turn = Rotation.from_matrix(R @ R_before.T).as_rotvec()
                legs.append(
                    (
                        float(np.linalg.norm(way)),
                        partial(_straight, before, way),
                        partial(_turning, turn, R_before),
                        None,
                    )
                )
            each = [R]
            for axis in axes[1:]:
                each.append(turned(axis, each[-1]))
            at, length, places, turns = _spline(points, Rotation.from_matrix(each))
            edges = (float(at[1]), float(1 - at[-2])) if len(at) > 2 else None
            legs.append((length, places, turns, edges))
            R = each[-1]
        file, total = self._file, sum(length for length, *_ in legs)
        for length, places, turns, at_ends in legs:
            share = None if file.given_time is None else file.given_time * length / total
            seconds = share or self._cruise(length, file.speed_m_s)
            self._legs.append(TimedLeg(seconds, places, turns, length, share is None, at_ends))
        return rows[-1][0][-1], R

    def _add_pipe(self, raster: Any, pipe: Any, R: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows over a cylinder: turned and shifted from the pose at the beginning of the first one."""
        p_frame, R_frame = self._frames[raster.frame]
        axis = R_frame @ np.array(pipe.axis) / np.linalg.norm(pipe.axis)
        centre = p_frame + R_frame @ np.array(pipe.centre)
        upright = np.degrees(np.arccos(np.abs(R_frame[:, 2] @ axis))) < 10
        zero = np.cross(axis, np.cross(R_frame[:, 0 if upright else 2], axis))
        zero /= np.linalg.norm(zero)
        # Places as angle, rad, and way along the axis, m.
        angle, places = np.radians(pipe.to_deg - pipe.from_deg), []
        first, low = np.radians(pipe.from_deg), -0.5 * pipe.length
        if pipe.rows == "around":
            for row, x in _ends(raster, pipe.radius * abs(angle)):
                turned = np.sign(angle) * x / pipe.radius
                places.append((first + turned, low + row * pipe.length / raster.steps))
        else:
            for row, x in _ends(raster, pipe.length):
                places.append((first + row * angle / raster.steps, low + x))
        place = places[0]
        out = rodrigues(place[0] * axis) @ zero
        ways = [axis, np.sign(angle) * np.cross(axis, out)]
        back = tool_direction(raster, *(ways[::-1] if pipe.rows == "around" else ways), out)
        p = centre + pipe.radius * out + place[1] * axis + raster.stand_off_m * back
        outer = float(np.linalg.norm(np.cross(axis, p - centre)))
        R = self._goal(_Axis(_three(-back)), R)[1]

        def add(plane: _Points, seconds: float, length: float) -> None:
            def turned(share: FloatArray) -> FloatArray:
                return np.array([rodrigues((x / outer - place[0]) * axis) for x in plane(share)[:, 0]])

            def points(share: FloatArray) -> FloatArray:
                along = (plane(share)[:, 1] - place[1])[:, None] * axis
                return np.asarray(centre + turned(share) @ (p - centre) + along)

            cruises = self._file.given_time is None
            self._legs.append(TimedLeg(seconds, points, lambda share: turned(share) @ R, length, cruises))

        unrolled = np.array([[outer * around, along, 0.0] for around, along in places])
        ways = np.diff(unrolled, axis=0)
        lengths = np.linalg.norm(ways, axis=1)
        file, total = self._file, float(lengths.sum())
        if file.blend_radius_m is not None:
            plane, length = _blended(unrolled, file.blend_radius_m)
            add(plane, file.given_time or self._cruise(length, file.speed_m_s), length)
        else:
            for begin, way, length in zip(unrolled, ways, lengths, strict=False):
                share = None if file.given_time is None else file.given_time * length / total
                add(partial(_straight, begin, way), share or self._cruise(length, file.speed_m_s), length)
        return self._end()

    def _add_spline(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        kept = rows[:1]
        for row in rows[1:]:
            if ((row[:3] - kept[-1, :3]) ** 2).sum() >= _SAME_PLACE**2:
                kept = np.vstack([kept, row])
        _, length, points, turns = _spline(kept[:, :3], Rotation.from_quat(kept[:, 3:], scalar_first=True))
        file = self._file
        seconds = file.given_time or self._cruise(length, file.speed_m_s)
        self._legs.append(TimedLeg(seconds, points, turns, length, file.given_time is None))
        return self._end()


def _spline(points: FloatArray, orientations: Rotation) -> tuple[FloatArray, float, _Points, _Points]:
    """Shares of the points, the length, points and orientations of a spline; through three a parabola."""
    from scipy.interpolate import make_interp_spline
    from scipy.spatial.transform import RotationSpline

    steps = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    at = np.append(0.0, np.cumsum(steps)) / steps.sum()
    spline = make_interp_spline(at, points, k=min(3, len(points) - 1))
    turns = partial(_matrices, RotationSpline(at, orientations))
    return at, _length(spline.derivative(), at), spline, turns


def _ends(raster: Any, length: float) -> list[tuple[int, float]]:
    """Rows, and where on them, m, the tool begins and ends: to and fro over all of them, or their pieces."""
    pieces = [(one.row, one.begin_m, one.end_m) for one in raster.pieces or ()]
    ends = list[tuple[int, float]]()
    for k, (row, begin, end) in enumerate(pieces or [(row, 0.0, length) for row in range(raster.rows)]):
        both = [(row, begin - raster.overscan_m), (row, end + raster.overscan_m)]
        ends += both if k % 2 == 0 else both[::-1]
    return ends


def _turning(turn: FloatArray, R: FloatArray, share: FloatArray) -> FloatArray:
    return np.array([rodrigues(s * turn) @ R for s in share])


def _matrices(orientations: Callable[[FloatArray], Rotation], share: FloatArray) -> FloatArray:
    return np.asarray(orientations(share).as_matrix())


def _straight(begin: FloatArray, way: FloatArray, share: FloatArray) -> FloatArray:
    return np.asarray(begin + share[:, None] * way)


def _three(vector: FloatArray) -> tuple[float, float, float]:
    x, y, z = map(float, vector)
    return x, y, z


def _turn(before: FloatArray, corner: FloatArray, after: FloatArray) -> float:
    """Angle by which the direction changes at a corner, rad."""
    a, b = corner - before, after - corner
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def _length(rate: _Points, at: FloatArray) -> float:
    """Length of a curve, by its derivative between successive parameters."""
    x, weight = np.polynomial.legendre.leggauss(12)
    half = np.diff(at)[:, None] / 2
    speed = np.linalg.norm(rate(at[:-1, None] + half * (x + 1)), axis=-1)
    return float((speed * weight * half).sum())


def _blended(corners: FloatArray, radius: float) -> tuple[_Points, float]:
    """Points by the share of the length of lines whose corners are rounded, and that length."""
    pieces: list[tuple[float, _Points]] = []
    begin = corners[0]

    def line(start: FloatArray, end: FloatArray) -> None:
        pieces.append((float(np.linalg.norm(end - start)), lambda s: start + s[:, None] * (end - start)))

    def arc(centre: FloatArray, first: FloatArray, along: FloatArray, angle: float) -> None:
        arm = first - centre
        across = along * np.linalg.norm(arm)

        def points(s: FloatArray) -> FloatArray:
            return np.asarray(centre + np.cos(s * angle)[:, None] * arm + np.sin(s * angle)[:, None] * across)

        pieces.append((float(np.linalg.norm(arm)) * angle, points))

    for before, corner, after in zip(corners, corners[1:], corners[2:], strict=False):
        a, b = corner - before, after - corner
        room = min(np.linalg.norm(a), np.linalg.norm(b)) / 2
        a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
        half = float(np.arctan2(np.linalg.norm(b - a), np.linalg.norm(b + a)))
        if 2 * half < 1e-6:
            continue
        cut = min(radius * np.tan(half), room)
        centre = corner + (b - a) / np.linalg.norm(b - a) * cut / np.sin(half)
        line(begin, corner - cut * a)
        arc(centre, corner - cut * a, a, 2 * half)
        begin = corner + cut * b
    line(begin, corners[-1])
    ends = np.cumsum([length for length, _ in pieces])

    def points(share: FloatArray) -> FloatArray:
        s = share * ends[-1]
        which = np.minimum(np.searchsorted(ends, s), len(ends) - 1)
        p = np.empty((len(s), 3))
        for k in np.unique(which):
            length, of = pieces[k]
            here = which == k
            p[here] = of((s[here] - ends[k] + length) / length)
        return p

    return points, float(ends[-1])
