"""The timed tool path of a scene by another route than `cmbot.scene`, from the entries of its file.

Straight legs, arcs and pauses are computed again. Of rounded corners, leads, splines and rasters what the
file names is looked for: the points are passed, and the tool is square to the surface, at its distance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.spatial.transform import Rotation

from cmbot.common.arrays import FloatArray, IntArray
from cmbot.planning.verification.described_arm import pose_of
from cmbot.scene import Scene, Stroke, StrokeFile
from cmbot.toolpath import ArcTo, Goal, Leg, LegLaw, Raster, SpeedProfile

_MIN_TURN_RAD, _NO_TIME = 1e-12, 1e-12
# Samples of a path in which points are looked for: at least, and for each of them.
_MIN_PATH_SAMPLES, _PER_POINT = 4001, 40
# Rounded corners turn by 150 degrees at most, and pass their points within so many radii.
_CORNER_RADII = 3.0
# Dense waypoints are passed within this share of the tool's tolerance.
_WAYPOINT_SHARE = 0.25
# Durations whose shares agree to so many digits are the same.
_DURATION_DIGITS = 9


@dataclass(frozen=True, kw_only=True, eq=False)
class _Piece:
    """A leg in W: from `start` by `way`, or by `angle` about an axis through `centre`."""

    start: FloatArray
    way: FloatArray
    R: Rotation
    turn: FloatArray
    seconds: float
    centre: FloatArray | None = None
    angle: FloatArray | None = None
    back: bool = False
    law: LegLaw | None = None

    def at(self, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool points (N, 3) and orientations (N, 3, 3) where shares (N,) of it are covered."""
        s = (1 - share if self.back else share)[:, None]
        p = self.start + s * self.way
        if self.centre is not None and self.angle is not None:
            p = self.centre + Rotation.from_rotvec(s * self.angle).apply(self.start - self.centre)
        return p, (Rotation.from_rotvec(s * self.turn) * self.R).as_matrix()


class _LegPath:
    """Where legs of a file have the tool, without leads and with corners that are not rounded.

    They begin in the frame of the tool. `corners` (k, 3), m, are where they begin and end, in W.
    """

    def __init__(self, file: StrokeFile, frames: Mapping[str, FloatArray]) -> None:
        self._profile, self._frames = file.speed_profile, dict(frames)
        self._p, self._R = frames["tool"][:3, 3], Rotation.from_matrix(frames["tool"][:3, :3])
        if file.start_pose is not None:
            turn = self._turn_to(file.start_pose)
            self._p, self._R = self._point(file.start_pose), Rotation.from_rotvec(turn) * self._R
            X = self._frames["tool"] = np.eye(4)
            X[:3, :3], X[:3, 3] = self._R.as_matrix(), self._p
        once = [self._piece(leg) for leg in file.legs]
        self.corners = np.vstack([once[0].start, *(piece.at(np.ones(1))[0] for piece in once)])
        self._pieces = list[_Piece]()
        for number in range(file.passes or 1):
            back = (number % 2 == 1) != file.backwards
            self._pieces += [replace(piece, back=True) for piece in once[::-1]] if back else once
        for law in file.time_laws or ():
            self._pieces[law.leg] = replace(self._pieces[law.leg], law=law, seconds=sum(law.seconds))
        self.seconds = np.array([piece.seconds for piece in self._pieces])

    @property
    def ends(self) -> FloatArray:
        """Times (k,), s, at which the tool rests, 0 among them."""
        return np.append(0.0, np.cumsum(self.seconds))

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool points (N, 3), m, and orientations (N, 3, 3) at times (N,), s."""
        leg = self._legs(times)
        p, R = np.empty((len(times), 3)), np.empty((len(times), 3, 3))
        for k in np.unique(leg):
            piece, here = self._pieces[k], leg == k
            u = np.clip((times[here] - self.ends[k]) / piece.seconds, 0.0, 1.0)
            covered = _distance(self._profile, piece.law)
            p[here], R[here] = piece.at(covered(u) / covered(1.0))
        return p, R

    def _legs(self, times: FloatArray) -> IntArray:
        return np.clip(np.searchsorted(self.ends, times) - 1, 0, len(self.seconds) - 1)

    def _piece(self, leg: Leg) -> _Piece:
        """A leg from where the path is, which goes on at its end."""
        p, R, turn, way, centre, angle = self._p, self._R, np.zeros(3), np.zeros(3), None, None
        if leg.by is not None:
            way = np.array(leg.by)
        elif leg.to is not None:
            way, turn = self._point(leg.to) - p, self._turn_to(leg.to)
        length = float(np.linalg.norm(way))
        if leg.arc is not None:
            centre, angle = self._arc(leg.arc)
            length = float(np.linalg.norm(np.cross(angle, p - centre)))
            turn = angle if leg.arc.turns else turn
        # A speed is that between ramps which take the tool half as far.
        cruise = 0.0 if leg.speed_m_s is None else length / (leg.speed_m_s * (1 - self._profile.ramp))
        piece = _Piece(
            start=p, way=way, R=R, turn=turn, seconds=leg.given_seconds or cruise, centre=centre, angle=angle
        )
        self._p, self._R = piece.at(np.ones(1))[0][0], Rotation.from_rotvec(turn) * R
        return piece

    def _point(self, goal: Goal) -> FloatArray:
        X = self._frames[goal.frame]
        return np.asarray(X[:3, :3] @ np.array(goal.xyz) + X[:3, 3])

    def _turn_to(self, goal: Goal) -> FloatArray:
        """The rotation vector in W to the orientation of a pose."""
        R_frame = self._frames[goal.frame][:3, :3]
        if goal.rpy_deg is not None:
            R = R_frame @ pose_of(np.zeros(3), np.radians(goal.rpy_deg))[:3, :3]
            return np.asarray((Rotation.from_matrix(R) * self._R.inv()).as_rotvec())
        if goal.axis is None:
            return np.zeros(3)
        z, ahead = R_frame @ np.array(goal.axis) / np.linalg.norm(goal.axis), self._R.as_matrix()[:, 2]
        about, cosine = np.cross(ahead, z), float(ahead @ z)
        sine = float(np.linalg.norm(about))
        if cosine < 0 and sine < _MIN_TURN_RAD:
            # Half a turn, about what is most across.
            about = np.cross(ahead, np.eye(3)[np.abs(ahead).round(9).argmin()])
            return np.asarray(np.pi * about / np.linalg.norm(about))
        return np.asarray(about * (np.arctan2(sine, cosine) / sine if sine > 0 else 1.0))

    def _arc(self, arc: ArcTo) -> tuple[FloatArray, FloatArray]:
        """Centre and rotation vector of an arc from where the path is."""
        X, p = self._frames[arc.frame], self._p
        if arc.via is None or arc.to is None:
            axis = X[:3, :3] @ np.array(arc.axis) / np.linalg.norm(np.array(arc.axis))
            centre = X[:3, :3] @ np.array(arc.centre) + X[:3, 3]
            return centre + ((p - centre) @ axis) * axis, np.radians(arc.angle_deg or 0.0) * axis
        via, end = (X[:3, :3] @ np.array(x) + X[:3, 3] for x in (arc.via, arc.to))
        axis = np.cross(via - p, end - p)
        axis /= np.linalg.norm(axis)
        middles = [(via @ via - p @ p) / 2, (end @ end - p @ p) / 2, axis @ p]
        centre = np.linalg.solve(np.stack([via - p, end - p, axis]), middles)
        first, last = p - centre, end - centre
        return centre, float(np.arctan2(np.cross(first, last) @ axis, first @ last)) % (2 * np.pi) * axis


def _distance(profile: SpeedProfile, law: LegLaw | None) -> BSpline:
    """What is covered by the share of a leg's time, in any unit: speeds or jerks, integrated."""
    if law is not None:
        ends = np.append(0.0, np.cumsum(law.seconds))
        return make_interp_spline(ends / ends[-1], law.jerk, k=1).antiderivative(3)
    ramp = profile.ramp
    u = np.unique([0, ramp / 2, ramp, 1 - ramp, 1 - ramp / 2, 1])
    ramped = np.minimum(u, 1 - u) / ramp
    if profile.kind == "trapezoidal":
        return make_interp_spline(u, np.minimum(ramped, 1.0), k=1).antiderivative(1)
    if profile.kind == "jerk_limited":
        pull = np.maximum(1 - np.abs(2 * ramped - 1), 0.0) * np.sign(0.5 - u)
        return make_interp_spline(u, pull, k=1).antiderivative(2)
    quarters = ramp * np.arange(5) / 4
    u = np.concatenate([quarters, 1 - quarters[::-1]])
    jerk = np.array([0.0, 1.0, 0.0, -1.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0])
    # Ramps of half the time meet in its middle.
    apart = np.append(True, np.diff(u) > _NO_TIME)
    u, jerk = u[apart], jerk[apart]
    return make_interp_spline(u, jerk, k=1).antiderivative(3)


class DescribedPath:
    """The path of a stroke as its file describes it.

    Parameters
    ----------
    scene : Scene
        With its frames.
    stroke : Stroke
        What the package made of its file.
    X_tool : (4, 4)
        Pose of the tool before, in which the path begins where it has no start of its own.

    Attributes
    ----------
    is_plain : bool
        Legs that are neither rounded nor have leads: only these are computed again.
    """

    def __init__(self, scene: Scene, stroke: Stroke, X_tool: FloatArray) -> None:
        named = scene.frames if scene.tool.fixed is None else ()
        frames = {name: pose_of(frame.xyz, np.radians(frame.rpy_deg)) for name, frame in named}
        frames |= {"world": np.eye(4), "tool": X_tool}
        self._path, self._file, self._frames = stroke.path, stroke.file, frames
        self._has_leads = bool(stroke.file.lead_in_m or stroke.file.lead_out_m)
        self._legs = _LegPath(stroke.file, frames) if stroke.file.legs else None
        self._number, self._deviation = stroke.via_points, scene.planner.max_tool_deviation_m
        self.is_plain = self._legs is not None and not (stroke.file.blend_radius_m or self._has_leads)

    def poses(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tool points (N, 3), m, and orientations (N, 3, 3) at times (N,), s.

        Where they are not computed again, they are the package's.
        """
        if self._legs is not None and self.is_plain:
            return self._legs.poses(times)
        found = self._path.poses(times)
        return found.point, np.broadcast_to(found.rotation, (len(times), 3, 3))

    @cached_property
    def via_times(self) -> FloatArray:
        """Times of the via-points (k,), s: the ends of sections, and equal steps within each.

        Each section has a segment; every further one goes to that whose segments are then longest (D'Hondt).
        Those along splines, whose steps follow their bends, are the package's.
        """
        if self._path.bends_unevenly:
            return self._path.via_times(self._number)
        plain = self._legs is not None and self.is_plain
        ends = self._legs.ends if self._legs is not None and plain else self._path.section_times
        seconds = np.diff(ends)
        segments, shares = (
            np.ones(len(seconds), dtype=np.intp),
            np.round(seconds / seconds.sum(), _DURATION_DIGITS),
        )
        for _ in range(self._number - 1 - len(seconds)):
            segments[np.argmax(shares / (segments + 1))] += 1
        steps = [
            begin + np.arange(n) / n * s for begin, n, s in zip(ends[:-1], segments, seconds, strict=True)
        ]
        return np.append(np.concatenate(steps), ends[-1])

    def misses(self, times: FloatArray) -> FloatArray:
        """Return by how much the package's path misses what the file names (K,), m, and of an axis the chord.

        Points have to be passed, at rounded corners within some radii; over a rectangle or a cylinder the
        tool has to be at its distance and square to it at `times` (N,), s. Faces of a mesh name nothing.
        """
        raster = self._file.raster
        if raster is not None:
            times = times[self._path.process_speed(times) > 0] if self._has_leads else times
            p, R = self.poses(times)
            return _surface_misses(raster, self._frames[raster.frame], p, R[:, :, 2]).ravel()
        rounded = _CORNER_RADII * (self._file.blend_radius_m or 0.0)
        if self._legs is None:
            rounded += _WAYPOINT_SHARE * self._deviation
        points = np.array(self._file.waypoints)[:, :3] if self._legs is None else self._legs.corners
        return np.maximum(self._distance(points) - rounded, 0.0)

    def _distance(self, points: FloatArray) -> FloatArray:
        """How far points (K, 3), m, are from the package's path."""
        t = np.linspace(0.0, self._path.duration, max(_MIN_PATH_SAMPLES, _PER_POINT * len(points)))
        p = self._path.position(np.union1d(t, self._path.section_times))
        begin, way = p[:-1], np.diff(p, axis=0)
        size = np.maximum(np.einsum("nd,nd->n", way, way), np.finfo(float).tiny)
        found = []
        for point in points:
            s = np.clip(np.einsum("nd,nd->n", point - begin, way) / size, 0.0, 1.0)
            found.append(np.linalg.norm(begin + s[:, None] * way - point, axis=1).min())
        return np.array(found)


def _surface_misses(raster: Raster, X: FloatArray, p: FloatArray, z: FloatArray) -> FloatArray:
    """By how much tool points and axes (N, 3) miss a distance, m, and a direction, as a chord: (N, 2).

    `X` (4, 4) is the pose of the raster's frame.
    """
    ahead = z @ X[:3, :3]
    # Where the tool's axis meets the surface.
    local = (p - X[:3, 3]) @ X[:3, :3] + raster.stand_off_m * ahead
    if raster.rectangle is not None:
        origin, u, v = map(np.array, raster.rectangle)
        out = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        height, normal = (local - origin) @ out, np.broadcast_to(out, local.shape)
        rows = [np.broadcast_to(edge / np.linalg.norm(edge), local.shape) for edge in (u, v)]
    elif raster.cylinder is not None:
        axis = np.array(raster.cylinder.axis) / np.linalg.norm(raster.cylinder.axis)
        arm = local - np.array(raster.cylinder.centre)
        arm = arm - (arm @ axis)[:, None] * axis
        radius = np.linalg.norm(arm, axis=1)
        height, normal = radius - raster.cylinder.radius, arm / radius[:, None]
        rows = [np.broadcast_to(axis, local.shape), np.sign(raster.cylinder.angle) * np.cross(axis, normal)]
        rows = rows if raster.cylinder.rows == "along" else rows[::-1]
    else:
        return np.empty((0, 2))
    slopes = np.tan(np.radians(raster.lean_deg or (0.0, 0.0)))
    back = normal + slopes[0] * rows[0] + slopes[1] * rows[1]
    back /= np.linalg.norm(back, axis=1, keepdims=True)
    return np.stack([np.abs(height), np.linalg.norm(ahead + back, axis=1)], axis=1)
