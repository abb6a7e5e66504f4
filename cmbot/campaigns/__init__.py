"""Many scenes planned on several processes: resumable; one that crashes or hangs affects no other."""

from cmbot.campaigns.campaign_file import CampaignFile, Entry, read_campaign
from cmbot.campaigns.run import OVERVIEW, RESULTS, Campaign, CampaignProgress, campaign
from cmbot.campaigns.runner import run_tasks
from cmbot.campaigns.task import Task, TaskResult, TaskStatus

__all__ = [
    "OVERVIEW",
    "RESULTS",
    "Campaign",
    "CampaignFile",
    "CampaignProgress",
    "Entry",
    "Task",
    "TaskResult",
    "TaskStatus",
    "campaign",
    "read_campaign",
    "run_tasks",
]
