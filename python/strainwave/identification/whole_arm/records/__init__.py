"""Records prepared for the comparison with simulations."""
