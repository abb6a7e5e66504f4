"""The joint path: tool task and gradient projection (Chang 2021, Section 3.1)."""
