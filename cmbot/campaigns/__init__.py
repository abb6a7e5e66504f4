"""Many independent tasks on several processes: resumable, each in a process of its own."""

from cmbot.campaigns.task import Task, TaskResult, TaskStatus
from cmbot.campaigns.runner import run_tasks

__all__ = ["Task", "TaskResult", "TaskStatus", "run_tasks"]
