"""Texture lookups on NumPy arrays, which need no torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.aligned import contiguous
from mipbake.base.errors import UsageError
from mipbake.sampling._arguments import (
    TextureMip,
    check_max_mip_level,
    check_texture,
    level_sizes,
    plan_texture,
)

__all__ = ["texture", "texture_construct_mip"]

_DTYPES = (np.dtype(np.float32), np.dtype(np.float64), np.dtype(np.float16))


def texture(
    tex: NDArray[Any],
    uv: ArrayLike,
    uv_da: ArrayLike | None = None,
    mip_level_bias: ArrayLike | None = None,
    mip: TextureMip | Sequence[NDArray[Any]] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str | Sequence[str] = "wrap",
    max_mip_level: int | None = None,
) -> NDArray[Any]:
    """`mipbake.sampling.texture` on NumPy arrays."""
    from mipbake import _native

    _check_storage(tex)
    dtype = np.dtype(np.float32) if tex.dtype == np.float16 else tex.dtype
    coordinates = _reals("uv", uv, dtype)
    derivatives = None if uv_da is None else _reals("uv_da", uv_da, dtype)
    bias = None if mip_level_bias is None else _reals("mip_level_bias", mip_level_bias, dtype)
    plan = plan_texture(
        tex.shape,
        coordinates.shape,
        None if derivatives is None else derivatives.shape,
        None if bias is None else bias.shape,
        _checked_mip(mip, tex),
        filter_mode,
        boundary_mode,
        max_mip_level,
    )
    out = np.empty(plan.shape, dtype)
    if out.size == 0:
        return out
    levels = [tex]
    if plan.levels > 1:
        if mip is None:
            levels += _built(tex, plan.levels - 1)
        else:
            levels += list(mip.levels if isinstance(mip, TextureMip) else mip)[: plan.levels - 1]
    chooses_level = plan.filter not in ("nearest", "linear")
    B, h, w, C = plan.shape
    if bias is not None and bias.shape[1:] != (1, 1):
        bias = contiguous(np.broadcast_to(bias, (bias.shape[0], h, w)))
    _native.texture(
        [_readable(level) for level in levels],
        coordinates.reshape(-1, h * w, coordinates.shape[-1]),
        derivatives.reshape(-1, h * w, derivatives.shape[-1]) if chooses_level and derivatives is not None else None,
        bias.reshape(bias.shape[0], -1) if chooses_level and bias is not None else None,
        plan.filter,
        *plan.boundary,
        out.reshape(B, h * w, C),
    )
    return out


def texture_construct_mip(tex: NDArray[Any], max_mip_level: int | None = None, cube_mode: bool = False) -> TextureMip:
    """`mipbake.sampling.texture_construct_mip` of a NumPy array."""
    _check_storage(tex)
    check_texture("tex", tex.shape, cube_mode, "cube_mode to True")
    check_max_mip_level(max_mip_level)
    count = len(level_sizes(tex.shape[-3], tex.shape[-2], max_mip_level)) - 1
    return TextureMip(tex.shape, tuple(_built(tex, count)))


def _check_storage(tex: NDArray[Any]) -> None:
    if tex.dtype not in _DTYPES:
        raise UsageError(f"tex is {tex.dtype}: expected float32, float64 or float16")


def _reals(name: str, values: ArrayLike, dtype: np.dtype[Any]) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except ValueError as error:  # nested sequences of different lengths
        raise UsageError(f"{name} is not an array of numbers: {error}") from None
    except RuntimeError:  # a torch tensor that requires a gradient
        raise UsageError(f"{name} is a {type(values).__name__}: expected a NumPy array, as tex is") from None
    if array.dtype.kind not in "fiu":
        raise UsageError(f"{name} is {array.dtype}: expected real numbers")
    with np.errstate(over="ignore"):  # a float64 coordinate beyond float32 becomes infinite, which is documented
        return contiguous(array, dtype)


def _checked_mip(mip: Any, tex: NDArray[Any]) -> TextureMip | list[tuple[int, ...]] | None:
    if mip is None:
        return None
    if not isinstance(mip, TextureMip) and (isinstance(mip, str) or not isinstance(mip, Sequence)):
        raise UsageError(
            f"mip is a {type(mip).__name__}: expected what texture_construct_mip returns, or a list of arrays"
        )
    levels = mip.levels if isinstance(mip, TextureMip) else mip
    for index, level in enumerate(levels):
        if not isinstance(level, np.ndarray):
            raise UsageError(f"mip[{index}] is a {type(level).__name__}: expected a NumPy array, as tex is")
        if level.dtype != tex.dtype:
            raise UsageError(f"mip[{index}] is {level.dtype}: expected {tex.dtype}, as tex is")
    return mip if isinstance(mip, TextureMip) else [level.shape for level in levels]


def _built(tex: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """The first `count` levels after `tex`, each from the one before."""
    from mipbake import _native

    levels = [contiguous(tex)] if count else []
    for height, width in level_sizes(tex.shape[-3], tex.shape[-2], count)[1:]:
        level = np.empty((*tex.shape[:-3], height, width, tex.shape[-1]), tex.dtype)
        finer = levels[-1]
        _native.texture_mip(finer.reshape(-1, *finer.shape[-3:]), level.reshape(-1, *level.shape[-3:]))
        levels.append(level)
    return levels[1:]


def _readable(level: NDArray[Any]) -> NDArray[Any]:
    """The level itself, or a copy where its channels do not lie side by side."""
    whole = all(stride % level.itemsize == 0 for stride in level.strides)
    side_by_side = level.strides[-1] == level.itemsize or level.shape[-1] == 1
    return level if whole and side_by_side and level.flags.aligned else contiguous(level)
