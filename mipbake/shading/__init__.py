"""Shading of material texels under light-view pairs, on NumPy arrays.

`mipbake.shading.ops.shade` is the differentiable torch counterpart of `shade`, and `mipbake.shading.reference` has the
plain torch twins that all are tested against. `shade_lit`, for renders, has no gradient and so no torch op.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.aligned import contiguous
from mipbake.base.errors import UsageError
from mipbake.material import model_named
from mipbake.shading._arguments import LIT_AXES, TurnedAway, batch_shape, is_black, lit_batch, per_texel

__all__ = ["TurnedAway", "models", "shade", "shade_lit"]

_DTYPES = (np.dtype(np.float32), np.dtype(np.float64))


def models() -> Mapping[str, int]:
    """Name and number of stored channels of every material model that the kernels know."""
    from mipbake import _native

    return dict(_native.models())


def shade(
    model: str, material: ArrayLike, light: ArrayLike, view: ArrayLike, *, turned_away: TurnedAway = "clamp"
) -> NDArray[Any]:
    """Radiance towards `view` of every texel, lit by unit radiance from `light`: f(theta, l, v), the cosine included.

    f = (k albedo / pi + D V F) max(n.l, 0), and 0 where n.l <= 0 (in fact up to 1e-9), with the anisotropic GGX
    distribution D, which is 0 where n.h <= 0, height-correlated Smith masking-shadowing V, in which n.v is held to
    1e-4, and Schlick's Fresnel term F (docs/conventions.md, section 2). k is 1 for `ggx`, and 0.96 (1 - (1 - l.h)^5)
    for `gltf` and `gltf-anisotropic` (glTF 2.0, appendix B). `beckmann` is `ggx` with the generalised Beckmann
    distribution of Aittala et al. 2015 for D, and in V the masking of Beckmann (gamma = 1) whatever gamma is: an
    approximation.

    Args:
        model: a name in `mipbake.material.MODELS`.
        material: (N, C) or (B, N, C) stored channels of the model, float32 or float64, any strides. Normals and
            anisotropy directions are renormalised and glTF's roughness is raised to 0.045. So that nothing overflows,
            channels are held to +-1e4, glTF's roughness to 100 and strength to +-1, of ggx's log-roughness tensor the
            mean of the eigenvalues to [-30, 10] and their distance from it to 20, and g of beckmann to +-1.5.
        light: (K, 3) or (B, K, 3) unit vectors in tangent space, from the surface to the light; or (B, K, N, 3) for
            vectors of each texel; an axis of size 1 or stride 0 repeats. Converted to the dtype of the material.
        view: the same, from the surface to the viewer.
        turned_away: `clamp`; or `black`, with which f is 0 where n.v <= 0, and n.v is not held.

    A batch axis of size 1, or none, repeats for every item of the others.

    Returns:
        (K, N, 3), or (B, K, N, 3) where any argument has a batch axis, in the dtype of the material. Finite for finite
        input. In float32 within 1e-5 of the exact value, relatively, for alpha >= 0.002. The same bits on every
        instruction set and for any number of threads.

    Raises:
        UsageError: an unknown model or rule, or an argument whose dtype or shape does not fit, by name.
    """
    from mipbake import _native

    texels, black = _texels(material), is_black(turned_away)
    to_light, to_view = _like(texels, light=light, view=view)
    batch, K, N = batch_shape(model_named(model).channels, texels.shape, to_light.shape, to_view.shape)
    B = 1 if batch is None else batch
    out = np.empty((B, K, N, 3), texels.dtype)
    if out.size:
        of_texels = per_texel(to_light.shape, to_view.shape)
        lights, views = (_expanded(_readable(a), B, N if of_texels else None) for a in (to_light, to_view))
        repeated = _repeated(_readable(texels), (B, *texels.shape[-2:]))
        _native.shade(model, repeated, lights, views, out, black=black)
    return out[0] if batch is None else out


def shade_lit(
    model: str,
    material: ArrayLike,
    frame: ArrayLike,
    view: ArrayLike,
    light: ArrayLike,
    radiance: ArrayLike,
    *,
    turned_away: TurnedAway = "clamp",
) -> NDArray[Any]:
    """Radiance towards the viewer of points under K directional lights: the sum of radiance_k f(theta, l_k, v).

    f is the same as in `shade`. The points turn lights and viewer into their own tangent spaces, and nothing of K x N
    is ever stored. For NumPy arrays, on the CPU, without gradients.

    Any argument but the model may have a leading axis for B surfaces, each with points and lights of its own; arguments
    without it are the same for all.

    Args:
        model: a name in `mipbake.material.MODELS`.
        material: (N, C) stored channels of the model, float32 or float64, any strides; limits as in `shade`.
        frame: (N, 3, 3), of each point the axes of its tangent space as rows t, b, n: orthonormal vectors in the world.
            This and what follows may have any strides, and is converted to the dtype of the material.
        view: (N, 3) unit vectors in the world, from the point to the viewer.
        light: (K, 3) unit vectors in the world, from the surface to the light.
        radiance: (K, 3) of each light, its solid angle included: the irradiance of what faces it. Finite.
        turned_away: as in `shade`.

    Returns:
        (N, 3), or (B, N, 3), in the dtype of the material. Each point's sum runs over the lights in order, in that
        dtype; 0 where no light is. In float32 within 1e-5 of the exact value of the same arguments, relatively, for
        alpha >= 0.002 and radiance of one sign. The same bits on every instruction set and for any number of threads.

    Raises:
        UsageError: an unknown model or rule, an argument whose dtype or shape does not fit, or radiance that is not
            finite, by name.
    """
    from mipbake import _native

    texels, black = _texels(material), is_black(turned_away)
    axes, to_view, to_light, power = _like(texels, frame=frame, view=view, light=light, radiance=radiance)
    given = (texels, axes, to_view, to_light, power)
    batch = lit_batch(model_named(model).channels, *(array.shape for array in given))
    if not np.isfinite(power).all():
        raise UsageError(f"radiance holds a value that is not finite in {texels.dtype}: expected finite numbers")
    B = 1 if batch is None else batch
    texels, axes, to_view, to_light, power = (
        _repeated(_readable(array), (B, *array.shape[-axes_of:]))
        for array, axes_of in zip(given, LIT_AXES.values(), strict=True)
    )
    out = np.empty((*texels.shape[:2], 3), texels.dtype)
    if out.size:
        _native.shade_lit(model, texels, axes, to_view, contiguous(to_light), contiguous(power), out, black)
    return out[0] if batch is None else out


def _texels(material: ArrayLike) -> NDArray[Any]:
    texels = _reals("material", material)
    if texels.dtype not in _DTYPES:
        raise UsageError(f"material is {texels.dtype}: expected float32 or float64")
    return texels


def _like(texels: NDArray[Any], **arguments: ArrayLike) -> tuple[NDArray[Any], ...]:
    """The arguments in the dtype of the texels."""
    with np.errstate(over="ignore"):
        return tuple(_reals(name, a).astype(texels.dtype, copy=False) for name, a in arguments.items())


def _expanded(directions: NDArray[Any], B: int, N: int | None) -> NDArray[Any]:
    """(B, K, N, 3), or (B, K, 3) where N is None, of (K, 3), (B or 1, K, 3) or (B or 1, K, N or 1, 3)."""
    if N is None:
        shared = directions[:, :, 0] if directions.ndim == 4 else directions
        return _repeated(shared, (B, *shared.shape[-2:]))
    each = directions if directions.ndim == 4 else directions[..., None, :]
    return _repeated(each, (B, each.shape[-3], N, 3))


def _repeated(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """The array broadcast to a shape; the array itself where it has it, as most do and NumPy takes its time."""
    return array if array.shape == shape else np.broadcast_to(array, shape)


def _reals(name: str, values: ArrayLike) -> NDArray[Any]:
    try:
        array = np.asarray(values)
    except (ValueError, TypeError, RuntimeError) as error:  # sequences of different lengths, tensors of other devices
        hint = "; mipbake.shading.ops.shade takes torch tensors" if hasattr(values, "requires_grad") else ""
        raise UsageError(
            f"{name} is not an array of numbers ({str(error).partition(chr(10))[0][:120]}){hint}"
        ) from None
    if array.dtype.kind not in "fiu":
        raise UsageError(f"{name} is {array.dtype}: expected real numbers")
    return array


def _readable(array: NDArray[Any]) -> NDArray[Any]:
    """The array itself, or a copy where its elements do not lie a whole number of elements apart."""
    whole = all(stride % array.itemsize == 0 for stride in array.strides)
    return array if whole and array.flags.aligned else contiguous(array)
