"""Many scenes planned on several processes: resumable; one that crashes or hangs affects no other.

What reads and plans scenes is imported when it is first used: the processes of tasks may not need it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cmbot.campaigns.runner import run_tasks as run_tasks
from cmbot.campaigns.task import Task as Task, TaskResult as TaskResult, TaskStatus as TaskStatus
from cmbot.common.lazy_imports import on_first_use

if TYPE_CHECKING:
    from cmbot.campaigns.campaign_file import (
        CampaignFile as CampaignFile,
        Entry as Entry,
        read_campaign as read_campaign,
    )
    from cmbot.campaigns.run import (
        OVERVIEW as OVERVIEW,
        RESULTS as RESULTS,
        Campaign as Campaign,
        CampaignProgress as CampaignProgress,
        campaign as campaign,
    )

__getattr__ = on_first_use(__name__)
