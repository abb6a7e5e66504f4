"""What a motion that was planned elsewhere does to the base, judged as a plan is."""

from cmbot.evaluation.evaluation import Evaluation, evaluate, evaluation_json
from cmbot.evaluation.motion import JointMotion
from cmbot.evaluation.motion_file import read_motion

__all__ = ["Evaluation", "JointMotion", "evaluate", "evaluation_json", "read_motion"]
