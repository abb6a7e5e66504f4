"""The way to where the work starts, the tool off."""
