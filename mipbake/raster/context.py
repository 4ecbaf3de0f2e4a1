"""What a user keeps between calls of the raster primitives: scratch memory, and a topology."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from typing import Any

__all__ = ["RasterizeContext", "Topology"]


class RasterizeContext:
    """Scratch memory of `rasterize` that is kept between calls. With None in its place each call allocates its own.

    No result depends on the context. Several threads may use it at once: a call that finds it busy takes memory of its
    own, and never waits. On the CPU it grows to what the largest call needed: 12 bytes for each triangle, and 8 more
    for each tile of 64 x 64 pixels that the triangle touches. The memory is given back when the context is collected.
    With CUDA it is not used, because scratch comes from torch's caching allocator. A copy, or a context that arrives in
    another process, has scratch of its own.
    """

    __slots__ = ("__weakref__", "handle")

    handle: int
    """The number by which the native core knows the scratch memory."""

    def __init__(self) -> None:
        from mipbake import _native

        self.handle = _native.raster_scratch()
        weakref.finalize(self, _native.raster_scratch_free, self.handle)

    def __reduce__(self) -> tuple[type[RasterizeContext], tuple[()]]:
        return RasterizeContext, ()


@dataclass(frozen=True, eq=False, repr=False)
class Topology:
    """Which triangle edges lie on the same two vertices; opaque, see `antialias_construct_topology_hash`."""

    next: Any
    """(T, 3) int32: for edge e of triangle t, 3 t' + e' of the next one on the same two vertices, in a cycle."""
