"""Postures that hold the tool: projection onto the task, and samples that are admissible."""
