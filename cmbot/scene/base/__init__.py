"""What the arm stands on: guardrail, stance, hold of the feet, stiffness given or identified."""
