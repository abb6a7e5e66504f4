"""The folders of plans, walks and tours, verified: certified anew, and computed a second time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby
from pathlib import Path

import numpy as np

from cmbot.archive.folder import listed_name, missing_files, read_file, require_settled
from cmbot.archive.reading import read_plan
from cmbot.archive.records import PLAN_FILE, TOUR_FILE, WALK_FILE, require_same
from cmbot.archive.tables import require_table
from cmbot.archive.verification.asked import (
    looser_promises,
    other_options,
    other_via_points,
    require_asked,
    require_promised,
)
from cmbot.archive.walks import TourPart, bridge_of, ends_of, load_walk, place, read_tour
from cmbot.common.errors import ArchiveError, InputError, LimitViolation
from cmbot.common.reading.validation import counted, given_path, shown
from cmbot.planning import Check, Plan, bending_arm, resolved_options
from cmbot.scene import PlannerOptions, Scene, StanceFile
from cmbot.stances import in_world, joined
from cmbot.stances.walking import Walk, WalkOptions, goal_stance, second_opinion_of, walk_csv

# Stances and postures are the same but for so much.
_STANCE_TOLERANCE = 1e-6
_WALK_TABLE = "walk.csv"
_COMPENSATION = "compensation (its figures; that via-points are nearer than planner.max_tool_deviation_m)"
# What a scene says beside the world in which the robot works.
_OF_THE_WORK = {"format", "name", "tool_path", "planner", "start"}


@dataclass(frozen=True, kw_only=True)
class VerifiedMotion:
    """A motion whose checks all hold.

    Attributes
    ----------
    part : str
        Of a tour, such as ``work_1``; otherwise empty.
    name : str
        Such as ``approach``.
    seconds : float
    checks : tuple of Check
        Of its certificate, and of a second computation.
    """

    part: str
    name: str
    seconds: float
    checks: tuple[Check, ...]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What was verified of a folder, and what was not.

    Attributes
    ----------
    looser : tuple of str
        What its plans promise less, or otherwise, than the scenes in them ask for.
    other_options : tuple of str
        What else of their options is not what was asked: effort, and promises of more.
    taken : tuple of str
        Where no scene was asked: what those in it say of the world, but for defaults, and ask less than by
        default.
    motions : tuple of VerifiedMotion
    compared : tuple of str
        Names of files that were compared with a plan, and agree.
    not_verified : tuple of str
        What it says that was not computed again: keys of records, and names of files.
    """

    looser: tuple[str, ...] = ()
    other_options: tuple[str, ...] = ()
    taken: tuple[str, ...] = ()
    motions: tuple[VerifiedMotion, ...] = ()
    compared: tuple[str, ...] = ()
    not_verified: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What was asked of a folder.

    Attributes
    ----------
    scenes : tuple of Scene
        Of a plan or a walk one, of a tour all of them; empty: what the folder says.
    options : PlannerOptions or None
        In place of the scene's.
    goal : Scene, StanceFile or None
        Where a walk was to end.
    foot_speed : float, m/s
        Largest of a foot that goes.
    """

    scenes: tuple[Scene, ...] = ()
    options: PlannerOptions | None = None
    goal: Scene | StanceFile | None = None
    foot_speed: float = WalkOptions.speed


def verified_motions(directory: str | Path, asked: Asked | None = None) -> Verdict:
    """Verify the folder of a plan, a walk or a tour.

    Parameters
    ----------
    directory : str or Path
    asked : Asked, optional

    Raises
    ------
    InputError
        When `directory` is no path, several scenes are given for what is no tour, or a goal for no walk.
    ArchiveError
        When a file is missing, damaged or contradicts the others, a motion breaks a promise, or it is not
        what was asked for.
    SceneError, ModelError
        When its scene or its robot cannot be used.
    """
    folder, asked = given_path(directory, "cmbot verify", "DIR", "the path of a folder"), asked or Asked()
    if len(records := [name for name in (PLAN_FILE, WALK_FILE, TOUR_FILE) if (folder / name).exists()]) > 1:
        raise ArchiveError(str(folder), "", " and ".join(records), "one of them: the folder of one thing")
    if asked.goal is not None and PLAN_FILE in records:
        raise InputError("cmbot verify", "--to", str(folder), "the folder of a walk or a tour, with a goal")
    if TOUR_FILE in records:
        return _verified_tour(folder, asked)
    if len(asked.scenes) > 1:
        got = counted(len(asked.scenes), "scene")
        raise InputError("cmbot verify", "--scene", got, "one: only a tour is of several")
    return _verified(folder, "", asked)[1]


def _verified_tour(folder: Path, asked: Asked) -> Verdict:
    """Verify the parts, that each begins where the one before ends, and that they are what was asked for."""
    verdicts, whole = list[Verdict](), joined(asked.scenes) if asked.scenes else None
    options = asked.options or (None if whole is None else whole.planner)

    def read(part: Path) -> Plan | Walk:
        motion, verdict = _verified(part, part.name, replace(asked, scenes=(), goal=None, options=options))
        verdicts.append(verdict)
        return motion

    parts = read_tour(folder, read)
    if whole is not None:
        others = _require_tour(folder, parts, whole, leads_on=asked.goal is not None)
        verdicts.append(Verdict(other_options=others))
    if asked.goal is not None:
        last = parts[-1].motion
        if not isinstance(last, Walk):
            raise ArchiveError(str(folder / TOUR_FILE), "parts", parts[-1].name, "a walk to the goal at last")
        _require_goal(last, asked.goal, str(folder / parts[-1].name / WALK_FILE))
    beside = _others(folder, TOUR_FILE, [part.name for part in parts])
    told = "version, words, where its work begins", *_arm_elsewhere(parts[-1].motion, asked.goal), *beside
    verdicts.append(Verdict(not_verified=told))
    each = {
        name: tuple(dict.fromkeys(chain(*(getattr(verdict, name) for verdict in verdicts))))
        for name in vars(verdicts[0])
    }
    return Verdict(**each)


def _require_tour(
    folder: Path, parts: Sequence[TourPart], asked: Scene, *, leads_on: bool
) -> tuple[str, ...]:
    """Refuse a tour of another bridge, without each stroke asked once, or in another order in a stance.

    Also one that walks on after the work, unless that `leads_on` to a goal. Returns what else differs.
    """
    source, scene = folder / TOUR_FILE, parts[0].motion.scene
    own, common = (bridge_of(one.with_files_of(scene)) for one in (scene, asked))
    require_same(own, common, str(source), "scene", why="asked")
    plans = [part.motion for part in parts if isinstance(part.motion, Plan)]
    strokes = {str(stroke.name): stroke for stroke in asked.strokes}
    # Of each plan the strokes, each once whose parts it does.
    each = [list(dict.fromkeys(s.part_of or str(s.name) for s in plan.scene.strokes)) for plan in plans]
    done = list(chain(*each))
    if len(strokes) == 1 and plans:
        # That of a path without strokes has the name of the scene.
        strokes = dict.fromkeys(done[:1], asked.strokes[0])
    if sorted(done) != sorted(strokes):
        got, expected = (", ".join(names) or "none" for names in (done, strokes))
        raise ArchiveError(str(source), "parts", got, f"each stroke once, as asked: {expected}")
    if isinstance(parts[-1].motion, Walk) and not leads_on:
        raise ArchiveError(str(source), "parts", parts[-1].name, "work at last, or --to and where it leads")
    others = list[str]()
    names = list(strokes)
    if asked.order != "best" and done != names:
        got = f"tool_path.order: {', '.join(done)}"
        if any(some != sorted(some, key=names.index) for some in _in_one_stance(parts, each)):
            raise ArchiveError(str(source), "parts", got, f"the order that is asked: {', '.join(names)}")
        others.append(f"{got} (asked {', '.join(names)}: of stances along the guardrail)")
    for plan, some in zip(plans, each, strict=True):
        files = [strokes[name].changed(name=name) for name in some]
        wanted = plan.scene.with_strokes(files, asked.order)
        require_asked(plan.scene, wanted, str(source), plan.options)
        others += other_via_points(plan.scene, wanted)
    return tuple(others)


def _in_one_stance(parts: Sequence[TourPart], strokes: Sequence[list[str]]) -> Iterator[list[str]]:
    """Yield the strokes that a tour does in each of its stances; `strokes` are those of each plan."""
    each = iter(strokes)
    for is_work, some in groupby(parts, key=lambda part: isinstance(part.motion, Plan)):
        if is_work:
            yield list(chain(*(next(each) for _ in some)))


def _verified(folder: Path, name: str, asked: Asked) -> tuple[Plan | Walk, Verdict]:
    """A plan or a walk, and what was verified of it; `name` is that of a part of a tour."""
    is_walk = (folder / WALK_FILE).exists()
    source = folder / (WALK_FILE if is_walk else PLAN_FILE)
    part: Plan | Walk
    looser: tuple[str, ...]
    others: tuple[str, ...] = ()
    compared: tuple[str, ...] = ()
    try:
        if is_walk:
            part = load_walk(folder)
            looser = _require_walk(part, asked, str(source))
            skipped = (*(["failures"] if part.failures else []), *_walk_files(folder, part))
            # In a tour the next part begins there.
            skipped += () if name else tuple(_arm_elsewhere(part, asked.goal))
        else:
            scene = asked.scenes[0] if asked.scenes else None
            part, files = read_plan(folder, verify=True, asked=scene, options=asked.options)
            options = asked.options or (scene or part.scene).planner
            options = resolved_options(part.scene, bending_arm(part.scene, part.robot), options)
            looser, others = looser_promises(part.options, options), other_options(part.options, options)
            if part.objective.own:
                wanted = shown(options.objective)
                others += (f"objective {shown(part.objective.name)}, a function in Python (asked {wanted})",)
            if scene is not None:
                others += other_via_points(part.scene, scene)
                if part.scene.name != scene.name:
                    others += (f"scene.name {shown(part.scene.name)} (asked {shown(scene.name)})",)
            compared = files.compared
            skipped = (*_claims(part, scene), *files.others, *_elsewhere(folder, PLAN_FILE))
        taken = () if asked.scenes else tuple(_taken(part.scene))
        motions = tuple(_motions(name, part))
    except LimitViolation as error:
        got = f"{error.value:.6g} {error.unit} at t = {error.time:.3f} s"
        beyond = "at least" if error.value < error.bound else "at most"
        expected = f"{beyond} {error.bound:.6g} {error.unit}"
        raise ArchiveError(str(source), error.quantity, got, expected) from error
    texts = {"looser": looser, "other_options": others, "compared": compared, "not_verified": skipped}
    lead = f"{name}: " if name else ""
    named = {key: tuple(lead + text for text in each) for key, each in texts.items()}
    told = Verdict(taken=taken, motions=motions, **named)
    return part, told


def _taken(scene: Scene) -> Iterator[str]:
    """What a scene says of the world, but for defaults, by its keys, and what it asks less."""
    world = scene.model_dump(mode="json", exclude_defaults=True, exclude_none=True, exclude=_OF_THE_WORK)
    for key, value in world.items():
        # A block of defaults is there all the same.
        for name, inner in value.items() if isinstance(value, dict) and value else [("", value)]:
            yield f"{key}{name and '.'}{name} {len(inner) if isinstance(value, list) else shown(inner)}"
    yield "its own start and tool_path"
    for differing in (looser_promises, other_options):
        yield from differing(scene.planner, PlannerOptions(), "default")


def _require_walk(walk: Walk, asked: Asked, source: str) -> tuple[str, ...]:
    """Refuse a walk that is not what was asked for; return what it promises less, where nobody asked."""
    if asked.goal is not None:
        _require_goal(walk, asked.goal, source)
    for scene in asked.scenes:
        require_asked(walk.scene, scene, source, asked.options or scene.planner)
    # Of a tour's scenes its parts have the options.
    promised = asked.options or (asked.scenes[0].planner if asked.scenes else None)
    if promised is not None:
        require_promised(walk.scene.planner, promised, source, "scene.planner")
    if walk.speed <= asked.foot_speed:
        return ()
    if promised is not None:
        raise ArchiveError(
            source, "max_foot_speed", walk.speed, f"at most {asked.foot_speed:g} m/s, as asked"
        )
    return (f"max_foot_speed {walk.speed:g} m/s (where none is asked {asked.foot_speed:g})",)


def _require_goal(walk: Walk, goal: Scene | StanceFile, source: str) -> None:
    """Refuse a walk that ends in another stance or posture, or goes on where a stance alone was asked for."""
    _, ends = ends_of(walk)
    scene = goal if isinstance(goal, Scene) else walk.scene
    posture = np.array(scene.posture) if scene is goal else ends[-len(scene.posture) :]
    if scene is not goal and walk.last is not None:
        expected = "none after the last step: a stance is asked for"
        raise ArchiveError(source, "last", "a move of the arm", expected)
    away = float(np.abs(ends - place(goal_stance(goal, walk.scene), posture)).max())
    if not away <= _STANCE_TOLERANCE:
        got = f"another stance or posture, by {away:.3g} m or rad"
        raise ArchiveError(source, "goal", got, "that which was asked for")


def _arm_elsewhere(part: Plan | Walk, goal: Scene | StanceFile | None) -> Iterator[str]:
    """How far from where it begins the arm of a walk ends, where nothing asks for its posture."""
    if isinstance(part, Walk) and not isinstance(goal, Scene):
        begins, ends = (row[-len(part.scene.posture) :] for row in ends_of(part))
        if (away := np.abs(ends - begins).max()) > _STANCE_TOLERANCE:
            yield f"where the arm ends ({away:.3g} rad from where it begins)"


def _walk_files(folder: Path, walk: Walk) -> tuple[str, ...]:
    """Compare the table of a walk with its knots; return what else is there."""
    told = (
        "version, times of checks, that no way is shorter or has fewer steps",
        *_others(folder, WALK_FILE, [_WALK_TABLE]),
    )
    if not (table := folder / _WALK_TABLE).exists():
        return (*told, f"{_WALK_TABLE} (not there)")
    require_table(read_file(table), walk_csv(walk).encode(), str(table))
    return told


def _others(folder: Path, record: str, known: Collection[str]) -> tuple[str, ...]:
    """The names of what is in a folder beside its record and what is known."""
    require_settled(folder)
    others = (path for path in sorted(folder.iterdir()) if path.name not in (record, *known))
    return (*map(listed_name, others), *_elsewhere(folder, record))


def _elsewhere(folder: Path, record: str) -> Iterator[str]:
    """What of a folder is elsewhere, where it may change after it was verified, or nowhere."""
    yield from (f"{listed_name(path)} (a link)" for path in sorted(folder.iterdir()) if path.is_symlink())
    yield from (f"{name} (listed, but not there)" for name in missing_files(folder, record))


def _claims(plan: Plan, asked: Scene | None) -> Iterator[str]:
    """The keys of plan.json whose values only planning anew could confirm."""
    if plan.baseline is not None:
        yield "baseline (that its motion and its jerk are those that it is compared with)"
    if plan.torque_floor is not None:
        yield f"torque_floor ({plan.torque_floor:.6g} Nm, said to be {plan.torque_floor_kind}), gap_to_floor"
    for name, key in (("lower_bound", "floor"), ("choice", "choice"), ("compensation", _COMPENSATION)):
        if any(getattr(stroke, name) is not None for stroke in plan.strokes):
            yield key
    parts = Counter(stroke.part_of for stroke in plan.scene.strokes if stroke.part_of is not None)
    for whole, number in parts.items():
        yield f"{whole} (that it has to be done in {counted(number, 'part')}, cut and ordered like this)"
    for name, coverage in plan.coverage.items():
        if coverage.left_out or coverage.unreached:
            share = f"{100 * coverage.left_out / coverage.area:.2g} % of it"
            yield f"raster {name} (that nothing reaches the rows that it leaves out, {share})"
    if any(stroke.is_open for stroke in plan.scene.strokes):
        yield "seconds: auto (that no time is shorter)"
    if any(stroke.speed_profile.kind == "quiet" for stroke in plan.scene.strokes):
        yield "speed_profile: quiet (that no other law sways less)"
    if asked is not None and asked.order == "best":
        yield "tool_path.order (that no other is better)"
    if any(len(segment.task.path.segments) > 1 for segment in plan.job.strokes):
        yield "rest between legs (but for planner.max_tool_deviation_m)"
    if any(segment.kind == "free" for segment in plan.job.segments):
        yield "free moves (that none is shorter, or quicker)"
    if plan.options.quiet_modes and plan.sway is not None:
        yield f"quiet_modes: {plan.options.quiet_modes} (that they come to rest; the swing is computed)"
    yield f"objective: {plan.objective.name} (that it was planned by it: that no motion has a lower one)"
    yield "start.failures, passes, runs, stopped, missing, fallbacks, seconds, versions, along_self_motion"
    yield "times and names in certificate.checks, times of peaks, options of effort"


def _motions(name: str, part: Plan | Walk) -> Iterator[VerifiedMotion]:
    if isinstance(part, Plan):
        for segment in part.job.segments:
            checks, seconds = segment.certificate.checks, segment.duration
            yield VerifiedMotion(part=name, name=segment.name, seconds=seconds, checks=checks)
        return
    scene = in_world(part.scene)
    for number, move in enumerate(part.moves, start=1):
        known, seconds = move.segment.certificate, move.segment.duration
        certificate = replace(known, checks=(*known.checks, *second_opinion_of(move, scene)))
        certificate.require()
        title = f"{move.kind}_{number}"
        yield VerifiedMotion(part=name, name=title, seconds=seconds, checks=certificate.checks)
