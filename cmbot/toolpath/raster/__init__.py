"""Rasters: rows over rectangles, cylinders and faces of a mesh."""
