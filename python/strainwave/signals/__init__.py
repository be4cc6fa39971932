"""Logs -> signals for the equations: motors, links, delays, and whether channels agree."""
