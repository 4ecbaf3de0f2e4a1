"""Stacks in glTF documents and GLB files, written and read back."""
