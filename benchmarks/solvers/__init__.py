"""The same problems posed to cmbot's solvers, Ipopt and SLSQP on the literal problem."""
