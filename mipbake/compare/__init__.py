"""Comparison of prefilters on one texture set: stacks, measures, renders, and what of it a report shows."""
