"""The method, section by section: path, via-points, trajectory, certificate, plan.

Other rooms import from here; the parts of the method import each other's modules, as this one needs them all.
"""

from cmbot.optimization import ExchangeReport as ExchangeReport
from cmbot.planning.budget import Deadline as Deadline
from cmbot.planning.certification.certificate import Certificate as Certificate, certify as certify
from cmbot.planning.certification.check import Check as Check
from cmbot.planning.certification.metrics import (
    MotionMetrics as MotionMetrics,
    Samples as Samples,
    figures as figures,
    measure as measure,
)
from cmbot.planning.flexibility.sag_compensation import (
    Compensation as Compensation,
    fixed_knots as fixed_knots,
)
from cmbot.planning.free_motion.free_move import (
    FreeMove as FreeMove,
    certify_move as certify_move,
    free_space as free_space,
    plan_move as plan_move,
)
from cmbot.planning.free_motion.free_space import FreeSpace as FreeSpace
from cmbot.planning.initial_guess import Choice as Choice, searched as searched
from cmbot.planning.job import (
    APPROACH as APPROACH,
    RETURN as RETURN,
    BaselineSegment as BaselineSegment,
    Job as Job,
    Segment as Segment,
    force_share as force_share,
    free_move_name as free_move_name,
    job_metrics as job_metrics,
)
from cmbot.planning.path.first_posture import starting_at_path as starting_at_path
from cmbot.planning.path.gradient_projection import (
    aside_at_start as aside_at_start,
    follow_path as follow_path,
)
from cmbot.planning.path.raster_reach import (
    reached_scene as reached_scene,
    unreached_area as unreached_area,
)
from cmbot.planning.path.start_posture import StartPosture as StartPosture, find_start as find_start
from cmbot.planning.planner import plan as plan, plan_candidate as plan_candidate, replan as replan
from cmbot.planning.postures.projection import project_onto_task as project_onto_task
from cmbot.planning.precheck import (
    precheck_options as precheck_options,
    precheck_scene as precheck_scene,
    require_sound_path as require_sound_path,
)
from cmbot.planning.progress import Progress as Progress
from cmbot.planning.request import (
    JobState as JobState,
    StrokeRequest as StrokeRequest,
    build_request as build_request,
    end_posture_of as end_posture_of,
    strokes_of as strokes_of,
    task_of as task_of,
    with_cuts as with_cuts,
)
from cmbot.planning.result.baseline import joined_samples as joined_samples
from cmbot.planning.result.judgement import (
    baseline_faults as baseline_faults,
    bound_use as bound_use,
    during as during,
    hold_use as hold_use,
    tightest_check as tightest_check,
)
from cmbot.planning.result.notes import notes as notes
from cmbot.planning.result.plan import (
    Plan as Plan,
    Seconds as Seconds,
    require_plan as require_plan,
    work_of as work_of,
)
from cmbot.planning.result.rows import (
    LOAD_HEADINGS as LOAD_HEADINGS,
    about_point as about_point,
    load_point as load_point,
    load_rows as load_rows,
    loads as loads,
    plan_rows as plan_rows,
)
from cmbot.planning.result.stroke_plan import (
    ObjectiveMetrics as ObjectiveMetrics,
    Start as Start,
    StrokeBaseline as StrokeBaseline,
    StrokePlan as StrokePlan,
    baseline_task as baseline_task,
    objective_metrics as objective_metrics,
)
from cmbot.planning.result.words import (
    first_remarks as first_remarks,
    left_out as left_out,
    promised as promised,
    promises as promises,
    remarks as remarks,
    sentence as sentence,
    verdict as verdict,
)
from cmbot.planning.selfmotion.followed_bound import quick_bound as quick_bound
from cmbot.planning.selfmotion.global_search import GlobalSearch as GlobalSearch
from cmbot.planning.selfmotion.lower_bound import LowerBound as LowerBound
from cmbot.planning.selfmotion.proof import TorqueFloorProof as TorqueFloorProof
from cmbot.planning.task import ToolTask as ToolTask
from cmbot.planning.workcell.diagnosis import (
    FEET as FEET,
    most_often_near as most_often_near,
    weakest_joint as weakest_joint,
)
from cmbot.planning.workcell.objectives import (
    Objective as Objective,
    PostureObjective as PostureObjective,
    WeightedMoment as WeightedMoment,
    WrenchFunction as WrenchFunction,
    WrenchObjective as WrenchObjective,
    objective_of as objective_of,
)
from cmbot.planning.workcell.units import in_radians as in_radians, unit_findings as unit_findings
from cmbot.planning.workcell.workcell import (
    Workcell as Workcell,
    bending_arm as bending_arm,
    covariance_of as covariance_of,
    held_guardrail as held_guardrail,
    held_point as held_point,
    modelled_stiffness as modelled_stiffness,
    resolved_options as resolved_options,
    rigid_parts_remark as rigid_parts_remark,
    robot_of as robot_of,
    sag_of as sag_of,
    tube_warning as tube_warning,
)
from cmbot.trajectory import QuinticTrajectory as QuinticTrajectory, SplineSpace as SplineSpace
