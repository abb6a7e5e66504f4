"""Elastic simulation: the motion of the arm on a guardrail and links that bend."""

from __future__ import annotations

from cmbot.simulation.metrics import ErrorMetrics, Residual, Statistics, statistics
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.prescribed_motion import PrescribedMotion, PrescribedWork
from cmbot.simulation.summary import (
    base_movement,
    beyond_margin,
    interval_headings,
    interval_rows,
    tracking_remarks,
    tracking_rows,
    tracking_summary,
    tracking_verdict,
)
from cmbot.simulation.tracking import (
    MotionTracking,
    StiffnessCase,
    Tracking,
    elastic_arm_of,
    execution_error,
    expected_tool,
    motion_tracking,
    simulate,
    track,
    track_work,
)
