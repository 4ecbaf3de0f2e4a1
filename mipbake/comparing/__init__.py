"""Comparison of prefilters on one texture set: stacks, measures, renders, and what a report shows of them."""
