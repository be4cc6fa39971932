"""Longer measurements than a benchmark: what a method does on many drawn arms."""
