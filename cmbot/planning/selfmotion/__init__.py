"""The self-motion: charts, dynamic programming over them, the lower bound."""
