"""Clearances: the smallest distances between the arm, the obstacles and the arm itself."""
