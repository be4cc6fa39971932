"""Many studies and many results: campaigns, comparisons of results, trends."""
