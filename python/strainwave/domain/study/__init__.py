"""The study: logs, channels and options."""
