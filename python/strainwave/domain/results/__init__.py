"""Records that stages hand on, to the verdict."""
