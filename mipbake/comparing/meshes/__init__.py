"""Meshes, and renders and films of them."""
