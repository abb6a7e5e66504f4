"""What a motion that was planned elsewhere does to the base, judged as a plan is."""

from cmbot.evaluation.evaluation import (
    Evaluation as Evaluation,
    evaluate as evaluate,
    evaluation_json as evaluation_json,
)
from cmbot.evaluation.motion import JointMotion as JointMotion
from cmbot.evaluation.motion_file import read_motion as read_motion
