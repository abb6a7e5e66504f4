"""The method, section by section: path, via-points, trajectory, certificate, plan.

Other rooms import from here; the parts of the method import each other's modules, as this one needs them all.
"""

from cmbot.optimization import ExchangeReport
from cmbot.planning.budget import Deadline
from cmbot.planning.certification.certificate import Certificate, certify
from cmbot.planning.certification.check import Check
from cmbot.planning.certification.metrics import MotionMetrics, Samples, figures, measure
from cmbot.planning.flexibility.sag_compensation import Compensation
from cmbot.planning.free_motion.free_move import FreeMove, certify_move, free_space, plan_move
from cmbot.planning.free_motion.free_space import FreeSpace
from cmbot.planning.initial_guess import Choice, searched
from cmbot.planning.job import APPROACH, RETURN, Job, Segment, free_move_name, job_metrics
from cmbot.planning.path.first_posture import starting_at_path
from cmbot.planning.path.gradient_projection import follow_path
from cmbot.planning.path.start_posture import StartPosture, find_start
from cmbot.planning.planner import plan, replan
from cmbot.planning.postures.projection import project_onto_task
from cmbot.planning.precheck import Precheck, precheck_options, precheck_scene
from cmbot.planning.progress import Progress, ProgressReporter
from cmbot.planning.request import JobState, StrokeRequest, build_request, end_posture_of, strokes_of, task_of
from cmbot.planning.result.baseline import Baseline, BaselineSegment, joined_samples
from cmbot.planning.result.judgement import baseline_faults, bound_use, during, tightest_check
from cmbot.planning.result.notes import Note, notes
from cmbot.planning.result.plan import Plan, Seconds, require_plan, work_of
from cmbot.planning.result.rows import LOAD_HEADINGS, Row, load_point, load_rows, loads, plan_rows
from cmbot.planning.result.stroke_plan import (
    ObjectiveMetrics,
    Start,
    StrokeBaseline,
    StrokePlan,
    baseline_task,
    objective_metrics,
)
from cmbot.planning.result.words import (
    first_remarks,
    left_out,
    promised,
    promises,
    remarks,
    sentence,
    verdict,
)
from cmbot.planning.selfmotion.followed_bound import quick_bound
from cmbot.planning.selfmotion.global_search import GlobalSearch
from cmbot.planning.selfmotion.lower_bound import LowerBound
from cmbot.planning.selfmotion.proof import TorqueFloorProof
from cmbot.planning.task import ToolTask
from cmbot.planning.workcell.diagnosis import most_often_near, weakest_joint
from cmbot.planning.workcell.objectives import (
    Objective,
    PostureFunction,
    PostureObjective,
    WeightedMoment,
    WrenchFunction,
    WrenchObjective,
    objective_of,
)
from cmbot.planning.workcell.stiffness import covariance_of, modelled_stiffness
from cmbot.planning.workcell.units import unit_findings
from cmbot.planning.workcell.workcell import (
    Workcell,
    bending_arm,
    held_guardrail,
    resolved_options,
    rigid_arm_remark,
    robot_of,
    sag_of,
)
from cmbot.trajectory import QuinticTrajectory, SplineSpace

__all__ = [
    "APPROACH",
    "LOAD_HEADINGS",
    "RETURN",
    "Baseline",
    "BaselineSegment",
    "Certificate",
    "Check",
    "Choice",
    "Compensation",
    "Deadline",
    "ExchangeReport",
    "FreeMove",
    "FreeSpace",
    "GlobalSearch",
    "Job",
    "JobState",
    "LowerBound",
    "MotionMetrics",
    "Note",
    "Objective",
    "ObjectiveMetrics",
    "Plan",
    "PostureFunction",
    "PostureObjective",
    "Precheck",
    "Progress",
    "ProgressReporter",
    "QuinticTrajectory",
    "Row",
    "Samples",
    "Seconds",
    "Segment",
    "SplineSpace",
    "Start",
    "StartPosture",
    "StrokeBaseline",
    "StrokePlan",
    "StrokeRequest",
    "ToolTask",
    "TorqueFloorProof",
    "WeightedMoment",
    "Workcell",
    "WrenchFunction",
    "WrenchObjective",
    "baseline_faults",
    "baseline_task",
    "bending_arm",
    "bound_use",
    "build_request",
    "certify",
    "certify_move",
    "covariance_of",
    "during",
    "end_posture_of",
    "figures",
    "find_start",
    "first_remarks",
    "follow_path",
    "free_move_name",
    "free_space",
    "held_guardrail",
    "job_metrics",
    "joined_samples",
    "left_out",
    "load_point",
    "load_rows",
    "loads",
    "measure",
    "modelled_stiffness",
    "most_often_near",
    "notes",
    "objective_metrics",
    "objective_of",
    "plan",
    "plan_move",
    "plan_rows",
    "precheck_options",
    "precheck_scene",
    "project_onto_task",
    "promised",
    "promises",
    "quick_bound",
    "remarks",
    "replan",
    "require_plan",
    "resolved_options",
    "rigid_arm_remark",
    "robot_of",
    "sag_of",
    "searched",
    "sentence",
    "starting_at_path",
    "strokes_of",
    "task_of",
    "tightest_check",
    "unit_findings",
    "verdict",
    "weakest_joint",
    "work_of",
]
