"""Nonlinear programs of others: formulas, solvers, and what each of them takes."""
