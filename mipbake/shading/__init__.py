"""Shading of material texels under light-view pairs.

`shade` takes NumPy arrays, or torch tensors with gradients and under torch.compile. `shade_lit`, for renders, takes
arrays alone. `mipbake.shading.reference` has the plain torch twins that both are tested against.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.aligned import dense, strided
from mipbake.base.arguments import REAL, checked, dtype_of, is_array, reals
from mipbake.base.errors import UsageError
from mipbake.base.first_order import refuse_tangents
from mipbake.material import model_named
from mipbake.shading import _forward
from mipbake.shading._arguments import LIT_AXES, TurnedAway, batch_shape, is_black, lit_batch, per_texel

if TYPE_CHECKING:
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = ["TurnedAway", "models", "shade", "shade_lit"]


def models() -> Mapping[str, int]:
    """Name and number of stored channels of every material model that the kernels know."""
    from mipbake import _native

    return dict(_native.models())


def shade(model: str, material: Array, light: Any, view: Any, *, turned_away: TurnedAway = "clamp") -> Array:
    """Radiance towards `view` of every texel, lit by unit radiance from `light`: f(theta, l, v), the cosine included.

    f = (k albedo / pi + D V F) max(n.l, 0), and 0 where n.l <= 0 (in fact up to 1e-9), with the anisotropic GGX
    distribution D, which is 0 where n.h <= 0, height-correlated Smith masking-shadowing V, in which n.v is held to
    1e-4, and Schlick's Fresnel term F (docs/conventions.md). k is 1 for `ggx`, and 0.96 (1 - (1 - l.h)^5)
    for `gltf` and `gltf-anisotropic` (glTF 2.0, appendix B). `beckmann` is `ggx` with the generalised Beckmann
    distribution of Aittala et al. 2015 for D, and in V the masking of Beckmann (gamma = 1) whatever gamma is: an
    approximation.

    Args:
        model: a name in `mipbake.material.MODELS`.
        material: (N, C) or (B, N, C) stored channels of the model, float32 or float64 (CUDA: float32), any strides,
            read without a copy. Normals and anisotropy directions are renormalised and glTF's roughness is raised to
            0.045. So that nothing overflows, channels are held to +-1e4, glTF's roughness to 100 and strength to +-1,
            of ggx's log-roughness tensor the mean of the eigenvalues to [-30, 10] and their distance from it to 20, and
            g of beckmann to +-1.5.
        light: (K, 3) or (B, K, 3) unit vectors in tangent space, from the surface to the light; or (B, K, N, 3) for
            vectors of each texel; an axis of size 1 or stride 0 repeats. Converted to the dtype of the material.
            Beside arrays lists will do.
        view: the same, from the surface to the viewer.
        turned_away: `clamp`; or `black`, with which f is 0 where n.v <= 0, and n.v is not held.

    A batch axis of size 1, or none, repeats for every item of the others.

    Returns:
        (K, N, 3), or (B, K, N, 3) where any argument has a batch axis, in the dtype of the material. Finite for finite
        input. In float32 within 1e-5 of the exact value, relatively, for alpha >= 0.002. The same bits on every
        instruction set and for any number of threads.

    The gradient of tensors by the material is exact, and 0 where a texel is unlit, in a roughness below its floor and
    in a normal or direction shorter than 1e-6. The gradient of an n.v that is held is 0; n.h keeps its own. Nothing is
    stored for it: the backward pass shades again (Kemppinen et al. 2023, section 3.3). Each texel's sum runs over the
    pairs in order: the same bits whatever the number of threads.

    The gradient by lights and views is that of f(theta, l / |l|, v / |v|), at a right angle to each direction. It comes
    from dual numbers, and takes memory for two more results. There is no second derivative.

    Raises:
        UsageError: an unknown model or rule, or an argument whose type, dtype, device or shape does not fit, by name.
    """
    black = is_black(turned_away)
    like = ("material", checked("material", material, None, REAL))
    light, view = (_direction(name, value, like) for name, value in (("light", light), ("view", view)))
    batch, _, N = batch_shape(model_named(model).channels, tuple(material.shape), tuple(light.shape), tuple(view.shape))
    B, each = 1 if batch is None else batch, N if per_texel(light.shape, view.shape) else None
    texels = _forward.repeated(material, (B, N, material.shape[-1]))
    given: Any = (model, texels, _forward.expanded(light, B, each), _forward.expanded(view, B, each), black)
    out: Array
    if is_array(material):
        out = _forward.shade(*given)
    else:
        from mipbake.shading import ops

        out = ops.shade(*given)
    return out[0] if batch is None else out


def _direction(name: str, value: Any, like: tuple[str, Any]) -> Any:
    found = reals(name, value, like, dtype_of(like[1]))
    if not is_array(found):
        refuse_tangents(**{like[0]: like[1], name: value})
    return found


def shade_lit(
    model: str,
    material: NDArray[Any],
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

    black = is_black(turned_away)
    if not is_array(material):
        raise UsageError(f"material is a {type(material).__name__}: expected a NumPy array")
    texels = checked("material", material, None, REAL)
    like = ("material", texels)
    others = {"frame": frame, "view": view, "light": light, "radiance": radiance}
    given = (texels, *(reals(name, value, like, dtype_of(texels)) for name, value in others.items()))
    batch = lit_batch(model_named(model).channels, *(array.shape for array in given))
    if not np.isfinite(given[-1]).all():
        raise UsageError(f"radiance holds a value that is not finite in {texels.dtype}: expected finite numbers")
    B = 1 if batch is None else batch
    texels, axes, to_view, to_light, power = (
        _forward.repeated(strided(array), (B, *array.shape[-axes_of:]))
        for array, axes_of in zip(given, LIT_AXES.values(), strict=True)
    )
    out = np.empty((*texels.shape[:2], 3), texels.dtype)
    if out.size:
        _native.shade_lit(model, texels, axes, to_view, dense(to_light), dense(power), out, black)
    return out[0] if batch is None else out
