"""Names of the files that cmbot writes into its folders."""

from __future__ import annotations

PLAN_FILE, WALK_FILE, TOUR_FILE, STANCES_FILE = "plan.json", "walk.json", "tour.json", "stances.json"
EVALUATION_FILE = "evaluation.json"
FORMATS = {
    PLAN_FILE: "cmbot-plan/2",
    WALK_FILE: "cmbot-walk/1",
    TOUR_FILE: "cmbot-tour/1",
    STANCES_FILE: "cmbot-stances/1",
    EVALUATION_FILE: "cmbot-evaluation/1",
}
"""The records of folders, which name all other files there, and their formats."""
JOB_FILES = ("job.csv", "job.npz")
"""The whole job on one clock."""
BASELINE_FILE = "baseline.csv"
"""The baseline's work, where one is asked for."""
PLAN_FILES = (*JOB_FILES, BASELINE_FILE)
"""What a plan is read from, beside its record."""
TRACKING_FILES = ("tracking.csv", "tracking_baseline.csv", "tracking.json")
"""Those of a plan that has been simulated: the tables of both motions, and the metrics."""
EXCITATION_FILE = "excitation.json"
"""That of a plan that has been shaken."""

_PLOT_FILES = (
    *("guardrail_torque", "joints", "clearance", "tool_deviation"),
    *("tracking_error", "tracking_dynamic", "tracking_residual"),
)
SHOWN_FILES = (
    "replay.html",
    "report.html",
    "excitation.html",
    *(f"{plot}.{kind}" for plot in _PLOT_FILES for kind in ("png", "svg")),
)
"""Pages and plots."""
OWN_FILES = frozenset({PLAN_FILE, *PLAN_FILES, *TRACKING_FILES, EXCITATION_FILE, *SHOWN_FILES})
"""All files that belong to a plan."""
