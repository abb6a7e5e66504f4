"""What is asked of the planner: a stroke in a workcell, from where the arm is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from cmbot.common.arrays import FloatArray
from cmbot.common.errors import PathNotFound, SceneError
from cmbot.common.representation import ShortRepr
from cmbot.planning.budget import SHORTEST_TIME_RUNS, Deadline
from cmbot.planning.progress import ProgressReporter
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.bent_tool import BentTool
from cmbot.planning.workcell.objectives import TRAVEL, Objective, WrenchFunction
from cmbot.planning.workcell.workcell import Workcell, build_workcell
from cmbot.robot import Kinematics, Robot
from cmbot.scene import SPEED_TOLERANCE, STOW, NamedState, PlannerOptions, Scene, Stroke
from cmbot.toolpath import ToolPoses
from cmbot.trajectory import QuinticTrajectory

# Beside what the arm asks anyway this share of it is nothing.
_NEGLIGIBLE_LOAD_SHARE = 1e-2


@dataclass(frozen=True, kw_only=True, eq=False)
class JobState(ShortRepr):
    """How far a job is planned.

    Attributes
    ----------
    posture : (n,), rad and m
        Where the arm is, at first in the scene's posture.
    begin : float, s
        Since when it is there, on the job's clock.
    reached : float
        Value of the objective that the job reaches before.
    """

    posture: FloatArray
    begin: float = 0.0
    reached: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A trajectory, and the task for which it was planned."""

    task: ToolTask
    trajectory: QuinticTrajectory


@dataclass(frozen=True, kw_only=True, eq=False)
class StrokeRequest(ShortRepr):
    """A stroke that is to be planned.

    Attributes
    ----------
    cell : Workcell
    state : JobState
        Before the stroke.
    strokes : tuple of Stroke
        Of the job.
    tasks : tuple of ToolTask
        What the scene prescribes on each of them.
    number : int
        Of the stroke among them, from 0.
    task : ToolTask
    times : (k,), s
        Of the via-points.
    first : (n,), rad and m
        The posture in which the work starts unless another one is better.
    end_posture : (n,), rad and m, or None
        In which the job ends; None: where the work ends.
    bent : BentTool or None
        Where the tool is that the task is for, where sag is compensated; None: the rigid arm's.
    spare_clearance : float, m
        Kept by what is optimised beyond the safety margin, which is certified.
    tool_share : float
        Of the bounds on the tool's deviation, rotation and lag that what is optimised keeps.
    least_travel : bool
        The travel of the joints is minimised in place of the objective, which has next to nothing to gain.
    proves : bool
        The lower bound is proven where that is possible, and found of laws that were chosen.
    most_runs : int
        Of optimise-and-certify at most.
    earlier : mapping of str to Motion
        Of the segments of an earlier plan, near which this one is planned, by their names.
    deadline : Deadline
    reporter : ProgressReporter
    """

    cell: Workcell
    state: JobState
    strokes: tuple[Stroke, ...]
    number: int
    task: ToolTask
    times: FloatArray
    first: FloatArray
    end_posture: FloatArray | None = None
    tasks: tuple[ToolTask, ...] = ()
    bent: BentTool | None = None
    spare_clearance: float = 0.0
    tool_share: float = 1.0
    least_travel: bool = False
    proves: bool = True
    most_runs: int = SHORTEST_TIME_RUNS
    earlier: Mapping[str, Motion] = field(default_factory=dict)
    deadline: Deadline = field(default_factory=Deadline)
    reporter: ProgressReporter = field(default_factory=ProgressReporter)

    @property
    def objective(self) -> Objective:
        """What is minimised along the stroke."""
        return TRAVEL if self.least_travel else self.cell.objective

    @property
    def stroke(self) -> Stroke:
        """The stroke that is planned."""
        return self.strokes[self.number]

    def at_stroke(self, number: int, state: JobState | None = None) -> StrokeRequest:
        """Return the request of another stroke of the job, from another state where given."""
        state, times = state or self.state, self.strokes[number].via_times
        changed = replace(self, number=number, task=self.tasks[number], times=times)
        return replace(changed, state=state, first=state.posture, least_travel=False)

    def with_options(self, **changes: Any) -> StrokeRequest:
        """Return the request with other options."""
        return replace(self, cell=self.cell.with_options(**changes))

    @cached_property
    def negligible(self) -> float:
        """Value of the objective that is nothing beside what the arm asks anyway, at rest where it is before.

        Or on the job before. A peak at rest may be zero, as where the arm's mass can be held above its base;
        shares of that say nothing.
        """
        off = self.cell.tool_off
        before = float(off.objective.at_rest(off.postures.at(self.state.posture[None]))[0])
        return _NEGLIGIBLE_LOAD_SHARE * max(self.state.reached, before)

    @property
    def tool_off(self) -> StrokeRequest:
        """The request in the workcell of motions with the tool off."""
        idle = self.cell.tool_off
        return self if idle is self.cell else replace(self, cell=idle)

    @cached_property
    def on_axis(self) -> StrokeRequest:
        """The request to hold the tool's axis in the middle of its cone; without a cone this one."""
        return self if self.task.cone is None else replace(self, task=self.task.on_axis)

    @cached_property
    def goals(self) -> ToolPoses:
        """Timed poses of the tool at the via-points."""
        return self.task.goals(self.times)

    def path_not_found(
        self,
        reason: str,
        q: FloatArray,
        time: float = 0.0,
        pair: tuple[str, str] | None = None,
        pace: float = 1.0,
        *,
        stopped: bool = False,
        key: str = "",
    ) -> PathNotFound:
        """Return the error of a path that ends at posture `q` (n,), `time` s after its start."""
        return PathNotFound(
            reason,
            time=float(time),
            progress=self.task.path.progress(float(time)),
            smallest_singular_value=self.task.smallest_singular_value(self.cell.robot, q),
            pair=pair,
            key=key,
            pace=pace,
            stopped=stopped,
        )


def build_request(
    scene: Scene,
    options: PlannerOptions,
    own: WrenchFunction | None = None,
    reporter: ProgressReporter | None = None,
    deadline: Deadline | None = None,
) -> StrokeRequest:
    """Return the request of the first stroke of a scene; the objective is the function `own` where given.

    Raises
    ------
    SceneError, ModelError
        When scene and robot do not fit together.
    InputError
        When `own` is no function of the wrench.
    """
    cell = build_workcell(scene, options, own)
    strokes, state = strokes_of(scene, cell.robot), JobState(posture=np.array(scene.posture))
    tasks = tuple(task_of(stroke, scene) for stroke in strokes)
    return StrokeRequest(
        cell=cell,
        state=state,
        strokes=strokes,
        number=0,
        tasks=tasks,
        task=tasks[0],
        times=strokes[0].via_times,
        first=state.posture,
        end_posture=end_posture_of(scene, cell.robot),
        reporter=reporter or ProgressReporter(),
        deadline=deadline or Deadline(),
    )


def end_posture_of(scene: Scene, robot: Robot) -> FloatArray | None:
    """Return the posture (n,), rad and m, in which a scene's job ends; None: where its work ends.

    It ends in a named state; an arm without a stow posture is put away where it started.

    Raises
    ------
    SceneError
        When its SRDF has no such state, or that is out of the joint ranges.
    """
    if scene.return_to == "none":
        return None
    name = scene.return_to.state if isinstance(scene.return_to, NamedState) else STOW
    state = robot.group_states.get(name)
    if state is None and isinstance(scene.return_to, NamedState):
        expected = "a group state of the arm's SRDF that sets all its joints"
        raise SceneError(scene.source, "return.state", repr(name), expected, tuple(robot.group_states))
    if scene.return_to == "start" or state is None:
        return np.array(scene.posture)
    return np.array(robot.posture(state, source=scene.source, key="return", error_type=SceneError))


def strokes_of(scene: Scene, robot: Robot) -> tuple[Stroke, ...]:
    """Return the strokes of a scene, from the tool pose of its posture; each cell of a raster is one.

    Raises
    ------
    SceneError
        When the posture does not fit the robot, or a tool path is none.
    """
    return in_cells(scene, robot).timed_strokes(_start_pose(scene, robot))


def in_cells(scene: Scene, robot: Robot) -> Scene:
    """Return a scene with a stroke for each cell of the rows of a raster.

    Raises
    ------
    SceneError
        As `strokes_of`.
    """
    return scene.in_cells(_start_pose(scene, robot))


def with_cuts(scene: Scene, robot: Robot, ends: Mapping[str, Sequence[float]]) -> Scene:
    """Return a scene with paths cut at some places: see `Scene.with_cuts`.

    Raises
    ------
    SceneError
        As `strokes_of`.
    """
    return scene.with_cuts(ends, _start_pose(scene, robot))


def _start_pose(scene: Scene, robot: Robot) -> FloatArray:
    """Pose (4, 4) of the tool in a scene's posture."""
    key, slides = scene.posture_key, np.flatnonzero(robot.limits.prismatic)
    if len(slides) and key == "start.posture_deg":
        got = f"degrees, but {robot.joints[slides[0]]} slides"
        expected = "start: {posture: [...]} in place of it, in rad and, of joints that slide, m"
        raise SceneError(scene.source, key, got, expected)
    posture = robot.posture(scene.posture, source=scene.source, key=key, error_type=SceneError)
    return np.asarray(Kinematics(robot).tool_pose(posture).homogeneous)


def task_of(stroke: Stroke, scene: Scene) -> ToolTask:
    """Return what a stroke of a scene prescribes of the tool."""
    speed = scene.tool.max_speed_m_s
    most = None if speed is None else speed * (1 + SPEED_TOLERANCE)
    task = ToolTask.of(stroke.path, stroke.file.keep, most, stroke.file.speed_tolerance)
    most, sway = stroke.file.max_base_torque_nm, stroke.file.max_sway_mm
    return replace(task, max_base_torque=most, max_sway=None if sway is None else 1e-3 * sway)
