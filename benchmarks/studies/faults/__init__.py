"""Faults of the input: how often the check and the stages name them."""
