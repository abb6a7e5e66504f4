"""The method: path, via-points, trajectory, certificate, plan."""

from cmbot.planning.approach import Approach, certify_approach
from cmbot.planning.certificate import Certificate, Check
from cmbot.planning.examination import Examination, examine_options, examine_scene
from cmbot.planning.figures import LimitUse, MotionFigures, Samples
from cmbot.planning.floor import Floor
from cmbot.planning.global_stage import GlobalSolution, GlobalStage
from cmbot.planning.gradient_projection import JointPath
from cmbot.planning.objective_figures import ObjectiveFigures
from cmbot.planning.objectives import Objective, PostureFunction, PostureObjective, WrenchObjective
from cmbot.planning.optimiser import PassReport
from cmbot.planning.plan import Plan, Seconds, Start, require_plan
from cmbot.planning.planner import plan
from cmbot.planning.progress import Progress
from cmbot.planning.remarks import remarks
from cmbot.planning.setting import bending_arm, robot_of, sag_of, task_of
from cmbot.planning.spline_space import SplineSpace
from cmbot.planning.task import ToolTask
from cmbot.planning.trajectory import QuinticTrajectory
from cmbot.planning.wrench_functions import WeightedMoment, WrenchFunction

__all__ = [
    "Approach",
    "Certificate",
    "Check",
    "Examination",
    "Floor",
    "GlobalSolution",
    "GlobalStage",
    "JointPath",
    "LimitUse",
    "MotionFigures",
    "Objective",
    "ObjectiveFigures",
    "PassReport",
    "Plan",
    "PostureFunction",
    "PostureObjective",
    "Progress",
    "QuinticTrajectory",
    "Samples",
    "Seconds",
    "SplineSpace",
    "Start",
    "ToolTask",
    "WeightedMoment",
    "WrenchFunction",
    "WrenchObjective",
    "bending_arm",
    "certify_approach",
    "examine_options",
    "examine_scene",
    "plan",
    "remarks",
    "require_plan",
    "robot_of",
    "sag_of",
    "task_of",
]
