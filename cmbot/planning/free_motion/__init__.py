"""Free motion: postures between which the arm moves with the tool off, where the base bears least."""
