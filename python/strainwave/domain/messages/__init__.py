"""Texts of warnings and faults, and the numbers in them."""
