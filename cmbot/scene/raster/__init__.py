"""Rasters: what a scene file says of them, and rows over faces of a mesh."""
