"""Metrics, baseline and certificate."""
