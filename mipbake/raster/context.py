"""What a user keeps between calls of the raster primitives: scratch memory, the layers peeled so far, a topology."""

from __future__ import annotations

import weakref
from dataclasses import dataclass
from types import ModuleType, TracebackType
from typing import Any

from mipbake.errors import UsageError
from mipbake.raster._arguments import check_context

__all__ = ["DepthPeeler", "RasterizeContext", "Topology"]


class RasterizeContext:
    """Scratch memory of `rasterize` that is kept between its calls; `None` in its place allocates it for each call.

    Nothing that a call returns depends on it. It may be used by several threads at once: a call that finds it busy
    takes memory of its own, and never waits. On the CPU it grows to what the largest call needed, 12 bytes for each
    triangle and 8 more for each tile of 64 x 64 pixels that it touches, and is given back when the context is
    collected. With CUDA it is not used: scratch comes from torch's caching allocator. A copy, or a context that arrives
    in another process, has scratch of its own.
    """

    __slots__ = ("__weakref__", "handle")

    handle: int
    """By which the native core knows the scratch."""

    def __init__(self) -> None:
        from mipbake import _native

        self.handle = _native.raster_scratch()
        weakref.finalize(self, _native.raster_scratch_free, self.handle)

    def __reduce__(self) -> tuple[type[RasterizeContext], tuple[()]]:
        return RasterizeContext, ()


class DepthPeeler:
    """Rasterises the layers of a scene one after the other, each behind the one before.

        with DepthPeeler(ctx, pos, tri, resolution) as peeler:
            front, front_db = peeler.rasterize_next_layer()
            second, second_db = peeler.rasterize_next_layer()

    Args: those of `rasterize`, in the same order. They are checked when the first layer is rasterised, and must not be
    changed in place before the last.
    """

    def __init__(
        self,
        ctx: RasterizeContext | None,
        pos: Any,
        tri: Any,
        resolution: Any,
        ranges: Any = None,
        grad_db: bool = True,
    ) -> None:
        check_context(ctx, RasterizeContext)
        self._arguments = (ctx, pos, tri, resolution, ranges, grad_db)
        self._open = False
        self._previous: Any = None

    def __enter__(self) -> DepthPeeler:
        self._open, self._previous = True, None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._open, self._previous = False, None

    def rasterize_next_layer(self) -> tuple[Any, Any]:
        """The same two results as `rasterize`, of what is strictly behind the layer before.

        The first layer is that of `rasterize`. Of the next ones a pixel holds the nearest point whose z/w, as it is
        stored, is greater than that of the layer before, and is empty where that was empty: of surfaces at the same
        depth one is seen and the others are skipped. Gradients flow through each layer by itself; z/w has none.

        Raises:
            UsageError: as `rasterize`, or outside of a `with` statement.
        """
        if not self._open:
            raise UsageError("the depth peeler is not open: use it as in 'with DepthPeeler(...) as peeler:'")
        layer = door(self._arguments[1]).rasterize(*self._arguments, previous=self._previous)
        self._previous = layer[0]
        return layer[0], layer[1]


@dataclass(frozen=True, eq=False, repr=False)
class Topology:
    """Which triangle edges lie on the same two vertices; opaque, see `antialias_construct_topology_hash`."""

    next: Any
    """(T, 3) int32: for edge e of triangle t, 3 t' + e' of the next one on the same two vertices, in a cycle."""


def door(array: Any) -> ModuleType:
    """The module whose functions take what `array` is: NumPy arrays, or torch tensors."""
    import numpy as np

    if isinstance(array, np.ndarray):
        from mipbake.raster import arrays

        return arrays
    from mipbake.raster import ops

    return ops
