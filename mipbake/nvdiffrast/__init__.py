"""The names of nvdiffrast's documentation, for programs that were written for it: one import line changes.

    import nvdiffrast.torch as dr       becomes
    import mipbake.nvdiffrast as dr

Names, order and defaults of the arguments, shapes and meanings of results are as the documentation of nvdiffrast has
them, in its versions up to 0.3.3. The code is mipbake's own: this room renames what `mipbake.raster` and
`mipbake.sampling` do, and computes nothing. `docs/primitives.md` lists what is identical, what goes beyond nvdiffrast,
and what is not there.

Tensors lie where the program makes them, on the processor too. Wrong use raises `mipbake.base.errors.UsageError`, with
a sentence that names the argument.
"""

from __future__ import annotations

from mipbake.nvdiffrast.contexts import RasterizeCudaContext, RasterizeGLContext
from mipbake.nvdiffrast.log import get_log_level, set_log_level
from mipbake.nvdiffrast.rasterization import DepthPeeler, interpolate, rasterize
from mipbake.raster import antialias, antialias_construct_topology_hash
from mipbake.sampling import texture, texture_construct_mip

__all__ = [
    "DepthPeeler",
    "RasterizeCudaContext",
    "RasterizeGLContext",
    "antialias",
    "antialias_construct_topology_hash",
    "get_log_level",
    "interpolate",
    "rasterize",
    "set_log_level",
    "texture",
    "texture_construct_mip",
]
