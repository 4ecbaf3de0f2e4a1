"""Layers of a scene, each behind the one before."""

from __future__ import annotations

from types import TracebackType
from typing import Any

from mipbake.base.errors import UsageError
from mipbake.raster._arguments import check_context
from mipbake.raster._door import door
from mipbake.raster.context import RasterizeContext

__all__ = ["DepthPeeler"]


class DepthPeeler:
    """Rasterises the layers of a scene one after the other, each behind the one before.

        with DepthPeeler(ctx, pos, tri, resolution) as peeler:
            front, front_db = peeler.rasterize_next_layer()
            second, second_db = peeler.rasterize_next_layer()

    The arguments are the same as in `rasterize`, in the same order. They are checked when the first layer is
    rasterised, and must not be changed in place before the last layer.
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

        The first layer is the result of `rasterize`. In every further layer a pixel holds the nearest point whose z/w,
        as it is stored, is greater than the z/w of the layer before. Where the layer before was empty, it is empty. So
        of several surfaces at the same depth one is seen and the others are skipped. Gradients flow through each layer
        by itself; z/w has no gradient.

        Raises:
            UsageError: as `rasterize` raises it, or the call is outside of a `with` statement.
        """
        if not self._open:
            raise UsageError("the depth peeler is not open: use it as in 'with DepthPeeler(...) as peeler:'")
        layer = door(self._arguments[1]).rasterize(*self._arguments, previous=self._previous)
        self._previous = layer[0]
        return layer[0], layer[1]
