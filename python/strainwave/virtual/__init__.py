"""The built-in arm and virtual experiments: studies and logs with known true values."""
