"""Piecewise quintic splines: nothing of robots."""
