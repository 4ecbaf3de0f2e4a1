"""Texture-space renders: the supersampled, pixel-filtered reference and the once-per-pixel candidate."""

from mipbake.render.texture_space import candidate, random_points, reference

__all__ = ["candidate", "random_points", "reference"]
