"""`rasterize`, `DepthPeeler` and `interpolate` of `mipbake.raster`, with nvdiffrast's contexts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mipbake import raster
from mipbake.base.errors import UsageError
from mipbake.nvdiffrast.contexts import RasterizeCudaContext, RasterizeGLContext

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = ["DepthPeeler", "interpolate", "rasterize"]


def rasterize(
    glctx: RasterizeCudaContext,
    pos: Array,
    tri: Array,
    resolution: Sequence[int],
    ranges: Array | None = None,
    grad_db: bool = True,
) -> tuple[Array, Array]:
    """`mipbake.raster.rasterize` on the device of a context.

    Args:
        glctx: a RasterizeCudaContext or a RasterizeGLContext. Of its settings, `output_db` alone changes a result.
        pos, tri, resolution, ranges, grad_db: as for `mipbake.raster.rasterize`; pos and tri on the device of glctx.
            NumPy arrays count as on the processor. The resolution may also be an array or a tensor of two integers.

    Returns:
        The two results of `mipbake.raster.rasterize`, contiguous and on the device of pos; the second is empty,
        (B, H, W, 0), where glctx was made with output_db=False.

    Gradients flow as in `mipbake.raster.rasterize`.

    Raises:
        UsageError: glctx is no context, or not set in manual mode; pos is on another device; or as
            `mipbake.raster.rasterize` raises it.
    """
    _check(glctx, pos)
    derivatives = _outputs_derivatives(glctx)
    sides = _sides(resolution)
    rast, rast_db = raster.rasterize(glctx.scratch, pos, tri, sides, ranges, grad_db and derivatives)
    return rast, rast_db if derivatives else rast_db[..., :0]


class DepthPeeler(raster.DepthPeeler):
    """`mipbake.raster.DepthPeeler` on the device of a context: layers of a scene, each behind the one before.

        with DepthPeeler(glctx, pos, tri, resolution) as peeler:
            for _ in range(layers):
                rast, rast_db = peeler.rasterize_next_layer()

    The arguments are the same as in `rasterize`, in the same order. glctx and the device of pos are checked at once and
    at each layer, the rest when the first layer is rasterised. Tensors must not be changed in place before the last
    layer. The context stays free for other calls in the meantime.

    Raises:
        UsageError: as `rasterize` raises it.
    """

    def __init__(
        self,
        glctx: RasterizeCudaContext,
        pos: Any,
        tri: Any,
        resolution: Any,
        ranges: Any = None,
        grad_db: bool = True,
    ) -> None:
        _check(glctx, pos)
        self._glctx, self._pos = glctx, pos
        sides = _sides(resolution)
        super().__init__(glctx.scratch, pos, tri, sides, ranges, grad_db and _outputs_derivatives(glctx))

    def rasterize_next_layer(self) -> tuple[Any, Any]:
        """The same two results as `rasterize`, of what is strictly behind the layer before.

        Layers, depths and gradients are as `mipbake.raster.DepthPeeler.rasterize_next_layer` has them.

        Raises:
            UsageError: as `rasterize` raises it, or the call is outside of a `with` statement.
        """
        _check(self._glctx, self._pos)
        rast, rast_db = super().rasterize_next_layer()
        return rast, rast_db if _outputs_derivatives(self._glctx) else rast_db[..., :0]


def interpolate(
    attr: Array,
    rast: Array,
    tri: Array,
    rast_db: Array | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[Array, Array]:
    """`mipbake.raster.interpolate`, also after a context that was made with output_db=False.

    Args:
        attr, rast, tri, diff_attrs: as for `mipbake.raster.interpolate`.
        rast_db: the second result of `rasterize`. It may have 0 channels where diff_attrs is None.

    Returns:
        The two results of `mipbake.raster.interpolate`, contiguous and on the device of attr.

    Gradients flow as in `mipbake.raster.interpolate`.

    Raises:
        UsageError: rast_db has 0 channels and diff_attrs wants derivatives, or as `mipbake.raster.interpolate` raises
            it.
    """
    if rast_db is not None and getattr(rast_db, "shape", ())[-1:] == (0,):
        if diff_attrs is not None:
            raise UsageError(
                f"rast_db has shape {tuple(rast_db.shape)} and diff_attrs is {diff_attrs!r}: expected (batch, height, "
                "width, 4), which a context with output_db=False does not give"
            )
        rast_db = None
    return raster.interpolate(attr, rast, tri, rast_db, diff_attrs)


def _sides(resolution: Any) -> Any:
    """The sides in an array or a tensor, which nvdiffrast takes as well; what is neither is left as it is."""
    return tuple(resolution) if len(getattr(resolution, "shape", ())) == 1 else resolution


def _check(glctx: Any, pos: Any) -> None:
    """UsageError unless glctx is a context that may be used here, on the device of pos."""
    if not isinstance(glctx, RasterizeCudaContext):
        raise UsageError(f"glctx is a {type(glctx).__name__}: expected a RasterizeCudaContext or a RasterizeGLContext")
    if isinstance(glctx, RasterizeGLContext):
        glctx.check_set()
    if isinstance(pos, np.ndarray):
        where, here = "cpu", glctx.device.type == "cpu"
    else:  # what has no device is no tensor, and refused with the other arguments
        device = getattr(pos, "device", glctx.device)
        where, here = str(device), device == glctx.device
    if not here:
        raise UsageError(
            f"pos is on {where}: expected {glctx.device}, where glctx is; "
            f"{type(glctx).__name__}(device='{where}') makes a context there"
        )


def _outputs_derivatives(glctx: RasterizeCudaContext) -> bool:
    return not isinstance(glctx, RasterizeGLContext) or glctx.output_db
