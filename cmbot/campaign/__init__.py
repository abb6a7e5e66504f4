"""Many independent jobs on several processes: resumable, each in a process of its own."""

from cmbot.campaign.job import Job, JobResult, JobStatus
from cmbot.campaign.runner import run_jobs

__all__ = ["Job", "JobResult", "JobStatus", "run_jobs"]
