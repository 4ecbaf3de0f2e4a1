"""MaterialX documents: what is in them, where the values of their shaders come from, and which maps those are."""
