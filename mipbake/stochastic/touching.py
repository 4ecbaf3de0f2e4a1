"""What pixels were made of: texels of a MIP stack, vertices of triangles; and the other way round."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from mipbake.base.arguments import device_of, empty, is_array
from mipbake.base.errors import UsageError
from mipbake.base.stream import current_stream
from mipbake.stochastic.elements import Contributions, given, zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

MOST_LEVELS = 32
"""Of a MIP stack, as in the native core."""

TEXELS = {"nearest": 1, "trilinear": 8, "anisotropic": 8 * 16}
"""How many texels a lookup reads at most."""

_BOUNDARIES = ("wrap", "clamp", "mirror", "zero")


def touched_texels(
    sizes: Sequence[tuple[int, int]],
    uv: Array,
    lod: Array | None = None,
    uv_da: Array | None = None,
    seen: Array | None = None,
    texels: str = "trilinear",
    boundary: tuple[str, str] = ("wrap", "wrap"),
) -> Array:
    """Which texels of a MIP stack each pixel was made of (section 4.4, textures).

    Texels are numbered level after level, finest first, and row by row. A texel that a lookup gives no weight is left
    out.

    Args:
        sizes: (height, width) of each level.
        uv: (P, 2) float32. A pixel whose uv is NaN touches nothing.
        lod: (P,) float32 level of detail; or
        uv_da: (P, 4) float32 derivatives du/dX, du/dY, dv/dX, dv/dY, which it follows from as in `sampling.texture`.
        seen: (P,) uint8, 0 where a pixel shows no texture; None: every pixel does.
        texels: "nearest", one texel of the nearest level, as in the paper; "trilinear", all texels that a trilinear
            lookup reads; "anisotropic", all that up to 16 lookups along the footprint read, for which uv_da is needed.
        boundary: the modes of u and v: "wrap", "clamp", "mirror" or "zero".

    Returns:
        (P, K) int32, -1 behind the last; K is 1, 8 or 128.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit, or a name is unknown.
    """
    from mipbake import _native

    if texels not in TEXELS:
        raise UsageError(f"texels is {texels!r}: expected {', '.join(TEXELS)}")
    if len(boundary) != 2 or any(mode not in _BOUNDARIES for mode in boundary):
        raise UsageError(f"boundary is {boundary!r}: expected two of {', '.join(_BOUNDARIES)}")
    if (lod is None) == (uv_da is None):
        raise UsageError("lod and uv_da are both given, or both missing: expected one of the two")
    if texels == "anisotropic" and uv_da is None:
        raise UsageError("uv_da is missing: expected it for anisotropic lookups, whose footprint is long")
    uv = given("uv", uv, None, ("float32",), (("P", 2),))
    like, count = ("uv", uv), uv.shape[0]
    lod = None if lod is None else given("lod", lod, like, ("float32",), ((count,),))
    uv_da = None if uv_da is None else given("uv_da", uv_da, like, ("float32",), ((count, 4),))
    seen = None if seen is None else given("seen", seen, like, ("uint8",), ((count,),))
    out: Array = empty(uv, (count, TEXELS[texels]), "int32")
    levels = [(int(height), int(width)) for height, width in sizes]
    if not 1 <= len(levels) <= MOST_LEVELS or sum(height * width for height, width in levels) >= 2**31:
        raise UsageError(
            f"sizes has {len(levels)} levels: expected 1 to {MOST_LEVELS}, with less than 2^31 texels in all"
        )
    if min(map(min, levels)) < 1:
        raise UsageError(f"sizes holds {min(levels, key=min)}: expected heights and widths of 1 or more")
    with current_stream(uv, "uv") as stream:
        _native.stochastic_touched(levels, uv, lod, uv_da, seen, texels, *boundary, out, stream)
    return out


def touched_vertices(ids: Array, triangles: Array) -> Array:
    """Which vertices each pixel was made of, by a buffer of triangles (section 4.4, opaque and transparent geometry).

    Args:
        ids: (P, K) integers: for each pixel the triangles that it shows, one for opaque surfaces, all layers in a deep
            buffer. 0 is none, and t + 1 is triangle t, as `raster.rasterize` counts.
        triangles: (T, C) int32, the 3 vertices of each triangle; or whatever it was made of, such as the control
            vertices in `Subdivision.supports`, or texels of a displacement map, -1 for none.

    Returns:
        (P, C K) int32 numbers of vertices, -1 for none.

    Raises:
        UsageError: the dtype or shape of an argument does not fit, or a triangle does not exist.
    """
    corners = given("triangles", triangles, None, ("int32",), (("T", "C"),))
    shown = given("ids", ids, ("triangles", corners), ("int32", "int64", "float32", "float64"), (("P", "K"),))
    if not bool((shown % 1 == 0).all()):
        raise UsageError("ids holds numbers that are not whole: expected 0 for none, and t + 1 for triangle t")
    numbers = shown.astype("int64") if is_array(shown) else shown.long()
    count = corners.shape[0]
    if numbers.shape[0] and numbers.shape[1] and (int(numbers.min()) < 0 or int(numbers.max()) > count):
        raise UsageError(
            f"ids reach from {int(numbers.min())} to {int(numbers.max())}: expected 0 for none, up to {count}"
        )
    with_none = zeros(corners, (count + 1, corners.shape[1]), "int32")
    with_none[0], with_none[1:] = -1, corners
    found: Array = with_none[numbers].reshape(numbers.shape[0], corners.shape[1] * numbers.shape[1])
    return found


def contributions(touched: Array) -> Contributions:
    """Turns (P, K) int32 elements of each pixel (-1 for none) round: for each element the pixels that show it.

    An element that a pixel names twice counts once: the pixel's error difference is credited to it, and not twice.

    Raises:
        UsageError: another dtype or shape.
    """
    from mipbake import _native

    named = given("touched", touched, None, ("int32",), (("P", "K"),))
    if device_of(named) == "cpu":
        import numpy as np

        tensor = None if is_array(named) else named
        named = np.asarray(named)

        counts = np.zeros(int(named.max(initial=-1)) + 1, np.int32)
        _native.stochastic_count(named, counts)
        elements = np.flatnonzero(counts)
        starts = np.concatenate([[0], np.cumsum(counts[elements])]).astype(np.int64)
        cursors = np.zeros(len(counts), np.int64)
        cursors[elements] = starts[:-1]
        pixels = np.empty(int(starts[-1]), np.int32)
        _native.stochastic_fill(named, cursors, pixels)
        found = elements.astype(np.int32), starts, pixels
        if tensor is None:
            return Contributions(*found)
        import torch

        return Contributions(*(torch.from_numpy(each) for each in found))
    import torch

    count = max(named.shape[0], 1)
    pixel = torch.arange(named.shape[0], device=named.device)[:, None].expand(named.shape)[named >= 0]
    keys = torch.unique(named[named >= 0].long() * count + pixel)
    of, shown = torch.div(keys, count, rounding_mode="floor"), torch.remainder(keys, count)
    numbers, sizes = torch.unique_consecutive(of, return_counts=True)
    begins = torch.nn.functional.pad(torch.cumsum(sizes, 0), (1, 0))
    return Contributions(numbers.int(), begins, shown.int())
