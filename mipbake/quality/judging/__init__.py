"""How good a stack is: measured against the filtered reference while it is made."""
