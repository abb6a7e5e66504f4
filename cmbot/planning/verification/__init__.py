"""Metrics, certificate and second opinion."""
