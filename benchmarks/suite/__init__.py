"""The suite that judges the planner: random scenes of many arms, an oracle of its own, what came out."""
