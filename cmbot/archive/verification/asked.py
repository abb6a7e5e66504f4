"""What was asked of a plan: its scene and its options beside those of a scene file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from hashlib import sha256
from itertools import pairwise
from operator import gt, lt, ne
from pathlib import Path
from typing import Any

import numpy as np

from cmbot.archive.records import require_same
from cmbot.common.errors import ArchiveError, PlanningError
from cmbot.common.reading.input_files import is_file
from cmbot.common.reading.validation import counted, plain, shown
from cmbot.planning import (
    JobState,
    Plan,
    aside_at_start,
    build_request,
    fixed_knots,
    reached_scene,
    robot_of,
    strokes_of,
    with_cuts,
)
from cmbot.robot import Kinematics, Robot
from cmbot.scene import PlannerOptions, Scene, Stroke, StrokeFile, allowed_cuts, pieces_left_out
from cmbot.toolpath import AUTO, RowPiece

# When an option promises less than another value of it would; those that say what is sought promise another
# thing. The other options are effort: whatever they are, the same is promised, unless knots are fixed.
_LOOSER: Mapping[str, Callable[[Any, Any], bool]] = {
    "safety_margin_m": lt,
    "max_tool_deviation_m": gt,
    "max_tool_rotation_deg": gt,
    "max_tool_lag_m": gt,
    "deviation_sigmas": lt,
    "quiet_modes": lt,
    "quiet_stiffness_share": lt,
    **dict.fromkeys(("compensate", "knots", "start", "objective", "moment_about", "axis_weights"), ne),
}

# How far joints of an arm that stands may move, rad or m.
_STANDS = 1e-6
# How far fixed knots may lie from those computed again, rad or m, and at most where rounding counts for more;
# as a share of what is added up.
_ON_PATH, _MOST_ASIDE, _OF_ROUNDING = 1e-6, 1e-3, 1e-12
# Share of what compensation moves the start by within which it is known.
_SECOND_ORDER = 0.1
# Pieces of a row that have no more in common touch, m.
_TOUCHING_M = 1e-6
# Share of the via-points asked for that planning leaves at least.
_FEWEST_VIA_POINTS = 0.5
# By which share of what is left away two searches of what is reached may differ.
_SAME_CUT = 1e-3


def looser_promises(options: PlannerOptions, asked: PlannerOptions, why: str = "asked") -> tuple[str, ...]:
    """Return which options promise less than others, or another thing, each with both values.

    Parameters
    ----------
    options : PlannerOptions
        Those of a plan.
    asked : PlannerOptions
    why : str
        Where these are from.
    """
    return _differing(options, asked, _LOOSER, why)


def other_options(options: PlannerOptions, asked: PlannerOptions, why: str = "asked") -> tuple[str, ...]:
    """Return which options differ and promise no less, each with both values; of ``auto`` none differs."""
    no_less = {
        name: ne
        for name, wanted in vars(asked).items()
        if wanted != AUTO and not (name in _LOOSER and _LOOSER[name](getattr(options, name), wanted))
    }
    return _differing(options, asked, no_less, why)


def other_via_points(scene: Scene, asked: Scene) -> tuple[str, ...]:
    """Return which strokes of a scene have other numbers of via-points than asked, each with both values."""
    due = {str(stroke.name): stroke.via_points for stroke in asked.strokes}
    pairs = [(stroke, due.get(stroke.part_of or str(stroke.name), AUTO)) for stroke in scene.strokes]
    return tuple(
        f"via_points of {stroke.name} {stroke.via_points} (asked {wanted})"
        for stroke, wanted in pairs
        if wanted not in (AUTO, stroke.via_points)
    )


def _differing(
    options: PlannerOptions,
    asked: PlannerOptions,
    differ: Mapping[str, Callable[[Any, Any], bool]],
    why: str = "asked",
) -> tuple[str, ...]:
    pairs = {name: (getattr(options, name), getattr(asked, name)) for name in differ}
    return tuple(
        f"{name} {shown(got)} ({why} {shown(wanted)})"
        for name, (got, wanted) in pairs.items()
        if differ[name](got, wanted)
    )


def require_promised(options: PlannerOptions, asked: PlannerOptions, source: str, key: str) -> None:
    """Refuse options that promise less than others, or another thing: an `ArchiveError` names the file."""
    if looser := looser_promises(options, asked):
        raise ArchiveError(source, key, "; ".join(looser), "promises as strict as what was asked")


def require_asked(
    scene: Scene,
    asked: Scene,
    source: str,
    options: PlannerOptions | None = None,
    promised: PlannerOptions | None = None,
) -> None:
    """Refuse the scene of a plan that is not what was asked, but for what planning decides.

    That are numbers of via-points and durations that are ``auto``, more via-points, the order of strokes
    where it is ``best``, and which rows of a raster are in which part, or left out as nothing reaches them.
    Fewer via-points promise less. Options are those asked, those of the plan, or defaults that a command
    replaced. What counts of the files that both name is their content, not where they are.

    Parameters
    ----------
    scene : Scene
        Of the plan.
    asked : Scene
    source : str
        The file of the plan, for messages.
    options : PlannerOptions, optional
        Of the plan; left out: those that were asked.
    promised : PlannerOptions, optional
        By which the arm reaches rows; left out: which rows it reaches from here is not asked.

    Raises
    ------
    ArchiveError
        For the first key of the scene that differs.
    """
    given = scene, asked
    scene, asked = (one.with_files_of(scene) for one in given)
    content, wanted = (one.as_data() for one in (scene, asked))
    for data in (content, wanted):
        data["robot"].pop("package_dirs", None)
        data.pop("planner", None)
    # A job of a campaign is the scene by another name.
    wanted["name"] = content["name"]
    require_same(content, wanted | {"tool_path": content["tool_path"]}, source, "scene", why="asked")
    known = (asked.planner, options or asked.planner, PlannerOptions())
    for name, value in vars(scene.planner).items():
        if value not in [getattr(one, name) for one in known]:
            due = f"{shown(getattr(asked.planner, name))}, as asked"
            raise ArchiveError(source, f"scene.planner.{name}", shown(value), due)
    _require_same_robot(*given, source)
    key, best, strokes = "scene.tool_path.strokes", asked.order == "best", scene.strokes
    _require_once(strokes, source, key)
    robot = robot_of(asked)
    if promised is not None:
        # Of rows that are cut other things differ, too.
        _require_rows(strokes_of(scene, robot), given[1], promised, source)
    expected = _in_parts(asked, strokes, robot)
    if best:
        place = {stroke.name: k for k, stroke in enumerate(strokes)}
        expected = sorted(expected, key=lambda stroke: place.get(stroke.name, len(place)))
    if len(strokes) != len(expected):
        lacking = {str(stroke.name) for stroke in expected} - {str(stroke.name) for stroke in strokes}
        told = [counted(len(strokes), "stroke"), *(f"{name} is missing" for name in sorted(lacking))]
        raise ArchiveError(source, key, ", ".join(told), f"{len(expected)}, as asked")
    for k, (stroke, other) in enumerate(zip(strokes, expected, strict=True)):
        entries, free = plain(stroke, key), _decided(stroke, other, in_any_direction=best)
        rest = {name: value for name, value in plain(other, key).items() if name not in free}
        same = {name: value for name, value in entries.items() if name in free}
        where = f"{key}[{k}]" if "strokes" in content["tool_path"] else "scene.tool_path"
        require_same(entries, rest | same, source, where, why="asked")


def _require_once(strokes: Sequence[StrokeFile], source: str, key: str) -> None:
    """Refuse parts of a raster that have a place of a row in common."""
    done = sorted(
        (stroke.part_of or str(stroke.name), piece.row, piece.begin_m, piece.end_m, k)
        for k, stroke in enumerate(strokes)
        for piece in (stroke.raster and stroke.raster.pieces) or ()
    )
    # Of pieces in their order two beside each other overlap where any do.
    for (*before, _, until, _), (name, row, begin, end, k) in pairwise(done):
        if before == [name, row] and min(until, end) - begin > _TOUCHING_M:
            got = f"row {row} of {name} from {begin:g} to {end:g} m, done before"
            raise ArchiveError(source, f"{key}[{k}].raster.pieces", got, "each place of it once")


def _require_same_robot(scene: Scene, asked: Scene, source: str) -> None:
    """Refuse a robot elsewhere with other meshes, or other files that the scene does not name, beside it."""
    if scene.robot.files != asked.robot.files and _contents(scene) != _contents(asked):
        expected = f"one whose meshes and files beside it are those of {shown(asked.robot.model)}, as asked"
        raise ArchiveError(source, "scene.robot.model", shown(scene.robot.model), expected)


def _contents(scene: Scene) -> list[str]:
    """The hashes of a robot's files and of its meshes; a shape that is no mesh has its kind."""
    robot = robot_of(scene)
    meshes = (shape.meshPath for shape in robot.collision_model.geometryObjects)
    each = (sha256(Path(mesh).read_bytes()).hexdigest() if is_file(mesh) else mesh for mesh in meshes)
    return [robot.content_hash, *each]


def require_still(plan: Plan, options: PlannerOptions, source: str) -> None:
    """Refuse a plan that begins elsewhere although it is pinned, or whose arm moves where it has to stand.

    That is beside strokes, while the process force sets in and ends.

    Raises
    ------
    ArchiveError
    """
    moved = plan.strokes[0].start.moved
    if options.start == "pinned" and moved and not plan.scene.begins_elsewhere:
        aside = aside_at_start(build_request(plan.scene, options), plan.job.strokes[0].trajectory.q[0])
        # The way back to a rigid arm's posture is that of the bent one's to first order.
        if aside > (0.0 if plan.sag is None else _ON_PATH + _SECOND_ORDER * moved):
            got = f"a start {aside:.3g} rad (or m) from the scene's posture"
            raise ArchiveError(source, "start", got, "that posture, as planner.start: pinned asks")
    ramp = plan.robot.tool_ramp
    for segment in plan.job.segments:
        moved = segment.moved_in_ramps(ramp) if segment.kind == "free" else 0.0
        if moved > _STANDS:
            got = f"an arm that moves {moved:.3g} rad (or m) while the process force sets in or ends"
            expected = f"one that stands for tool.process_ramp_s, {ramp:g} s, beside strokes"
            raise ArchiveError(source, segment.name, got, expected)


def _require_rows(strokes: Sequence[Stroke], asked: Scene, options: PlannerOptions, source: str) -> None:
    """Refuse strokes that leave out rows which the arm reaches."""
    own = _left_away(strokes)
    reached = _left_away(strokes_of(reached_scene(asked, options), robot_of(asked))) if own else {}
    for name, away in own.items():
        if away > (1 + _SAME_CUT) * reached.get(name, 0.0) + _TOUCHING_M:
            got = f"{1e3 * away:.4g} mm of the rows of {name} left away, and their overscan"
            expected = f"{1e3 * reached.get(name, 0.0):.4g} mm, as asked"
            raise ArchiveError(source, "rows", got, expected)


def _left_away(strokes: Sequence[Stroke]) -> dict[str, float]:
    """How much of the rows of each raster is left away, m."""
    away = dict[str, float]()
    for file, piece in pieces_left_out(strokes):
        name = str(file.part_of or file.name)
        away[name] = away.get(name, 0.0) + piece.length
    return away


def require_fixed(plan: Plan, options: PlannerOptions, source: str) -> None:
    """Refuse other via-points than those that gradient projection gives by options with fixed knots.

    Raises
    ------
    ArchiveError
    """
    request, before = build_request(plan.scene, options), np.array(plan.scene.posture)
    expected = "those of gradient projection, as planner.knots: fixed asks"
    for number, segment in enumerate(plan.job.strokes):
        stroke = request.at_stroke(number, JobState(posture=before))
        q, before = segment.trajectory.evaluate(stroke.times), segment.trajectory.q[-1]
        try:
            knots = fixed_knots(stroke)
            if (aside := np.abs(q - knots).max()) > _ON_PATH:
                # What keeps the arm away from obstacles may lead paths apart that differ by rounding.
                gain = stroke.cell.options.avoidance_gain * (1 + _OF_ROUNDING)
                knots = fixed_knots(stroke.with_options(avoidance_gain=gain)) - knots
                aside -= min(np.abs(knots).max(), _MOST_ASIDE)
            if aside <= _ON_PATH:
                continue
            got = f"via-points {aside:.3g} rad (or m) aside"
        except PlanningError as error:
            got = f"via-points where there are none ({error})"
        raise ArchiveError(source, segment.name, got, expected)


def _decided(stroke: StrokeFile, asked: StrokeFile, *, in_any_direction: bool) -> set[str]:
    """The entries of a stroke that planning decides, where it may."""
    decided = {"backwards"} if in_any_direction else set[str]()
    if asked.is_open or asked.speed_profile.kind == "quiet":
        decided.add("time_laws")
    # Planning takes more of them where the tool strays, or legs are short, and fewer where splines swing.
    given = [each.via_points for each in (stroke, asked)]
    if given[1] == AUTO or (isinstance(given[0], int) and given[0] >= _FEWEST_VIA_POINTS * given[1]):
        decided.add("via_points")
    return decided


def _in_parts(asked: Scene, strokes: Sequence[StrokeFile], robot: Robot) -> Sequence[StrokeFile]:
    """The strokes of a scene, its rasters and paths in the parts that the strokes of a plan cover."""
    asked = with_cuts(asked, robot, {str(file.name): allowed_cuts(file, strokes) for file in asked.strokes})
    files = {str(stroke.name): (k, stroke.raster) for k, stroke in enumerate(asked.strokes)}
    if not any(raster for _, raster in files.values()):
        return asked.strokes
    X_WT = Kinematics(robot).tool_pose(np.array(asked.posture)).homogeneous
    cells, whole = dict[str, list[tuple[RowPiece, ...]]](), dict[int, list[RowPiece]]()
    for timed in asked.in_cells(X_WT).timed_strokes(X_WT):
        if timed.surface is not None and timed.file.raster is not None:
            name, pieces = timed.file.part_of or timed.name, timed.file.raster.pieces or timed.surface.pieces
            whole.setdefault(files[name][0], []).extend(pieces)
            cells.setdefault(name, []).append(tuple(pieces))
    for name, (_, raster) in files.items():
        # By the numbers that end their names.
        parts = sorted(
            (s for s in strokes if name in (s.part_of, s.name)), key=lambda s: (len(str(s.name)), s.name)
        )
        covered = [s.raster.pieces for s in parts if s.raster is not None and s.raster.pieces is not None]
        if raster is not None and raster.cover == "reachable" and covered:
            cells[name] = [tuple(sorted(each, key=lambda piece: piece.row)) for each in covered]
    changed = {
        files[name][0]: each
        for name, each in cells.items()
        if len(each) > 1 or each != [tuple(whole[files[name][0]])]
    }
    return asked.with_cells(changed, whole).strokes
