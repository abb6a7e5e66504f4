"""The process of one task: ``python -m cmbot.campaigns TASK ANSWER``."""

import sys

from cmbot.campaigns.child import answer_task

answer_task(*sys.argv[1:])
