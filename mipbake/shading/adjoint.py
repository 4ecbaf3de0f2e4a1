"""The adjoint of shading on NumPy arrays: gradients by the material without torch, nor what its ops cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mipbake.material import model_named
from mipbake.shading import _forward
from mipbake.shading._arguments import TurnedAway, batch_shape, is_black, per_texel

__all__ = ["shade_adjoint"]

_Floats = NDArray[np.float32]


def shade_adjoint(
    model: str,
    material: _Floats,
    light: _Floats,
    view: _Floats,
    radiance: _Floats,
    *,
    turned_away: TurnedAway = "clamp",
) -> _Floats:
    """The gradient of the sum of `radiance * shade(model, material, light, view)` by the material.

    The same kernel as the gradient of `mipbake.shading.shade` of tensors, with the same limits and the same bits.

    Args:
        model: a name in `mipbake.material.MODELS`.
        material: (B, N, C) stored channels, float32, as are all arrays here.
        light: (B, K, 3) unit vectors, or (B, K, N, 3) for vectors of each texel; strides of 0 repeat. view: the same
            shape.
        radiance: (B, K, N, 3), what each colour of each render counts.

    Returns:
        (B, N, C).

    Raises:
        UsageError: an unknown model or rule, or a shape that does not fit, by name.
    """
    black = is_black(turned_away)
    batch, pairs, texels = batch_shape(model_named(model).channels, material.shape, light.shape, view.shape)
    size, each = batch or 1, texels if per_texel(light.shape, view.shape) else None
    found: _Floats = _forward.shade_backward(
        model,
        _forward.repeated(material, (size, texels, material.shape[-1])),
        _forward.expanded(light, size, each),
        _forward.expanded(view, size, each),
        np.reshape(radiance, (size, pairs, texels, 3)),
        black,
    )
    return found
