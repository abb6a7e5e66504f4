"""The timed tool path that legs, waypoints or a raster make."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import SceneError
from cmbot.common.poses import pose, turned_pose
from cmbot.common.reading.fields import SHORTEST_LEG
from cmbot.common.reading.validation import counted
from cmbot.toolpath.curves import Arc, Blend, Curve, CylinderCurve, Line, Spline, rounded
from cmbot.toolpath.leads import CurveWithLeads
from cmbot.toolpath.legs import AUTO, ArcTo, Goal, Leg
from cmbot.toolpath.path_source import PathDescription, PathSource
from cmbot.toolpath.raster.face_rows import FaceRows, FaceSurface
from cmbot.toolpath.raster.raster import CylinderPatch, Raster, RowPiece
from cmbot.toolpath.raster.rows import cylinder_corners, rectangle_axes, rectangle_corners, tool_cylinder
from cmbot.toolpath.raster.surface import Surface
from cmbot.toolpath.stretches import Fit, stretches, waypoint_poses
from cmbot.toolpath.time_law import ProcessPart, TimeLaw, law_with_leads
from cmbot.toolpath.tool_path import Segment, ToolPath
from cmbot.toolpath.tool_poses import shortest_turns

# Angle below which a turn is none, rad.
_ZERO_ANGLE = 1e-12
# A turn in place is as quick as the tool moves at this distance from its axis, m.
_TURN_LEVER_M = 0.1
# First guesses of speeds where the shortest time is to be found, m/s and rad/s, and of a duration, s; as a
# share of the tool's largest speed.
_FIRST_SPEED, _FIRST_TURN, _FIRST_SECONDS, _FIRST_SHARE = 0.05, 0.1, 2.0, 0.5
# And how fast the tangent turns where a spline bends most, rad/s: the joints turn back there. All legs of a
# path are as much slower, as they share its via-points by their seconds.
_FIRST_BEND = 12.0


def timed_path(
    file: PathDescription, place: PathSource, X_WT: FloatArray, surface: Surface | None
) -> ToolPath:
    """Return the tool path that is described.

    Parameters
    ----------
    file : PathDescription
    place : PathSource
    X_WT : (4, 4)
        Pose of the tool before; the path begins there unless it has a start of its own.
    surface : Surface or None
        That of the raster.

    Raises
    ------
    SceneError
        When a leg has no length but a speed, three points are on a line, or a frame is not known.
    """
    builder = _PathBuilder(file, place, X_WT, surface)
    if file.waypoints:
        builder.waypoints()
    if file.raster is not None:
        builder.raster(file.raster)
    for k, leg in enumerate(file.legs):
        builder.leg(leg, f"{place.key}.legs[{k}]")
    if file.blend_radius_m is not None:
        builder.blend(file.blend_radius_m)
    return builder.path()


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """A leg with everything in W."""

    end: FloatArray
    turn: FloatArray
    seconds: float
    curve: Curve | None = None
    blends: bool = False
    cruises: bool = False  # at a speed that is given
    open: bool = False  # its seconds are to be found


class _PathBuilder:
    """Puts legs one after the other."""

    def __init__(
        self, file: PathDescription, place: PathSource, X_WT: FloatArray, surface: Surface | None
    ) -> None:
        self._file, self._place = file, place
        self._X_tool = X_WT
        self._pieces = tuple[RowPiece, ...]()
        if file.raster is not None and surface is not None:
            self._pieces = file.raster.pieces or self._whole_rows(surface)
        self._face_rows = surface.rows(self._pieces) if isinstance(surface, FaceSurface) else None
        self._point, self._R = X_WT[:3, 3], X_WT[:3, :3]
        if file.start_pose is not None:
            self._point, turn = self._at(file.start_pose, f"{place.key}.from")
            self._R = _turned(turn, self._R)
            self._X_tool = turned_pose(self._point, self._R)
        elif file.waypoints:
            self._point, self._R = (each[0] for each in waypoint_poses(file.waypoints))
        elif file.raster is not None:
            self._point, self._R = self._raster_start(file.raster)
        self._start, self._parts = (self._point, self._R), list[_Part]()

    def path(self) -> ToolPath:
        """The legs that were put together."""
        leads, file = self._leads(), self._file
        if file.speed_tolerance is not None and file.lead_in_m and len(self._parts) > 1:
            got = f"a path of {len(self._parts)} pieces, at whose ends the tool rests"
            expected = "one piece: blend_radius_m, or a single leg"
            raise SceneError(self._place.source, f"{self._place.key}.speed_tolerance", got, expected)
        laws, process = dict[int, TimeLaw](), dict[int, ProcessPart]()
        R = [self._start[1]]
        for part in self._parts:
            R.append(_turned(part.turn, R[-1]))
        for k, (before, after) in leads.items():
            self._parts[k], laws[k], process[k] = self._led(k, R[k], before, after)
        law, point, segments = file.speed_profile.law, self._start[0], list[Segment]()
        for k, part in enumerate(self._parts):
            segment = Segment(
                curve=part.curve or Line(point, part.end),
                turn=part.turn,
                seconds=part.seconds,
                law=laws.get(k, law),
                process=process.get(k),
                is_open=part.open or file.seconds == AUTO,
            )
            segments.append(segment)
            point = part.end
        return ToolPath(segments=tuple(segments), orientation=self._start[1])

    def _leads(self) -> dict[int, tuple[float, float]]:
        """Lengths of the leads, m, of the parts that have any."""
        file, last = self._file, len(self._parts) - 1
        if file.raster is not None and file.blend_radius_m is None:
            # Rows come first and every second time.
            over = file.raster.overscan_m
            return {} if file.speed_tolerance is None else dict.fromkeys(range(0, last + 1, 2), (over, over))
        ends = {0: (file.lead_in_m or 0.0, 0.0)}
        ends[last] = (ends.get(last, (0.0, 0.0))[0], file.lead_out_m or 0.0)
        return {k: each for k, each in ends.items() if any(each)}

    def _led(self, k: int, R: FloatArray, before: float, after: float) -> tuple[_Part, TimeLaw, ProcessPart]:
        """Part k, which begins in orientation `R`, with its leads, its law and what is between the leads."""
        part, file, ramp = self._parts[k], self._file, self._file.speed_profile.ramp
        point = self._parts[k - 1].end if k else self._start[0]
        way = part.end - point
        length = float(np.linalg.norm(way)) if part.curve is None else part.curve.length
        if length < SHORTEST_LEG:
            name = "lead_in_m" if before else "lead_out_m"
            got, expected = "a leg on which the tool point stays", "one along which it moves"
            raise SceneError(self._place.source, f"{self._place.key}.{name}", got, expected)
        ramps = (0.0 if before else ramp, 0.0 if after else ramp)
        if file.raster is not None and file.blend_radius_m is None:
            # The row has its leads already.
            shares = (before / length, after / length)
            if isinstance(part.curve, Spline):
                shares = (float(part.curve.breaks[0]), 1.0 - float(part.curve.breaks[-1]))
            law, (begin, end), whole = law_with_leads(file.speed_profile, *shares, ramps)
            seconds = whole * part.seconds * (1 - ramp) if part.cruises else part.seconds
            speed = whole * length / seconds
        else:
            speed = length / (part.seconds * (1 - (ramp if part.cruises else 0.5 * sum(ramps))))
            if part.curve is None and not part.turn.any():
                along = way / length
                if before:
                    self._start = (point - before * along, R)
                part = replace(part, end=part.end + after * along)
                shares = tuple(np.array([before, after]) / (before + length + after))
            else:
                inner = part.curve or Line(point, part.end)
                curve = CurveWithLeads(
                    inner=inner, before=before, after=after, orientation=R, rotation_vector=part.turn
                )
                shares = (float(curve.ends[0]), 1.0 - float(curve.ends[1]))
                ends, turned = curve.position(np.array([0.0, 1.0])), curve.rotation(np.array([0.0, 1.0]))
                first, last = (R, R) if turned is None else turned
                if before:
                    self._start = (ends[0], first)
                turn = np.asarray(Rotation.from_matrix(last @ first.T).as_rotvec())
                part = replace(part, end=ends[1] if after else part.end, curve=curve, turn=turn)
            law, (begin, end), whole = law_with_leads(file.speed_profile, *shares, ramps)
            seconds = whole * length / (1 - sum(shares)) / speed
        process = ProcessPart(begin=begin, end=end, length=speed * (end - begin) * seconds)
        return replace(part, seconds=seconds), law, process

    def leg(self, leg: Leg, key: str) -> None:
        """Add a leg of the scene."""
        end, turn, curve = self._point, np.zeros(3), None
        if leg.by is not None:
            end = self._point + np.array(leg.by)
        elif leg.to is not None:
            end, turn = self._at(leg.to, f"{key}.to")
        elif leg.arc is not None:
            end, turn, curve = self._arc(leg.arc, f"{key}.arc")
        length = float(np.linalg.norm(end - self._point)) if curve is None else curve.length
        straight = curve is None and length >= SHORTEST_LEG and not turn.any()
        open_, turned = leg.seconds == AUTO, float(np.linalg.norm(turn))
        seconds = leg.pause or self._seconds(leg.seconds, leg.speed_m_s, length, f"{key}.speed_m_s", turned)
        part = _Part(end=end, turn=turn, seconds=seconds, curve=curve, blends=straight, open=open_)
        self._add(replace(part, cruises=leg.speed_m_s is not None))

    def waypoints(self) -> None:
        """Add the stretches of the path through the scene's waypoints."""
        file, place = self._file, self._place
        fit = Fit(
            kept=file.kept,
            corner=float(np.radians(file.corner_deg)),
            deviation=place.deviation,
            rotation=place.rotation,
            rests=file.seconds == AUTO,
        )
        parts, lengths, turns = list[_Part](), list[float](), list[float]()
        for stretch in stretches(*waypoint_poses(file.waypoints or ()), fit):
            curve = None if stretch.is_straight else Spline(stretch.points, stretch.orientations)
            way = float(np.linalg.norm(stretch.points[-1] - stretch.points[0]))
            turn = stretch.turn if np.linalg.norm(stretch.turn) > _ZERO_ANGLE else np.zeros(3)
            blends = curve is None and way >= SHORTEST_LEG and not turn.any()
            part = _Part(end=stretch.points[-1], turn=turn, seconds=0.0, curve=curve, blends=blends)
            parts.append(replace(part, cruises=file.speed_m_s is not None))
            lengths.append(way if curve is None else curve.length)
            turns.append(float(np.linalg.norm(turn)))
        # By how long each would take at one speed; a turn in place as what is beside the tool point.
        ways = np.where(np.array(lengths) >= SHORTEST_LEG, lengths, _TURN_LEVER_M * np.array(turns))
        bends = [
            _FIRST_SPEED * part.curve.curvature / _FIRST_BEND for part in parts if part.curve is not None
        ]
        slow = max([1.0, *bends])
        for k, part in enumerate(parts):
            if file.seconds is None or file.seconds == AUTO:
                key = f"{place.key}.speed_m_s"
                seconds = self._seconds(file.seconds, file.speed_m_s, float(ways[k]), key, turns[k])
                seconds *= slow if file.seconds == AUTO else 1.0
            else:
                seconds = float(file.seconds * ways[k] / ways.sum())
            self._add(replace(part, seconds=seconds))

    def raster(self, raster: Raster) -> None:
        """Add the rows of a raster and the steps between them."""
        if raster.cylinder is not None:
            self._pipe(raster, raster.cylinder)
            return
        if self._face_rows is not None:
            self._rows(self._face_rows)
            return
        moves = np.diff(rectangle_corners(raster, self._pieces, self._raster_frame(raster)), axis=0)
        seconds = self._shared_seconds(np.linalg.norm(moves, axis=1))
        for by, duration in zip(moves, seconds, strict=True):
            end, still = self._point + by, np.zeros(3)
            cruises = self._file.seconds is None
            part = _Part(end=end, turn=still, seconds=float(duration), blends=True, cruises=cruises)
            self._add(part)

    def _pipe(self, raster: Raster, pipe: CylinderPatch) -> None:
        """Add the rows over a cylinder and the steps between them."""
        X_WC, radius, _ = tool_cylinder(raster, pipe, self._raster_frame(raster))
        axis, corners = X_WC[:3, 2], cylinder_corners(raster, pipe, self._pieces, radius)
        moves = np.diff(corners, axis=0)
        lengths = np.linalg.norm(moves, axis=1)
        seconds, blend = self._shared_seconds(lengths), self._file.blend_radius_m
        if blend is not None:
            plane = Blend(corners, blend)
            # A given speed is that along the rounded corners.
            shorter = plane.length / float(lengths.sum()) if self._file.seconds is None else 1.0
            curve = CylinderCurve(plane, X_WC, radius, self._R)
            turn = (corners[-1, 0] - corners[0, 0]) / radius * axis
            end = curve.position(np.ones(1))[0]
            whole, cruises = float(seconds.sum()) * shorter, self._file.seconds is None
            self._add(_Part(end=end, turn=turn, seconds=whole, curve=curve, cruises=cruises))
            return
        for k, ((around, along, _), duration) in enumerate(zip(moves, seconds, strict=True)):
            angle = float(around / radius)
            way: Curve | None = None
            if angle and along:
                way = CylinderCurve(Blend(corners[k : k + 2], radius), X_WC, radius, self._R)
            elif angle:
                way = Arc(X_WC[:3, 3], axis, self._point, angle)
            end = self._point + along * axis if way is None else way.position(np.ones(1))[0]
            cruises = self._file.seconds is None
            part = _Part(end=end, turn=angle * axis, seconds=float(duration), curve=way, cruises=cruises)
            self._add(part)

    def _rows(self, rows: FaceRows) -> None:
        """Add the rows over faces of a mesh and the straight steps between them."""
        parts, lengths, R = list[_Part](), list[float](), self._R
        cruises = self._file.seconds is None

        def add(end: FloatArray, turn: FloatArray, curve: Curve | None, length: float) -> None:
            straight = curve is None and not turn.any()
            part = _Part(end=end, turn=turn, seconds=0.0, curve=curve, blends=straight, cruises=cruises)
            parts.append(part)
            lengths.append(length)

        point = self._point
        for points, axes in zip(rows.points, rows.axes, strict=True):
            if parts:
                turn = _axis_turn(R, axes[0])
                add(points[0], turn, None, float(np.linalg.norm(points[0] - point)))
                R = _turned(turn, R)
            curve, turn = None, np.zeros(3)
            if len(points) > 2:
                orientations = [R]
                for axis in axes[1:]:
                    orientations.append(_turned(_axis_turn(orientations[-1], axis), orientations[-1]))
                curve = Spline(points, np.array(orientations))
                turn = np.asarray(Rotation.from_matrix(orientations[-1] @ R.T).as_rotvec())
            length = float(np.linalg.norm(points[-1] - points[0])) if curve is None else curve.length
            add(points[-1], turn, curve, length)
            point, R = points[-1], _turned(turn, R)
        for part, seconds in zip(parts, self._shared_seconds(np.array(lengths)), strict=True):
            self._add(replace(part, seconds=float(seconds)))

    def _whole_rows(self, surface: Surface) -> tuple[RowPiece, ...]:
        """All rows of a surface that are no more than one cell: more are strokes of their own."""
        cells = surface.cells
        if len(cells) == 1:
            return cells[0]
        row = next((k for k, pieces in enumerate(surface.spans) if len(pieces) != 1), 0)
        got = f"faces on which row {row + 1} is in {counted(len(surface.spans[row]), 'piece')}"
        expected = "rows in one piece, or their pieces: Scene.in_cells makes several strokes of them"
        raise SceneError(self._place.source, f"{self._place.key}.raster.faces", got, expected)

    def _raster_frame(self, raster: Raster) -> FloatArray:
        return self._frame(raster.frame, f"{self._place.key}.raster")

    def _raster_start(self, raster: Raster) -> tuple[FloatArray, FloatArray]:
        """Tool point and orientation at the beginning of the first row."""
        X_WF = self._raster_frame(raster)
        if self._face_rows is not None:
            point, ahead = self._face_rows.points[0][0], self._face_rows.axes[0][0]
        elif raster.cylinder is not None:
            X_WC, radius, away = tool_cylinder(raster, raster.cylinder, X_WF)
            x, y, _ = cylinder_corners(raster, raster.cylinder, self._pieces, radius)[0]
            turned = _turned(x / radius * X_WC[:3, 2], X_WC[:3, :3])
            point, ahead = X_WC[:3, 3] + radius * turned[:, 0] + y * X_WC[:3, 2], -turned @ away
        else:
            point = rectangle_corners(raster, self._pieces, X_WF)[0]
            ahead = -rectangle_axes(raster, X_WF)[2]
        turn = shortest_turns(self._R[None, :, 2], ahead[None])[0]
        return point, _turned(turn, self._R)

    def _shared_seconds(self, lengths: FloatArray) -> FloatArray:
        """Durations (L,) of the legs of a raster, of lengths (L,)."""
        if self._file.seconds == AUTO:
            return np.array([self._first_seconds(float(x), 0.0) for x in lengths])
        if self._file.seconds is not None:
            return np.asarray(self._file.seconds * lengths / lengths.sum())
        key = f"{self._place.key}.speed_m_s"
        return np.array([self._seconds(None, self._file.speed_m_s, float(x), key) for x in lengths])

    def blend(self, radius: float) -> None:
        """Make one leg of straight ones that follow each other without a turn of the tool."""
        merged, group, point = list[_Part](), list[_Part](), self._start[0]

        def close() -> None:
            nonlocal point
            if len(group) > 1:
                corners = np.vstack([point, *(part.end for part in group)])
                curve = Blend(corners, radius)
                shorter = curve.length / float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum())
                seconds = sum(part.seconds * (shorter if part.cruises else 1.0) for part in group)
                cruises, open_ = all(part.cruises for part in group), any(part.open for part in group)
                merged.append(replace(group[-1], seconds=seconds, curve=curve, cruises=cruises, open=open_))
            else:
                merged.extend(group)
            point = group[-1].end if group else point
            group.clear()

        for part in self._parts:
            if part.blends:
                corner = [point, *(each.end for each in group), part.end][-3:]
                if group and not rounded(*corner):
                    close()
                group.append(part)
                continue
            close()
            merged.append(part)
            point = part.end
        close()
        self._parts = merged

    def _add(self, part: _Part) -> None:
        self._parts.append(part)
        self._point, self._R = part.end, _turned(part.turn, self._R)

    def _first_seconds(self, length: float, turn: float) -> float:
        """A first guess of seconds that are to be found."""
        most = self._place.max_speed
        speed = _FIRST_SPEED if most is None else min(_FIRST_SPEED, _FIRST_SHARE * most)
        return max(length / speed, turn / _FIRST_TURN, _FIRST_SECONDS)

    def _seconds(
        self, seconds: float | str | None, speed: float | None, length: float, key: str, turn: float = 0.0
    ) -> float:
        if seconds == AUTO:
            return self._first_seconds(length, turn)
        if seconds is not None or speed is None:
            return float(seconds or 0.0)
        if length < SHORTEST_LEG:
            expected = "seconds in place of it: the leg has no length"
            raise SceneError(self._place.source, key, f"{speed:g} m/s", expected)
        return length / (speed * (1 - self._file.speed_profile.ramp))

    def _frame(self, name: str, key: str) -> FloatArray:
        return self._place.frame(name, key, self._X_tool)

    def _at(self, goal: Goal, key: str) -> tuple[FloatArray, FloatArray]:
        """Point of a pose in W, and the rotation vector in W that leads to its orientation from here."""
        X = self._frame(goal.frame, key)
        point = X[:3, :3] @ np.array(goal.xyz) + X[:3, 3]
        turn = np.zeros(3)
        if goal.rpy_deg is not None:
            R = X[:3, :3] @ pose((0.0, 0.0, 0.0), np.radians(goal.rpy_deg))[:3, :3]
            turn = np.asarray(Rotation.from_matrix(R @ self._R.T).as_rotvec())
        elif goal.axis is not None:
            axis = X[:3, :3] @ (np.array(goal.axis) / np.linalg.norm(goal.axis))
            turn = _axis_turn(self._R, axis)
        # The same orientation again is no turn, whatever rounding says.
        return point, turn if np.linalg.norm(turn) > _ZERO_ANGLE else np.zeros(3)

    def _arc(self, arc: ArcTo, key: str) -> tuple[FloatArray, FloatArray, Curve | None]:
        """End, rotation vector and curve of an arc."""
        X = self._frame(arc.frame, key)
        if arc.via is not None and arc.to is not None:
            via, end = (X[:3, :3] @ np.array(p) + X[:3, 3] for p in (arc.via, arc.to))
            found = Arc.through(self._point, via, end)
            if found is None:
                got = "three points on a line"
                raise SceneError(self._place.source, key, got, "a point beside the line, or a straight leg")
            turn = found.angle * found.axis if arc.turns else np.zeros(3)
            return end, turn, found
        axis = X[:3, :3] @ (np.array(arc.axis) / np.linalg.norm(np.array(arc.axis)))
        angle = float(np.radians(arc.angle_deg or 0.0))
        turn = angle * axis if arc.turns else np.zeros(3)
        curve = Arc(X[:3, :3] @ np.array(arc.centre) + X[:3, 3], axis, self._point, angle)
        if curve.radius < SHORTEST_LEG:  # the tool turns on the spot
            return self._point, turn, None
        return curve.position(np.ones(1))[0], turn, curve


def _axis_turn(R: FloatArray, axis: FloatArray) -> FloatArray:
    """The shortest rotation vector that leads the z axis of an orientation to another."""
    turn = shortest_turns(R[None, :, 2], axis[None])[0]
    return turn if np.linalg.norm(turn) > _ZERO_ANGLE else np.zeros(3)


def _turned(turn: FloatArray, R: FloatArray) -> FloatArray:
    return np.asarray(Rotation.from_rotvec(turn).as_matrix() @ R)
