"""Elastic simulation: the motion of the arm on a guardrail and links that bend."""

from __future__ import annotations

from cmbot.simulation.metrics import (
    ErrorMetrics as ErrorMetrics,
    Residual as Residual,
    Statistics as Statistics,
    statistics as statistics,
)
from cmbot.simulation.options import SimulationOptions as SimulationOptions
from cmbot.simulation.prescribed_work import PrescribedWork as PrescribedWork
from cmbot.simulation.summary import (
    base_movement as base_movement,
    beyond_margin as beyond_margin,
    interval_headings as interval_headings,
    interval_rows as interval_rows,
    tracking_remarks as tracking_remarks,
    tracking_rows as tracking_rows,
    tracking_summary as tracking_summary,
    tracking_verdict as tracking_verdict,
)
from cmbot.simulation.tracking import (
    MotionTracking as MotionTracking,
    StiffnessCase as StiffnessCase,
    Tracking as Tracking,
    elastic_arm_of as elastic_arm_of,
    execution_error as execution_error,
    expected_tool as expected_tool,
    motion_tracking as motion_tracking,
    simulate as simulate,
    track_work as track_work,
)
