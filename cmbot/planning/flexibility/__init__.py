"""Vibration suppression and sag compensation."""
