"""Shading and its adjoint on arrays or tensors that were checked."""

from __future__ import annotations

from typing import Any

import numpy as np

from mipbake.base.aligned import dense, strided
from mipbake.base.arguments import empty, is_array
from mipbake.base.stream import current_stream
from mipbake.shading._arguments import pair_count


def shade(model: str, material: Any, light: Any, view: Any, black: bool = False) -> Any:
    """(B, K, N, 3) radiance of (B, N, C) texels under (B, K, 3) or (B, K, N, 3) directions."""
    from mipbake import _native

    out = empty_radiance(material, light)
    if 0 not in out.shape:
        with current_stream(material, "material") as stream:
            _native.shade(model, strided(material), strided(light), strided(view), out, stream, black)
    return out


def shade_backward(model: str, material: Any, light: Any, view: Any, grad: Any, black: bool = False) -> Any:
    """(B, N, C) the gradient by the material."""
    from mipbake import _native

    out = empty(material, material.shape)
    if 0 in grad.shape:
        out[...] = 0
        return out
    with current_stream(material, "material") as stream:
        given = strided(material), strided(light), strided(view), dense(grad)
        _native.shade_backward(model, *given, out, stream, black=black)
    return out


def directions_backward(
    model: str, material: Any, light: Any, view: Any, grad: Any, black: bool = False
) -> tuple[Any, Any]:
    """The gradients by lights and views, in their shapes."""
    from mipbake import _native

    found = empty(material, grad.shape), empty(material, grad.shape)
    if 0 not in grad.shape:
        with current_stream(material, "material") as stream:
            given = strided(material), strided(light), strided(view), dense(grad)
            _native.shade_directions_backward(model, *given, *found, stream, black)
    by_light, by_view = (each.sum(2) if to.ndim == 3 else each for each, to in zip(found, (light, view), strict=True))
    return by_light, by_view


def empty_radiance(material: Any, light: Any) -> Any:
    """Where radiance is written."""
    return empty(material, (material.shape[0], light.shape[1], material.shape[1], 3))


def repeated(value: Any, shape: tuple[int, ...]) -> Any:
    """The value broadcast to a shape; itself where it has it, as most do and NumPy takes its time."""
    if tuple(value.shape) == shape:
        return value
    return np.broadcast_to(value, shape) if is_array(value) else value.expand(shape)


def expanded(directions: Any, B: int, N: int | None) -> Any:
    """(B, K, N, 3), or (B, K, 3) where N is None, of (K, 3), (B or 1, K, 3) or (B or 1, K, N or 1, 3)."""
    K = pair_count(directions.shape)
    if N is None:
        return repeated(directions[:, :, 0] if directions.ndim == 4 else directions, (B, K, 3))
    return repeated(directions if directions.ndim == 4 else directions[..., None, :], (B, K, N, 3))
