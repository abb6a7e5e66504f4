"""What would happen: the motion on a guardrail and links that bend."""

from __future__ import annotations

from cmbot.simulation.answer import off_path, tracking_answer, tracking_verdict
from cmbot.simulation.metrics import ErrorFigures, Residual, Statistics
from cmbot.simulation.options import SimulationOptions
from cmbot.simulation.remarks import tracking_remarks, tracking_rows
from cmbot.simulation.tracking import MotionTracking, Tracking, simulate, track

__all__ = [
    "ErrorFigures",
    "MotionTracking",
    "Residual",
    "SimulationOptions",
    "Statistics",
    "Tracking",
    "off_path",
    "simulate",
    "track",
    "tracking_answer",
    "tracking_remarks",
    "tracking_rows",
    "tracking_verdict",
]
