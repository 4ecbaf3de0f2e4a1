"""Renders for validation, in texture space and of meshes: the once-per-pixel candidate and its supersampled reference.

Texture space is here; `mipbake.render.mesh_render` renders meshes (`mesh`, `shapes`, `tangents`) as a `camera` sees
them under an `environment`.
"""

from mipbake.render.texture_space import LooksUp, candidate, lookup

__all__ = ["LooksUp", "candidate", "lookup"]
