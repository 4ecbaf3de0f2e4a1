"""Pages that show what was measured. `viewer` is the interactive view of stacks."""
