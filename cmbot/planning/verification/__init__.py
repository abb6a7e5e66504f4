"""Second opinion: what a file says, computed again by code of its own."""
