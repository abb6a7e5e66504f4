"""Attempts: what fails, what is tried instead, and how often."""
