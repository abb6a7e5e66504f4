"""What of rasters the arm can follow: rows that are cut where its reach, or a way of its joints, ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cmbot.common.arrays import FloatArray, IntArray, runs
from cmbot.planning.budget import Deadline
from cmbot.planning.path.nearest_miss import nearest_miss
from cmbot.planning.postures.sampler import PostureSampler
from cmbot.planning.request import StrokeRequest, build_request, in_cells, strokes_of
from cmbot.planning.workcell.workcell import robot_of
from cmbot.scene import PlannerOptions, Scene, StrokeFile, coverage_of, rows_alone
from cmbot.toolpath import RowPiece, ToolPath, ToolPoses, cells_of

# Distance of places along rows: as a share of the rows' distance, and at most, m.
_SHARE, _MAX_PLACE_DISTANCE_M = 0.25, 0.03
# Rows that are so long that there would be more places have them further apart.
_MAX_PLACES = 4000
# Postures that follow rows: few first, more where these come to an end; how far copies of them are scattered,
# and how far a joint may move from one place to the next, rad.
_FEW_POSTURES, _MANY_POSTURES, _SCATTER, _FURTHEST = 12, 60, 0.15, 0.6
# Random postures from which Newton's method starts where rows begin, and at each place where rows come to an
# end; its steps, and its tolerance, m or rad.
_AT_START, _ANYWHERE, _MAX_ROW_NEWTON_STEPS, _ROW_NEWTON_TOLERANCE = 300, 60, 30, 1e-9
# Random postures are sought at places of this stride: to the others they are carried.
_PLACE_STRIDE = 3
# Largest share of its bound that a joint, or a foot, uses at rest where rows are cut: motion takes some.
_MAX_STATIC_USE = 0.97
# Pieces that are shorter than this share of the rows' distance are left out.
_MIN_PIECE_SHARE = 0.5

_Cell = tuple[RowPiece, ...]


def reached_scene(scene: Scene, options: PlannerOptions, deadline: Deadline | None = None) -> Scene:
    """Return the scene whose rasters are in parts that the arm can follow, each a stroke of its own.

    Postures that hold the tool are carried along the rows: within the joint ranges, strong enough and clear
    of obstacles. Where none goes on, rows are cut to the places that some posture reaches, and these to parts
    that one can follow. Without holes and such cuts the scene stays as it is.

    Parameters
    ----------
    scene : Scene
    options : PlannerOptions
    deadline : Deadline, optional

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    PathNotFound
        When nothing of a raster is reached, or the time is over.
    """
    if not any(file.raster is not None for file in scene.strokes):
        return scene
    apart = in_cells(scene, robot_of(scene))
    request = build_request(apart, options, deadline=deadline)
    numbers = {str(file.name): k for k, file in enumerate(scene.strokes)}
    whole, parts, cut = dict[int, list[RowPiece]](), dict[int, list[_Cell]](), False
    at_first = dict[int, StrokeRequest]()
    for number, stroke in enumerate(request.strokes):
        raster = stroke.file.raster
        if raster is None or stroke.surface is None:
            continue
        cell = raster.pieces or stroke.surface.pieces
        found = [cell]
        k = numbers[stroke.name if stroke.name in numbers else str(stroke.file.part_of)]
        if raster.cover == "reachable" and raster.frame != "tool":
            at = request.at_stroke(number)
            at_first.setdefault(k, at)
            found = _Follower(at, apart).parts(cell)
        whole.setdefault(k, []).extend(cell)
        parts.setdefault(k, []).extend(found)
        cut |= found != [cell]
    if not cut:
        return apart
    for k, found in parts.items():
        if not found:
            key = f"{at_first[k].stroke.key}.raster"
            miss = nearest_miss(at_first[k], is_clear=True)
            reason = f"no place of {key} is reached{f': {miss.reason()}' if miss else ''}"
            raise request.path_not_found(reason, request.state.posture, key=key)
    changed = {k for k, found in parts.items() if len(found) > 1 or found != [tuple(whole[k])]}
    return scene.with_cells({k: parts[k] for k in changed}, whole)


def unreached_area(reached: Scene) -> float:
    """Return the area of rasters, m2, that the arm does not reach, as a `reached_scene` leaves it out."""
    if not any(file.raster is not None for file in reached.strokes):
        return 0.0
    return sum(one.unreached for one in coverage_of(strokes_of(reached, robot_of(reached))).values())


@dataclass(frozen=True, eq=False)
class _Places:
    """Places along the rows of a cell and the steps between them, in order.

    `leg` (N,) are their numbers, rows first and every second one, `share` (N,) how much of them is covered.
    """

    leg: IntArray
    share: FloatArray
    goals: ToolPoses


class _Follower:
    """Carries postures along the rows of a stroke."""

    def __init__(self, request: StrokeRequest, scene: Scene) -> None:
        self._request, self._scene = request, scene
        file = request.stroke.file
        if file.raster is None:
            raise TypeError("a stroke without a raster")
        self._raster, leads = file.raster, max(file.lead_in_m or 0.0, file.lead_out_m or 0.0)
        # Any row may become the first or the last one of a part.
        self._over = file.raster.overscan_m + leads
        self._sampler = PostureSampler(
            cell=request.cell, task=request.task, steps=_MAX_ROW_NEWTON_STEPS, tolerance=_ROW_NEWTON_TOLERANCE
        )
        self._rng, self._known = self._sampler.rng, request.state.posture
        self._every = min(_SHARE * file.raster.spacing_m, _MAX_PLACE_DISTANCE_M)

    def parts(self, cell: _Cell) -> list[_Cell]:
        """The parts of a cell that postures can follow."""
        found, waiting, is_trimmed = list[_Cell](), [cell], False
        self._sampler = replace(self._sampler, most_use=1.0)
        while waiting:
            part = waiting.pop(0)
            places = self._places(part)
            number = self._followed(places.goals, _FEW_POSTURES)
            if number < len(places.leg):
                number = max(number, self._followed(places.goals, _MANY_POSTURES))
            if number == len(places.leg):
                found.append(part)
            elif not is_trimmed:
                is_trimmed, self._sampler = True, replace(self._sampler, most_use=_MAX_STATIC_USE)
                waiting = self._trimmed(part, places)
            else:
                done, rest = self._cut(part, places, number)
                found += [done] if done else []
                waiting = [rest, *waiting] if rest else waiting
        return found

    def _places(self, cell: _Cell) -> _Places:
        raster = replace(self._raster, pieces=cell, overscan_m=self._over)
        path = self._path(rows_alone(self._request.stroke.file, raster))
        legs, shares = list[IntArray](), list[FloatArray]()
        every = max(self._every, float(path.lengths.sum()) / _MAX_PLACES)
        for leg, length in enumerate(path.lengths):
            each = np.linspace(0.0, 1.0, max(int(np.ceil(length / every)), 1) + 1)
            each = each if leg % 2 == 0 else each[1:-1]
            shares.append(each)
            legs.append(np.full(len(each), leg))
        at, share = np.concatenate(legs), np.concatenate(shares)
        return _Places(at, share, path.poses(path.times_at(at, share)))

    def _path(self, file: StrokeFile) -> ToolPath:
        X_WT, begin = np.eye(4), self._request.task.path.poses([0.0])
        X_WT[:3, 3], X_WT[:3, :3] = begin.point[0], begin.rotation[0]
        return self._scene.with_strokes((file,)).timed_strokes(X_WT)[0].path

    def _followed(self, goals: ToolPoses, width: int) -> int:
        """How many places from the first one on postures are carried to."""
        q = self._sampler.at_each(goals[0], _AT_START, self._known)[0]
        q = q[self._rng.permutation(len(q))[:width]]
        for number in range(len(goals)):
            self._require_time(number, len(goals))
            if number > 0:
                q = self._carried(q, goals[number], width)
            if not len(q):
                return number
        return len(goals)

    def _require_time(self, done: int, total: int) -> None:
        """Refuse to go on where the time is over."""
        request = self._request
        if request.deadline.expired():
            when = f"when {done} of {total} places along the rows had been tried"
            if done == 0:
                # More time may not help: a place within reach takes a small share of it.
                when = "before a posture at the first place of the rows was found; cmbot check says why"
            raise request.path_not_found(
                f"{request.deadline.in_words}, was over {when}", request.state.posture, stopped=True
            )

    def _carried(self, q: FloatArray, goal: ToolPoses, width: int) -> FloatArray:
        """Admissible postures at the next place, near postures `q` (N, n)."""
        metric = self._request.cell.robot.metric
        copied = q[self._rng.integers(len(q), size=max(width - len(q), 0))]
        around = copied + metric.positions(self._rng.normal(0.0, _SCATTER, copied.shape))
        near = np.vstack([q, copied])
        placed, ok = self._sampler.within_cone(np.vstack([q, around]), goal, or_middle=True)
        moved = np.abs(metric.coordinates(placed - near)).max(axis=1)
        return self._sampler.admissible(placed[ok & (moved <= _FURTHEST)])

    def _trimmed(self, cell: _Cell, places: _Places) -> list[_Cell]:
        """A cell's rows at the places that some posture reaches, in cells."""
        on_rows = np.flatnonzero(places.leg % 2 == 0)
        leg, share = places.leg[on_rows], places.share[on_rows]
        each = [np.empty((0, self._request.cell.robot.dof))] * len(on_rows)
        each[::_PLACE_STRIDE] = self._sampler.at_each(
            places.goals[on_rows[::_PLACE_STRIDE]], _ANYWHERE, self._known
        )
        for order in (range(1, len(each)), range(len(each) - 2, -1, -1)):
            for done, k in enumerate(order, start=1):
                self._require_time(done, len(each))
                before = each[k - order.step]
                if not len(each[k]) and len(before):
                    each[k] = self._carried(before, places.goals[on_rows[k]], _MANY_POSTURES)
        reached = np.array([len(q) > 0 for q in each])
        rows = list[list[tuple[float, float]]]()
        for k, piece in enumerate(cell):
            own = np.flatnonzero(leg == 2 * k)
            pieces = (
                self._piece(piece, k, share[own[first]], share[own[last]])
                for first, last in runs(reached[own])
            )
            rows.append(sorted((one.begin_m, one.end_m) for one in pieces if one is not None))
        return [tuple(replace(one, row=cell[one.row].row) for one in found) for found in cells_of(rows)]

    def _piece(
        self, piece: RowPiece, number: int, first: float, last: float, *, joined: bool = False
    ) -> RowPiece | None:
        """What of a piece, that of a number in its cell, is left between two shares of its way, if enough.

        The ways before and behind it are on the left part, too, but before one that is joined.
        """
        over, turned = self._over, -1 if number % 2 == 1 else 1
        at = piece.begin_m - over if turned == 1 else piece.end_m + over
        way = turned * (piece.length + 2 * over)
        both = at + first * way + turned * (0.0 if joined else over), at + last * way - turned * over
        begin, end = max(min(both), piece.begin_m), min(max(both), piece.end_m)
        begin = piece.begin_m if begin - piece.begin_m < _ROW_NEWTON_TOLERANCE else begin
        end = piece.end_m if piece.end_m - end < _ROW_NEWTON_TOLERANCE else end
        if (both[1] - both[0]) * turned <= 0:
            return None
        enough = end - begin >= min(_MIN_PIECE_SHARE * self._raster.spacing_m, piece.length)
        return replace(piece, begin_m=float(begin), end_m=float(end)) if enough else None

    def _cut(self, cell: _Cell, places: _Places, number: int) -> tuple[_Cell, _Cell]:
        """A cell up to the last of so many places, and the rest of it."""
        leg = int(places.leg[number])
        k = (leg + 1) // 2
        is_within = leg % 2 == 0 and (number == 0 or places.leg[number - 1] == leg)
        if not is_within:
            return cell[:k], cell[k:]
        share = places.share
        until = None if number == 0 else self._piece(cell[k], k, 0.0, share[number - 1])
        at = int(np.flatnonzero(places.leg == leg)[0])
        rest = self._piece(cell[k], k, share[max(number - 1, at + 1)], 1.0, joined=True)
        return (*cell[:k], *_one(until)), (*_one(rest), *cell[k + 1 :])


def _one(piece: RowPiece | None) -> Sequence[RowPiece]:
    return () if piece is None else (piece,)
