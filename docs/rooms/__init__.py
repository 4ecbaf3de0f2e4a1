"""Rooms: the parts of the package that may import only certain others, as docs/architecture.md lists them."""
