"""Who computes the chunks of a sweep."""
