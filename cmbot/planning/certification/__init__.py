"""Metrics of a motion and its certificate, for all times."""
