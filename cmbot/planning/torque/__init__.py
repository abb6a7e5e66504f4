"""The torque problem (Chang 2021, Section 3.2)."""
