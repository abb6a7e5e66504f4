"""Names of the files that cmbot writes into a plan directory: all others there are not the plan's."""

from __future__ import annotations

from pathlib import Path

__all__ = [
    "EARLIER_FILES",
    "EARLIER_FORMAT",
    "FORMAT",
    "JOB_FILES",
    "OWN_FILES",
    "PLAN_FILE",
    "SAVED_FILES",
    "SHOWN_FILES",
    "TOUR_FILE",
    "TRACKING_FILES",
    "WALK_FILE",
    "is_own",
]

FORMAT, EARLIER_FORMAT = "cmbot-plan/2", "cmbot-plan/1"
PLAN_FILE = "plan.json"
WALK_FILE, TOUR_FILE = "walk.json", "tour.json"
"""In the folders of a walk and of a tour, which are no plan directories."""
SAVED_FILES = ("trajectory.csv", "baseline.csv", "trajectory.npz", "trajectory.ros.json")
"""The files beside `PLAN_FILE` of every plan, with `JOB_FILES`."""
JOB_FILES = ("job.csv", "job.npz", "job.ros.json")
"""The whole job on one clock."""
EARLIER_FILES = ("approach.csv", "approach.npz", "approach.ros.json")
"""Those that plans of `EARLIER_FORMAT` have in place of `JOB_FILES`, where they have an approach."""
TRACKING_FILES = ("tracking.csv", "tracking_baseline.csv", "tracking.json")
"""Those of a plan that has been simulated: the tables of both motions, and the metrics."""

_PLOTS = (
    *("guardrail_torque", "joints", "clearance", "tool_deviation"),
    *("tracking_error", "tracking_dynamic", "tracking_residual"),
)
SHOWN_FILES = (
    "replay.html",
    "report.html",
    *(f"{plot}.{kind}" for plot in _PLOTS for kind in ("png", "svg")),
)
"""Pages and plots."""
OWN_FILES = frozenset({PLAN_FILE, *SAVED_FILES, *JOB_FILES, *EARLIER_FILES, *TRACKING_FILES, *SHOWN_FILES})
"""All files that belong to a plan: only these are ever replaced or deleted."""


def is_own(path: Path) -> bool:
    """Whether something in a plan directory is one of `OWN_FILES`; a folder never is."""
    return path.name in OWN_FILES and (path.is_symlink() or not path.is_dir())
