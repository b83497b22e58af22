"""Studies of a case: parameter sets, tables that resume, orders of convergence, parameters fitted to curves."""
