"""A servo design in the terminal and as a page."""
