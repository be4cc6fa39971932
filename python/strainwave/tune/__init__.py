"""Servos for an identified arm: gains, filters, shapers, observers, feed-forward, verification."""
