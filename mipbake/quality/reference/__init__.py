"""The filtered reference: what a stack is baked from, and estimates of what is right (Kemppinen et al. 2023, eq. 3)."""
