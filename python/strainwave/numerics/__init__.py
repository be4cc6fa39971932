"""Numerical tools that know nothing of arms: filters, linear algebra, least squares, threads."""
