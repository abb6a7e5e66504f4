"""Second opinions: physics written out by hand, sharing nothing with the package."""
