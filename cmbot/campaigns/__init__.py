"""Many scenes planned on several processes: resumable; one that crashes or hangs affects no other.

What reads and plans scenes is imported when it is first used: the processes of tasks may not need it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.campaigns.runner import run_tasks
from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.campaigns.campaign_file import CampaignFile, Entry, read_campaign
    from cmbot.campaigns.run import OVERVIEW, RESULTS, Campaign, CampaignProgress, campaign

__getattr__ = on_first_use(__name__)
