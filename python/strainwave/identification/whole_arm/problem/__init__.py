"""The least-squares problem: unknowns, starting values, prior and objective."""
