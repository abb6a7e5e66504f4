"""Timing: the shortest time laws along joint paths within the limits (`seconds: auto`)."""
