"""A built-in arm and virtual experiments: studies and logs whose truth is known."""
