"""Selection of optional parameters and effects."""
