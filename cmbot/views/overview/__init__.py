"""Overview pages: stances, tours and walks along the guardrail on one map, and the shipped scenes."""
