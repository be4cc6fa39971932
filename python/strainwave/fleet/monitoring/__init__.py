"""What changed: results of one arm against each other, and over the visits of its life."""
