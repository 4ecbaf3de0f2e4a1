"""Texture lookups at (u, v, level of detail), as a GPU filters: bilinear in a level, linear between levels.

`sample` here works on NumPy arrays; `mipbake.sampling.ops.sample` is its differentiable torch counterpart and
`mipbake.sampling.reference.sample` the plain torch twin that both are tested against.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.errors import UsageError
from mipbake.sampling._arguments import check_level_count, result_shape, wraps

__all__ = ["sample"]

_DTYPES = (np.dtype(np.float32), np.dtype(np.float64))


def sample(
    levels: Sequence[NDArray[Any]], uv: ArrayLike, lod: ArrayLike, wrap: Sequence[str] = ("wrap", "wrap")
) -> NDArray[Any]:
    """Trilinear lookups in a MIP stack; bilinear where it has one level or `lod` is an integer.

    Texel (i, j) of a level is centred at u = (j + 1/2) / W, v = (i + 1/2) / H. A lookup at a texel centre returns that
    texel and equal texels return their value, both bit for bit; for that, a coordinate within its own rounding error of
    a centre counts as the centre. Each level is addressed by the same u and v, whatever its size.

    Args:
        levels: 1 to 32 arrays (H_L, W_L, C) or (B, H_L, W_L, C), the finest first, all float32 or all float64. Sizes
            are free. Views are read in place, without a copy, where the channels of a texel lie side by side.
        uv: (P, 2) or (B, P, 2), any real numbers, in units of the texture, v down; converted to the levels' dtype.
        lod: scalar, (P,) or (B, P), 0 the finest level; clamped to [0, len(levels) - 1]; converted likewise.
        wrap: for u and v, "wrap" (the texture repeats, on negative and large coordinates too) or "clamp" (to the centre
            of the edge texel). An infinite coordinate clamps to the edge.

    A batch axis of size 1, or none, repeats for every item of the others.

    Returns:
        (P, C), or (B, P, C) where any argument has a batch axis, in the dtype of the levels. NaN where u, v or lod is
        NaN, or infinite on an axis that wraps.

    Raises:
        UsageError: an argument whose type, dtype or shape does not fit, by name.
    """
    from mipbake import _native

    arrays = _levels(levels)
    dtype = arrays[0].dtype
    coordinates, detail = _reals("uv", uv, dtype), _reals("lod", lod, dtype)
    wrap_u, wrap_v = wraps(wrap)
    shape = result_shape([level.shape for level in arrays], coordinates.shape, detail.shape)
    out = np.empty((1, *shape)[-3:], dtype)
    if out.size == 0:
        return out.reshape(shape)
    _native.sample(
        [_readable(level[None] if level.ndim == 3 else level) for level in arrays],
        coordinates[None] if coordinates.ndim == 2 else coordinates,
        detail.reshape((1, 1, *detail.shape)[-2:]),
        wrap_u,
        wrap_v,
        out,
    )
    return out.reshape(shape)


def _levels(levels: Sequence[NDArray[Any]]) -> list[NDArray[Any]]:
    if isinstance(levels, np.ndarray) or not isinstance(levels, Sequence):
        raise UsageError(f"levels is a {type(levels).__name__}: expected a list of arrays, the finest level first")
    check_level_count(len(levels))
    arrays = [np.asarray(level) for level in levels]
    for index, level in enumerate(arrays):
        if level.dtype not in _DTYPES or level.dtype != arrays[0].dtype:
            raise UsageError(
                f"levels[{index}] is {level.dtype}: expected float32 or float64, "
                f"the same as levels[0] ({arrays[0].dtype})"
            )
    return arrays


def _reals(name: str, values: ArrayLike, dtype: np.dtype[Any]) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError as error:  # nested sequences of different lengths
        raise UsageError(f"{name} is not an array of numbers: {error}") from None
    if array.dtype.kind not in "fiu":
        raise UsageError(f"{name} is {array.dtype}: expected real numbers")
    with np.errstate(over="ignore"):  # a float64 coordinate beyond float32 becomes infinite, which is documented
        return np.asarray(array, dtype, order="C")


def _readable(level: NDArray[Any]) -> NDArray[Any]:
    """The level itself, or a copy where its channels do not lie side by side."""
    whole = all(stride % level.itemsize == 0 for stride in level.strides)
    side_by_side = level.strides[-1] == level.itemsize or level.shape[-1] == 1
    return level if whole and side_by_side and level.flags.aligned else np.ascontiguousarray(level)
