"""The path of the tool: what a scene file says of it, its geometry and its timing."""
