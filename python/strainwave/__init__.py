"""Identify the physical model of a robot arm with elastic joints from its logs."""
