"""Closed forms: one rule a file, and what they share."""
