"""The process of one job: ``python -m cmbot.campaign TASK ANSWER``."""

import sys

from cmbot.campaign.child import answer_task

answer_task(*sys.argv[1:])
