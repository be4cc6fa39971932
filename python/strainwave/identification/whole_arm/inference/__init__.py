"""Covariance, intervals, residual analysis and tests of a fit."""
