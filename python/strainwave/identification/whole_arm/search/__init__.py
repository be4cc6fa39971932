"""Search for the minimum."""
