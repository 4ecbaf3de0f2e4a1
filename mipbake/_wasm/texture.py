"""Texture lookups in the core as WebAssembly."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake._wasm.given import checked, filled, indices, number_of, real_dtype
from mipbake._wasm.machine import Out, Strided, run

_FILTERS = ["nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "anisotropic"]
_BOUNDARIES = ["wrap", "clamp", "mirror", "zero", "cube"]
_STORED = ["float32", "float64", "float16"]
_MOST_LEVELS = 32


def texture(
    levels: Sequence[Any],
    uv: Any,
    uv_da: Any,
    bias: Any,
    filter: str,
    boundary_u: str,
    boundary_v: str,
    out: Any,
    stream: int = 0,
) -> None:
    del stream
    kind, (B, P, C) = real_dtype(out), np.shape(out)
    words = _lookups(levels, uv, uv_da, bias, (filter, boundary_u, boundary_v), kind, (B, P, C))
    run("texture", words, filled("out", out, kind, (B, P, C)))


def texture_backward(
    grad: Any,
    levels: Sequence[Any],
    uv: Any,
    uv_da: Any,
    bias: Any,
    filter: str,
    boundary_u: str,
    boundary_v: str,
    level_grads: Sequence[Any],
    uv_grad: Any,
    uv_da_grad: Any,
    bias_grad: Any,
    stream: int = 0,
) -> None:
    del stream
    kind, (B, P, C) = real_dtype(grad), np.shape(grad)
    words = _lookups(levels, uv, uv_da, bias, (filter, boundary_u, boundary_v), kind, (B, P, C))
    if len(level_grads) not in (0, len(levels)):
        raise ValueError("a gradient per level")
    by_level = [
        (filled("a gradient of a level", each, kind, (len(each), *np.shape(level)[1:])), len(each))
        for each, level in zip(level_grads, levels, strict=False)
    ]
    axes = 3 if boundary_u == "cube" else 2
    run(
        "texture_backward",
        [words, checked("grad", grad, kind, (B, P, C)), by_level or [0, 0] * len(levels)],
        [filled("uv_grad", uv_grad, kind, (B, P, axes)), filled("uv_da_grad", uv_da_grad, kind, (B, P, 2 * axes))],
        filled("bias_grad", bias_grad, kind, (B, P)),
    )


def _lookups(
    levels: Sequence[Any],
    uv: Any,
    uv_da: Any,
    bias: Any,
    modes: tuple[str, str, str],
    kind: np.dtype[Any],
    shape: tuple[int, ...],
) -> list[Any]:
    """Words of TextureArgs. `modes`: of the filter and the axes."""
    B, P, C = shape
    filter_mode, *boundaries = modes
    cube = boundaries[0] == "cube"
    derived = uv_da is not None and not cube
    if cube != (boundaries[1] == "cube") or (filter_mode == "anisotropic" and not derived):
        raise ValueError("these modes and derivatives do not go together")
    texels = [_texels(level) for level in levels]
    if not 1 <= len(texels) <= _MOST_LEVELS or (texels[0].dtype == np.float64) != (kind == np.float64):
        raise ValueError("expected 1 to 32 levels, in float64 where the result is and nowhere else")
    words: list[Any] = [kind == np.float64, len(texels), C]
    words += [number_of("dtype", texels[0].dtype.name, _STORED), number_of("filter", filter_mode, _FILTERS)]
    words += [number_of("boundary", mode, _BOUNDARIES) for mode in boundaries]
    for each in texels:
        level = each if cube else each[:, None]
        height, width = level.shape[2:4]
        wanted = (_items(level, B), 6 if cube else 1, height, width, C)
        words += [height, width, Strided(checked("a level", level, texels[0].dtype, wanted), 4)]
    axes = 3 if cube else 2
    words += [B, P, _of_lookups("uv", uv, kind, (B, P, axes)), _of_lookups("uv_da", uv_da, kind, (B, P, 2 * axes))]
    return [*words, _of_lookups("bias", bias, kind, (B, P if bias is None or np.shape(bias)[1] != 1 else 1))]


def _of_lookups(name: str, value: Any, kind: np.dtype[Any], shape: tuple[int, ...]) -> Any:
    """Words of what each lookup has, or each of one item for all; of None, too."""
    if value is None:
        return [0, 0, 0]
    return Strided(checked(name, value, kind, (_items(value, shape[0]), *shape[1:])), 2)


def _texels(level: Any) -> NDArray[Any]:
    try:
        return np.asarray(level)
    except TypeError:  # NumPy lacks a dtype that torch has
        raise ValueError(f"no texels in {level.dtype} without a compiled core: take float16 or float32") from None


def texture_taps(
    height: int, width: int, uv: Any, boundary_u: str, boundary_v: str, texels: Any, fractions: Any
) -> None:
    P = len(uv)
    modes = [number_of("boundary", mode, _BOUNDARIES[:-1]) for mode in (boundary_u, boundary_v)]
    to = filled("texels", texels, np.int64, (P, 4)), filled("fractions", fractions, np.float32, (P, 2))
    run("texture_taps", [height, width, modes, P], checked("uv", uv, np.float32, (P, 2)), to)


def texture_quads(values: Any, texels: Any, fractions: Any, out: Any) -> None:
    (count, C), P = np.shape(values), len(texels)
    given = checked("values", values, np.float32, (count, C)), indices("texels", texels, np.int64, (P, 4), count)
    ways = checked("fractions", fractions, np.float32, (P, 2))
    run("texture_quads", given, ways, P, C, filled("out", out, np.float32, (P, C)))


def texture_mip(level: Any, out: Any, stream: int = 0) -> None:
    del stream
    level = np.asarray(level)
    storage, shape = number_of("dtype of texels", level.dtype.name, _STORED), level.shape
    run("texture_mip", shape, storage, level, filled("out", out, level.dtype, _coarser(shape)))


def texture_mip_backward(grad_out: Any, grad: Any, stream: int = 0) -> None:
    del stream
    kind, shape = real_dtype(grad), np.shape(grad)
    of_out = checked("grad_out", grad_out, kind, _coarser(shape))
    run("texture_mip_backward", kind == np.float64, shape, of_out, Out(np.asarray(grad), read=True))


def _coarser(shape: tuple[int, ...]) -> tuple[int, ...]:
    images, height, width, channels = shape
    return images, max(1, height // 2), max(1, width // 2), channels


def _items(array: Any, batch: int) -> int:
    """How many items an array should have of so many: 1 stands for all."""
    return 1 if len(array) == 1 else batch
