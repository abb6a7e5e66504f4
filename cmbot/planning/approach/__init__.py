"""The approach to where the work starts, with the tool off."""
