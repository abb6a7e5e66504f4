"""Semi-infinite min-max programs over splines."""
