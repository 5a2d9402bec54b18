"""Pages of results, as HTML."""
