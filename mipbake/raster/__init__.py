"""Differentiable rasterisation: which triangle each pixel shows, attributes interpolated over it, silhouettes blended.

    rast, rast_db = rasterize(ctx, pos, tri, (height, width))
    uv, uv_da = interpolate(attr, rast, tri, rast_db, diff_attrs="all")
    color = sampling.texture(tex, uv, uv_da)
    image = antialias(color, rast, pos, tri)

Every function takes torch tensors, on the CPU or with CUDA, with gradients and under torch.compile; or NumPy arrays,
forward only, and then torch is not imported. The semantics follow nvdiffrast (Laine et al., Modular Primitives
for High-Performance Differentiable Rendering, 2020); the plain torch twins are in `mipbake.raster.reference`. One
function is none of these: `splats` blends Gaussians in the plane, on the CPU alone and without gradients.

Images are (batch, height, width, channels) with OpenGL's rows, bottom up: pixel (row i, column j) is centred at
x = (2 j + 1) / W - 1, y = (2 i + 1) / H - 1 of normalised device coordinates. Nothing is kept between calls but the
scratch memory of a `RasterizeContext`, on which no result depends. Every function may be called from several threads.

Arrays need not be contiguous; what is not is copied. There are no second derivatives. On the CPU all results and
gradients are the same bits whatever the number of threads; with CUDA the sums of gradients use atomics, so their last
digits vary from run to run, and each call waits once for the device, to check the numbers in its arguments (antialias
without a topology_hash twice).
"""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from mipbake.base.arguments import REAL, checked, is_array
from mipbake.base.errors import UsageError
from mipbake.base.first_order import refuse_tangents
from mipbake.raster import _arguments, _forward
from mipbake.raster._splats import splats
from mipbake.raster.context import RasterizeContext, Topology

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = [
    "DepthPeeler",
    "RasterizeContext",
    "antialias",
    "antialias_construct_topology_hash",
    "interpolate",
    "rasterize",
    "splats",
    "triangle_indices",
]


def rasterize(
    ctx: RasterizeContext | None,
    pos: Array,
    tri: Array,
    resolution: Sequence[int],
    ranges: Array | None = None,
    grad_db: bool = True,
) -> tuple[Array, Array]:
    """The nearest triangle at each pixel's centre, with perspective-correct barycentrics and their derivatives.

    A triangle covers a pixel where its 2D homogeneous edge functions agree in sign with its determinant and
    -1 <= z/w <= 1 (Olano and Greer 1997). So triangles that reach behind the eye or out of the frustum need no
    clipping. Back faces are drawn; triangles without area are not. A centre on an edge belongs to one of the triangles
    beside the edge, so along shared edges and around shared vertices a mesh draws no pixel twice and misses none. Among
    several triangles the one with the smallest z/w wins, as z/w is rounded in the result; among equal ones the first.

    Args:
        ctx: scratch memory to reuse, or None.
        pos: clip-space positions x, y, z, w, finite. Instanced mode: (B, V, 4), an image from each item. Range mode:
            (V, 4). float32, or float64 on the CPU (coordinates beyond 1e100 or below 1e-100 leave the range there).
        tri: (T, 3) int32, the vertices of each triangle, 0 to V - 1. T is at most 2^31 / 3.
        resolution: (height, width) in pixels, each from 1 to 32768.
        ranges: in range mode (B, 2) int32 on the CPU: image b shows the ranges[b, 1] triangles of tri from
            ranges[b, 0] on; 0 triangles are allowed. Ignored in instanced mode.
        grad_db: whether gradients flow from the second result into pos; otherwise they are 0, and the backward pass is
            cheaper.

    Returns:
        Two arrays (B, H, W, 4) in the dtype of pos, zeros where no triangle is:

        - u, v, z/w, triangle_id: barycentrics in [0, 1] of the triangle's vertices 0 and 1; depth; index in tri plus 1
          (in float32 `triangle_indices` reads numbers beyond 2^24, as nvdiffrast stores them).
        - du/dX, du/dY, dv/dX, dv/dY: derivatives of u and v per pixel, X along columns and Y along rows.

    Gradients go to pos from u, v and the derivatives (section 3.3, eq. 2), for the triangle that was seen. Coverage
    itself has no gradient; `antialias` gives one. The gradient of z/w and of triangle_id is taken to be 0, so pos gets
    no gradient in z. The plain twin `mipbake.raster.reference.rasterize` agrees to rounding.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, a vertex index or a range is out of
            bounds, or a position is not finite. The message names the argument and the place.
    """
    rast, rast_db = _layer(ctx, pos, tri, resolution, ranges, grad_db)
    return rast, rast_db


def _layer(
    ctx: RasterizeContext | None, pos: Any, tri: Any, resolution: Any, ranges: Any, grad_db: bool, previous: Any = None
) -> tuple[Any, Any]:
    """`rasterize`; with `previous`, the first of its results, only what lies behind that."""
    _arguments.check_context(ctx)
    size = _arguments.size_of(resolution)
    _arguments.check_mesh(pos, tri)
    ranges = None if len(pos.shape) == 3 else _arguments.checked_ranges(ranges, pos)
    scratch = 0 if ctx is None else ctx.handle
    if is_array(pos):
        return _forward.rasterize(pos, tri, *size, ranges, previous, scratch)
    from mipbake.raster import ops

    refuse_tangents(pos=pos)
    previous = None if previous is None else previous.detach()
    rast, rast_db = ops.rasterize(pos, tri, *size, ranges, previous, scratch, grad_db)
    return rast, rast_db


def triangle_indices(rast: Array) -> Array:
    """(B, H, W) int32 indices of the triangles that pixels show, -1 where there is none.

    Args:
        rast: (B, H, W, 4), the first result of `rasterize`.

    Raises:
        UsageError: rast has no four channels of float32 or float64.
    """
    checked("rast", rast, None, REAL, (("batch", "height", "width", 4),), "the first result of rasterize")
    xp: Any = np
    ids: Any = rast[..., 3]
    if not is_array(rast):
        import torch as xp

        ids = ids.detach()
    numbers = xp.asarray(ids, dtype=xp.int32)
    if ids.dtype == xp.float32:
        numbers = xp.where(ids > _arguments.EXACT, ids.view(xp.int32) - _arguments.BITS, numbers)
    found: Array = numbers - 1
    return found


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
        _arguments.check_context(ctx)
        self._given = (ctx, pos, tri, resolution, ranges, grad_db)
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
        layer, derivatives = _layer(*self._given, self._previous)
        self._previous = layer
        return layer, derivatives


def interpolate(
    attr: Array,
    rast: Array,
    tri: Array,
    rast_db: Array | None = None,
    diff_attrs: Sequence[int] | str | None = None,
) -> tuple[Array, Array]:
    """Vertex attributes at each pixel, A = u A_0 + v A_1 + (1 - u - v) A_2 (section 3.4, eq. 3), and their derivatives.

    Args:
        attr: (V, A) for every image, or (B, V, A), where B is 1 (for every image) or the batch of rast. float32, or
            float64 on the CPU.
        rast: (B, H, W, 4), the first result of `rasterize`, in the dtype of attr.
        tri: (T, 3) int32, the vertices in attr of each triangle. It need not be the tri of `rasterize`, but must list
            the same triangles in the same order.
        rast_db: (B, H, W, 4), the second result of `rasterize`, for derivatives of attributes.
        diff_attrs: a list of attributes, 0 to A - 1, whose derivatives are wanted, or "all".

    Returns:
        - (B, H, W, A), zeros where rast is empty.
        - (B, H, W, 2 K), dA/dX, dA/dY per pixel of each of the K attributes of diff_attrs, in that order, zeros where
          rast is empty. It has 0 channels unless both rast_db and diff_attrs are given.

    Gradients go to attr, to u and v of rast (eq. 4) and to rast_db, from both results. Attributes that serve every
    image get the sum over the images.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or a vertex index or a triangle_id is
            out of bounds. The message names the argument and the place.
    """
    selected = _arguments.attributes_of(attr, rast, tri, rast_db, diff_attrs)
    given: Any = (attr, rast, tri, rast_db if selected else None, selected)
    if is_array(attr):
        out, out_da = _forward.interpolate(*given)
        return out, out_da
    from mipbake.raster import ops

    refuse_tangents(attr=attr, rast=rast, rast_db=rast_db)
    out, out_da = ops.interpolate(*given)
    return out, out_da


def antialias(
    color: Array,
    rast: Array,
    pos: Array,
    tri: Array,
    topology_hash: Topology | None = None,
    pos_gradient_boost: float = 1.0,
) -> Array:
    """Blends neighbouring pixels where a silhouette passes between their centres (section 3.6).

    Two pixels side by side, or one above the other, are blended where their triangles differ. The triangle nearer to
    the eye decides; an empty pixel is farthest, and at equal z/w the pixel that comes first in memory has the nearer
    triangle. For pixels side by side its edges count that are, in pixels, at least as close to vertical as to
    horizontal, and for pixels one above the other its other edges. In the order 0-1, 1-2, 2-0 the first silhouette
    among them that crosses the segment between the two centres is taken. Let the crossing be at d, where d is 0 at the
    first centre and 1 at the second. Then d > 1/2 adds (d - 1/2) (first - second) to the second pixel, and d < 1/2 adds
    (1/2 - d) (second - first) to the first, from the colours as they came in. What all neighbours add is summed.

    An edge is a silhouette unless another triangle of the same two vertices (the same indices in tri) lies on the other
    side of the edge, as seen from the eye. So borders and folds are silhouettes, in front of other surfaces as well as
    of nothing.

    Args:
        color: (B, H, W, C), any number of channels and any meaning; in the dtype of pos.
        rast: (B, H, W, 4), the first result of `rasterize`.
        pos: (B, V, 4) or (V, 4), the positions that `rasterize` had. float32, or float64 on the CPU.
        tri: (T, 3) int32, the triangles that `rasterize` had.
        topology_hash: what `antialias_construct_topology_hash(tri)` gave. Without it, each call finds it anew.
        pos_gradient_boost: a factor on the gradient of pos.

    Returns:
        (B, H, W, C).

    Gradients go to color, and through the crossings to x, y and w of the silhouettes' ends. A call needs scratch of two
    bytes for each triangle and image of pos (one for all images in range mode).

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, a vertex index or a triangle_id is
            out of bounds, or a position is not finite. The message names the argument and the place.
    """
    _arguments.check_antialias(color, rast, pos, tri)
    boost = _arguments.boost_of(pos_gradient_boost)
    found = _topology(tri, pos.shape[-2]) if topology_hash is None else _arguments.next_of(topology_hash, tri)
    given: Any = (color, rast, pos, tri, found, boost)
    out: Array
    if is_array(color):
        out = _forward.antialias(*given)
        return out
    from mipbake.raster import ops

    refuse_tangents(color=color, pos=pos)
    out = ops.antialias(*given)
    return out


def antialias_construct_topology_hash(tri: Array) -> Topology:
    """Which triangle edges lie on the same two vertices, for the `topology_hash` of `antialias`; opaque and unchanging.

    Args:
        tri: (T, 3) int32, vertex indices from 0 on.

    Returns:
        An object of 12 bytes a triangle, for calls with arrays of the same kind on the same device. It holds for the
        triangles as they were. With other triangles of the same number, silhouettes would be wrong without an error.
        Making it on the CPU takes scratch of 24 bytes a triangle and 4 a vertex.

    Raises:
        UsageError: tri has another type, dtype or shape, or a negative index.
    """
    _arguments.check_triangles(tri)
    return Topology(_topology(tri, -1))


def _topology(tri: Any, vertices: int) -> Any:
    if is_array(tri):
        return _forward.topology(tri, vertices)
    from mipbake.raster import ops

    return ops.topology(tri, vertices)
