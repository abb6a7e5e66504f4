"""Walk from one stance to another: the shortest way through the graph of stances, step by step certified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from cmbot.common.arrays import BoolArray, FloatArray
from cmbot.common.errors import CmbotError, PathNotFound, PlanningError, SceneError, whole_sentences
from cmbot.common.reading.input_files import is_file
from cmbot.common.reading.validation import counted, validated
from cmbot.common.reading.yaml_reader import read_yaml
from cmbot.common.representation import ShortRepr
from cmbot.hold import AdhesionPeak
from cmbot.robot import other_foot
from cmbot.scene import Scene, StanceFile, load_scene
from cmbot.stances import Candidate, in_world, own_candidate, require_on_guardrail
from cmbot.stances.walking.balance import SPARE, Balance, Roadmap
from cmbot.stances.walking.route import Edge, Route, nodes_between
from cmbot.stances.walking.steps import Move, Step, arm_move, blocked_end, plan_step, space_of_arm

# Postures of the arm with which a step is planned.
_TRIED_POSTURES = 15
# Steps that may turn out impossible before a walk is given up, a second each with straight swings; and moves
# of the arm from where it is in a stance before it is taken as caught there: each costs seconds.
_MOST_STRAIGHT_FAILURES, _MOST_FAILURES, _MOST_MOVES_IN_VAIN = 100, 20, 3
_TOO_NEAR = "the foot's straight swing comes too near to something, whatever folded posture the arm has"
# Characters of the cause for which a step failed, within a message that is about more.
_MAX_CAUSE_CHARACTERS = 100


@dataclass(frozen=True, kw_only=True)
class WalkOptions:
    """How a walk is sought.

    Attributes
    ----------
    spacing : float, m
        Between places of the feet along members.
    speed : float, m/s
        Largest of a foot that goes.
    """

    spacing: float = 0.15
    speed: float = 0.03


@dataclass(frozen=True, kw_only=True, eq=False)
class Walk(ShortRepr):
    """A certified walk.

    Attributes
    ----------
    scene : Scene
        Where it begins.
    goal : Candidate
        The stance in which it ends.
    steps : tuple of Step
    last : Move or None
        The arm's move to the posture in which the next work starts; None where it stays.
    failures : tuple of str
        Steps that were tried in vain, and why.
    speed : float, m/s
        Largest of a foot that goes.
    """

    scene: Scene
    goal: Candidate
    steps: tuple[Step, ...]
    last: Move | None
    failures: tuple[str, ...]
    speed: float

    @property
    def moves(self) -> tuple[Move, ...]:
        """All moves in their order."""
        last = () if self.last is None else (self.last,)
        return (*(move for step in self.steps for move in step.moves), *last)

    @property
    def seconds(self) -> float:
        """How long it takes, s."""
        return sum(move.segment.duration for move in self.moves)

    @property
    def begins(self) -> tuple[float, ...]:
        """When each move begins, s."""
        ends = np.cumsum([move.segment.duration for move in self.moves])
        return (0.0, *ends[:-1].tolist())

    @property
    def adhesion_needed(self) -> AdhesionPeak | None:
        """The largest adhesion that a foot needs, on the walk's clock; None without a flat contact."""
        peaks = list[AdhesionPeak]()
        for move, begin in zip(self.moves, self.begins, strict=True):
            peak = move.segment.figures.adhesion_needed
            if peak is not None:
                foot = move.holds[peak.foot - 1] if peak.foot <= len(move.holds) else peak.foot
                peaks.append(replace(peak, time=begin + peak.time, foot=foot))
        return max(peaks, key=lambda each: each.peak, default=None)

    @property
    def effort(self) -> float:
        """The largest share of a joint's effort that the steps use."""
        each = (move.segment.figures.limit_use.torque for move in self.moves)
        return max(each, default=0.0)

    def in_words(self) -> Iterator[str]:
        """Yield what was found, a sentence each."""
        arms = sum(move.kind == "arm" for move in self.moves)
        yield (
            f"{counted(len(self.steps), 'step')} and {counted(arms, 'move')} of the arm in "
            f"{self.seconds:.0f} s, a foot at most {self.speed:g} m/s."
        )
        needed = self.adhesion_needed
        if needed is not None:
            yield (
                f"Adhesion needed at most {needed.peak / 1e3:.2f} kN (foot {needed.foot}, {needed.mode}, at "
                f"{needed.time:.1f} s)."
            )
        yield f"The joints use at most {100 * self.effort:.0f} % of their efforts."
        if self.scene.guardrail.hold is None:
            yield "The feet are taken as welded: this says nothing about holding; see guardrail.hold."
        if self.failures:
            yield f"{counted(len(self.failures), 'other step')} turned out impossible on the way."


def walk(
    scene: Scene,
    to: Scene | StanceFile,
    options: WalkOptions | None = None,
    progress: Callable[[str, float], None] = lambda _step, _share: None,
) -> Walk:
    """Plan the steps from a scene's stance to another one.

    One foot lets go, the climbing joints swing it with the arm locked as a counterweight, it holds again.
    Every move is certified: ranges, velocities, efforts, clearances, and what the foot that holds bears. On
    two feet the arm moves to where the next step has the smallest load.

    Parameters
    ----------
    scene : Scene
        Of the shipped robot on a guardrail. The walk begins in its stance and its posture.
    to : Scene or StanceFile
        Where it ends; of a scene the arm ends in its posture, too.
    options : WalkOptions, optional
    progress : callable
        Takes what is done and the share of it.

    Raises
    ------
    SceneError
        When there is no guardrail to walk on, a stance is none, or a foot that has to go has something in its
        way where it stands or is to stand.
    PlanningError
        When no steps lead there that joints and feet can bear, with the figures of the easiest one.

    Examples
    --------
    A search of minutes:

    >>> steps = cmbot.walk(cmbot.load_scene("here.yaml"), cmbot.load_scene("there.yaml"))  # doctest: +SKIP
    """
    options = options or WalkOptions()
    first = stance_of(scene)
    last = goal_stance(to, scene)
    if last.stance == first.stance:
        got, expected = "the stance where the walk is to end", "another one: the robot stands there already"
        raise SceneError(scene.source, "guardrail.stance", got, expected)
    posture, world = np.array(scene.posture), in_world(scene)
    _require_free(world, first, last, to)
    progress("listing stances", 0.0)
    balance = Balance(scene, posture)
    route = Route(nodes_between(scene, first, last, options.spacing), balance)
    search = _Search(world, balance, route, posture, options, progress)
    steps = search.steps()
    end = None
    if isinstance(to, Scene):
        progress("moving the arm to where it works", 1.0)
        end = arm_move(world, last, search.arm, np.array(to.posture))
    return Walk(
        scene=scene,
        goal=last,
        steps=tuple(steps),
        last=end,
        failures=tuple(search.failures),
        speed=options.speed,
    )


def _require_free(world: Scene, first: Candidate, last: Candidate, to: Scene | StanceFile) -> None:
    """Refuse ends between which a foot has to go, if something is in its way at one of them."""
    for foot in (1, 2):
        stays = first.stance.places[foot - 1] == last.stance.places[foot - 1]
        if stays or (blocked := blocked_end(world, first, last, foot)) is None:
            continue
        end, other = blocked
        source, key = (world if end == "before" else to), "guardrail.stance"
        name, key = (source.source, key) if isinstance(source, Scene) else ("cmbot.walk", "to")
        expected = "a free one: the foot would touch it there, or on its way along the face's normal"
        raise SceneError(name, f"{key}.foot_{foot}", f"a place beside {other}", expected)


class _Search:
    """Plans the steps of the shortest route, and of others from where one turns out impossible."""

    def __init__(
        self,
        scene: Scene,
        balance: Balance,
        route: Route,
        arm: FloatArray,
        options: WalkOptions,
        progress: Callable[[str, float], None],
    ) -> None:
        self._scene, self._balance, self._route = scene, balance, route
        self._options, self._progress = options, progress
        self._possible, self._moves_in_vain = dict[int, BoolArray](), dict[tuple[int, int], list[str]]()
        self.arm, self._weight, self.failures = arm, 0, list[str]()
        # The moves of a foot, or why there are none, by ends of the step and posture of the arm.
        self._swings = dict[tuple[int, int, int, bool], tuple[tuple[Move, ...], str]]()
        self._roadmaps = dict[tuple[int, int], Roadmap | None]()
        # A swing straight in joint space takes a tenth of the time to find: all ways are tried so first.
        self._straight, self._not_straight = True, list[Edge]()

    def steps(self) -> list[Step]:
        """Plan until the goal is reached."""
        here, made = 0, list[Step]()
        # Nodes from which the steps lead, and the arm's posture before each.
        came = list[tuple[int, FloatArray, int]]()
        while here != 1:
            edges = self._route.shortest(here)
            most = _MOST_STRAIGHT_FAILURES if self._straight else _MOST_FAILURES
            if edges is None or len(self.failures) >= most:
                if not self._not_straight:
                    raise PlanningError(self._no_way(here))
                self._route.reopen(self._not_straight)
                self._straight, self._not_straight, self.failures = False, [], []
                continue
            unknown = [k for k in {here, *(edge.after for edge in edges)} if k not in self._possible]
            if unknown:
                self._progress(f"checking stances ({len(self._possible)} so far)", 0.0)
                for k in unknown:
                    self._check(k)
                continue
            if self._straight:
                # All of the way is looked at before the arm moves for any of it.
                vain = [edge for edge in edges if not self._route.swings(edge)]
                vain = vain or [*islice((edge for edge in edges if not self._passes(edge)), 1)]
                for edge in vain:
                    self._route.close(edge)
                self._not_straight += vain
                if vain:
                    continue
            after = {edge.after for edge in edges}
            back = next((k for k, (node, *_) in enumerate(came) if node in after), None)
            if back is not None:
                # It leads on from where the walk was before: the steps since then are not needed.
                here, self.arm, self._weight = came[back]
                del made[back:], came[back:]
                continue
            number = len(made) + len(edges)
            self._progress(f"planning step {len(made) + 1} of {number}", len(made) / number)
            state = here, self.arm, self._weight
            step = self._step(edges[0])
            if step is None:
                self._route.close(edges[0])
                self._not_straight += [edges[0]] if self._straight else []
                continue
            made.append(step)
            came.append(state)
            here = edges[0].after
        return made

    def _passes(self, edge: Edge) -> bool:
        """Whether a straight swing is possible in a step with one of the counterweights."""
        why = _TOO_NEAR
        for k in self._route.counterweights(edge, self._weight)[:_TRIED_POSTURES].tolist():
            moves, why = self._swing(edge, k)
            if moves:
                return True
        self.failures.append(_cause(why))
        return False

    def _swing(self, edge: Edge, k: int, *, straight: bool = True) -> tuple[tuple[Move, ...], str]:
        """The moves of a foot with a posture of the arm, or none and why."""
        key = edge.before, edge.after, k, straight
        if key not in self._swings:
            ends, why = (self._route.nodes[edge.before], self._route.nodes[edge.after]), _TOO_NEAR
            arm, speed = self._balance.arms[k], self._options.speed
            moves: tuple[Move, ...] = ()
            try:
                if (blocked := blocked_end(self._scene, *ends, edge.foot)) is None:
                    moves = plan_step(self._scene, *ends, edge.foot, arm, speed, straight=straight)
                else:
                    why = f"{blocked[1]} is in the way of foot {edge.foot} where it stands"
            except CmbotError as error:
                why = _reason(error)
            self._swings[key] = moves, why
        return self._swings[key]

    def _step(self, edge: Edge) -> Step | None:
        before, after = (self._route.nodes[k] for k in (edge.before, edge.after))
        weights = self._route.counterweights(edge, self._weight).tolist()
        ways: list[tuple[int, FloatArray | None]] = [
            *islice(self._ways(edge.before, weights), _TRIED_POSTURES)
        ]
        # Without a way through the roadmap one is sought for a few.
        ways = ways or [(k, None) for k in weights[:_MOST_MOVES_IN_VAIN]]
        why, bent = _TOO_NEAR, [] if self._straight else ways[:1]
        for (k, way), straight in (*((each, True) for each in ways), *((each, False) for each in bent)):
            arm = self._balance.arms[k]
            in_vain = self._moves_in_vain.setdefault((edge.before, self._weight), [])
            if way is None and len(in_vain) >= _MOST_MOVES_IN_VAIN:
                why = in_vain[-1]
                continue
            swung, why = self._swing(edge, k, straight=straight)
            if not swung:
                continue
            try:
                moved = arm_move(self._scene, before, self.arm, arm, way)
            except CmbotError as error:
                why = _reason(error)
                in_vain.append(why)
                continue
            self.arm, self._weight = arm, k
            moves = swung if moved is None else (moved, *swung)
            return Step(foot=edge.foot, before=before, after=after, moves=moves)
        self.failures.append(_cause(why))
        return None

    def _ways(self, node: int, weights: Sequence[int]) -> Iterator[tuple[int, FloatArray]]:
        """Yield the postures of the arm to which ways lead from where it is in a stance, with these ways."""
        key = node, self._weight
        if key not in self._roadmaps:
            space = space_of_arm(self._scene, self._route.nodes[node], self.arm)
            possible = self._possible[node].copy()
            possible[self._weight] = True
            self._roadmaps[key] = None if space is None else self._balance.roadmap(possible, space)
        roadmap = self._roadmaps[key]
        if roadmap is not None:
            ways = ((k, roadmap.way(self._weight, k)) for k in weights)
            yield from ((k, way) for k, way in ways if way is not None)

    def _check(self, k: int) -> None:
        """Leave out the postures of the arm that come too near to something in a stance."""
        impossible = self._balance.impossible(self._scene, self._route.nodes[k])
        self._possible[k] = ~impossible
        self._route.leave_out(k, impossible)

    def _no_way(self, here: int) -> str:
        """Why there is no route, with the hardest step of the easiest way, and what would do for it."""
        hardest, which, tried = self._route.easiest_way(here), "easiest", ""
        if self.failures:
            tried = (
                f"; {counted(len(self.failures), 'step')} that would hold at rest tried in vain, the last: "
            )
            tried += self.failures[-1]
            which = "easiest other" if hardest else "easiest"
            hardest = hardest or self._route.easiest_way(here, tried=True)
        if hardest is None:
            return f"no walk: whatever joints and feet could bear, no steps lead there{tried}"
        before, after = (self._route.nodes[k] for k in (hardest.before, hardest.after))
        stays = other_foot(hardest.foot)
        shares = np.maximum(*self._route.use[stays][[hardest.before, hardest.after]])
        k = int(shares.argmin())
        use = float(shares[k])
        loads = [self._balance.step_load(node, stays) for node in (before, after)]
        load = max(loads, key=lambda load: float(load.use[k]))
        bears = f"climb_{load.joint[k]:.0f} {100 * load.effort[k]:.0f} % of its effort"
        if load.adhesion[k] > 0:
            bears += f", adhesion needed {load.adhesion[k] / 1e3:.2f} kN"
        elif load.use[k] > load.effort[k]:
            bears += f", foot {stays} {100 * load.use[k]:.0f} % of its hold"
        would = "" if use <= SPARE else f"; bounds {use / SPARE:.1f} times as large would do at rest"
        return (
            f"no walk: the hardest step of the {which} way, {_names(before)} to {_names(after)}, uses "
            f"{100 * use:.0f} % of what is allowed ({bears}){would}{tried}"
        )


def _reason(error: CmbotError) -> str:
    """Why a move was not found; how far it came along a tool path says nothing."""
    return error.reason if isinstance(error, PathNotFound) else str(error)


def _cause(why: str) -> str:
    """The first clause of a cause, so that a message that is about more than that holds it."""
    return whole_sentences(why.partition("; ")[0], _MAX_CAUSE_CHARACTERS)


def _names(node: Candidate) -> str:
    places = node.stance.places
    return " and ".join("free" if at is None else f"{at.member} {at.along_m:.2f} m" for at in places)


def stance_of(scene: Scene) -> Candidate:
    """Return where the robot of a scene stands.

    Raises
    ------
    SceneError
        When it does not stand on a member of a guardrail.
    """
    require_on_guardrail(scene)
    if (stance := own_candidate(scene)) is None:
        expected = "a stance, as the foot holds no member"
        raise SceneError(scene.source, "guardrail.stance", "nothing", expected)
    return stance


def goal_stance(to: Scene | StanceFile, scene: Scene) -> Candidate:
    """Return the stance in which a walk of a scene is to end."""
    return stance_of(to if isinstance(to, Scene) else scene.with_stance(to))


def load_goal(path: str | Path) -> Scene | StanceFile:
    """Return where a walk is to end: a scene, or a file with what `guardrail.stance` has.

    Parameters
    ----------
    path : str or Path
        Or the name of a shipped scene.

    Raises
    ------
    SceneError
        When it is neither.
    """
    if is_file(path) and "foot_1" in (data := read_yaml(path, SceneError)):
        return validated(StanceFile, data, str(path), SceneError)
    # As text: a path is never the name of a shipped scene.
    return load_scene(str(path))
