"""What planning results in: the plan of a job, its baseline, and both in words."""
