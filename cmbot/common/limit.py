"""What a constraint of the optimiser, or a check of the certificate, limits."""

from __future__ import annotations

from enum import StrEnum


class Limit(StrEnum):
    """What is limited: by it remedies are chosen, never by what messages call it."""

    POSITION = "position"
    VELOCITY = "velocity"
    ACCELERATION = "acceleration"
    JERK = "jerk"
    RATES = "rates"
    """Velocity, acceleration and jerk of a joint together."""
    JOINT_TORQUE = "joint torque"
    HOLDING_TORQUE = "holding torque"
    """What a locked joint between a foot and the arm holds."""
    HOLD = "hold"
    BASE_TORQUE = "base torque"
    CLEARANCE = "clearance"
    TOOL_DEVIATION = "tool deviation"
    TOOL_ROTATION = "tool rotation"
    TOOL_TILT = "tool tilt"
    TOOL_LAG = "tool lag"
    TOOL_SPEED = "tool speed"
    PROCESS_SPEED = "process speed"
    CONTINUITY = "continuity"
    SHIFT = "shift"
    """Change of the shifted tool path from one round of the compensation of the sag to the next."""
    SWAY = "sway"
    """The tool's at work, and its swing after it."""
    PEAK = "peak"
    LEAP = "leap"
    """A step between via-points from one branch of postures to another."""
    OTHER = "other"
