"""Texture lookups as a GPU filters, at (u, v) with image-space derivatives or a level of detail: differentiable.

`texture` and `texture_construct_mip` take torch tensors or NumPy arrays. `mipbake.sampling.reference` holds their plain
torch twins, which they are tested against.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from mipbake.base.arguments import is_array, reals
from mipbake.base.first_order import refuse_tangents
from mipbake.sampling import _arguments, _forward
from mipbake.sampling._arguments import TextureMip, level_sizes

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from torch import Tensor

    Array = TypeVar("Array", NDArray[Any], Tensor)

__all__ = ["texture", "texture_construct_mip"]


def texture(
    tex: Array,
    uv: Any,
    uv_da: Any = None,
    mip_level_bias: Any = None,
    mip: TextureMip | Sequence[Array] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str | Sequence[str] = "wrap",
    max_mip_level: int | None = None,
) -> Array:
    """Filtered texture lookups (Laine et al. 2020, section 3.5).

    Texel (row i, column j) of a level is centred at u = (j + 1/2) / W, v = (i + 1/2) / H. The same u and v address
    every level. A lookup at a texel centre returns that texel bit for bit: a coordinate within its own rounding error
    of a centre counts as the centre. A lookup that reads equal texels returns their value bit for bit (filters
    "linear..." under "wrap", "clamp" and "mirror").

    The footprint of a pixel is its image under diag(W, H) d(u, v) / d(X, Y), and the length of its major axis is the
    largest singular value of that. The level of detail is log2 of this length in texels of level 0, plus
    `mip_level_bias`. Without `uv_da` the level of detail is the bias alone. It is clamped to the levels that exist:
    zero derivatives give level 0, infinite derivatives the last level.

    Args:
        tex: (B, H, W, C), any size up to 2^22 a side, or for cube maps (B, 6, S, S, C) with faces +x, -x, +y, -y, +z,
            -z as in OpenGL (table 8.19 of its specification 4.6; row 0 at t = 0). Torch: float32, float64 (CPU),
            float16 or bfloat16; NumPy: float32, float64 or float16. Texels of half types stay as they are in memory;
            lookups compute and return float32. The texture is read in place, without a copy, where the channels of a
            texel lie side by side (internal mips want the whole texture contiguous).
        uv: (B, h, w, 2), any real numbers, in units of the texture; for cube maps (B, h, w, 3) vectors of any length.
            Here and below other dtypes are converted to the dtype of the result.
        uv_da: (B, h, w, 4) image-space derivatives of uv, (du/dX, du/dY, dv/dX, dv/dY) in units of uv per pixel; for
            cube maps (B, h, w, 6). Filters without mips ignore it, and the bias too.
        mip_level_bias: (B, h, w) in levels, added to the level of detail; an axis of size 1 repeats.
        mip: what `texture_construct_mip` made of this same `tex`, or a list of the levels 1 and coarser in the layout
            and dtype of `tex`, of any sizes. Without it, filters with mips make the levels internally and discard them.
        filter_mode: "nearest" (the texel that contains uv), "linear", "linear-mipmap-nearest" (the level of detail
            rounded, halves up), "linear-mipmap-linear" (between the two levels around it), "anisotropic" or "auto".
            "auto" is "linear-mipmap-linear" if uv_da or mip_level_bias is given, else "linear". "anisotropic" averages
            N = min(ceil(major / minor axis), 16) trilinear lookups spread evenly along the major axis, at the level of
            detail of major / N (EXT_texture_filter_anisotropic). It needs uv_da, and does not take cube maps.
        boundary_mode: "wrap" (the texture repeats), "clamp" (to the centre of the edge texel), "mirror" (repeats,
            reflected at every border), "zero" (texels outside are zeros, so that borders fade over one texel), or two
            of these, for u and for v; "cube" for cube maps. Lookups near the edge of a face read the next face as
            well. At a corner of the cube three texels meet, and their mean stands for the missing fourth texel.
        max_mip_level: the coarsest level that is made and used; default: 1 x 1, or the last of `mip`.

    A minibatch of size 1 repeats for every item of the others.

    Returns:
        (B, h, w, C) in the dtype of `tex`, float32 for half types. A result is NaN where uv or the level of detail is
        NaN, or where u or v is infinite under "wrap" or "mirror" (an infinite coordinate clamps under "clamp", and is
        outside under "zero"). It is zero for cube vectors that are zero or not finite. On the CPU the bits do not
        depend on the number of threads.

    Gradients (of torch tensors; NumPy arrays have none) flow to tex, the levels of a custom stack, uv, uv_da and
    mip_level_bias. Through internal mips and the mips of `texture_construct_mip` they go to `tex` alone, in one buffer
    of its size, with a third as much scratch for the coarser levels. For many lookups the CPU takes 8 to 16 bytes more
    for each lookup, of at most 4 M at a time.

    The gradient belongs to the piecewise linear interpolant, one-sided at its kinks: at a texel centre it is the slope
    towards larger u and v, at a whole level of detail the step to the next coarser level. The gradient by uv is 0 under
    "nearest" and beyond the outer texel centres under "clamp". The gradient by the level of detail is 0 where that is
    clamped, and under "linear-mipmap-nearest". The gradient of "anisotropic" holds its number of taps fixed. An
    undefined lookup has no gradient and adds none. An argument that repeats gets the sum. Gradients of half types are
    summed in float32 and rounded once. On the CPU texel gradients are summed in the order of the lookups, so the bits
    do not depend on the number of threads. With CUDA atomics sum them, and last digits vary from run to run. There is
    no second derivative. torch.compile traces through.

    Raises:
        UsageError: the type, dtype, device, shape or name of an argument does not fit, or an argument is missing that
            the filter needs.
    """
    dtype, like = _arguments.check_storage(tex), ("tex", tex)
    named = {"uv": uv, "uv_da": uv_da, "mip_level_bias": mip_level_bias}
    uv = reals("uv", uv, like, dtype)
    uv_da = None if uv_da is None else reals("uv_da", uv_da, like, dtype)
    bias = None if mip_level_bias is None else reals("mip_level_bias", mip_level_bias, like, dtype)
    plan: _arguments.Plan = _arguments.plan_texture(
        tuple(tex.shape),
        tuple(uv.shape),
        None if uv_da is None else tuple(uv_da.shape),
        None if bias is None else tuple(bias.shape),
        _arguments.checked_mip(mip, tex),
        filter_mode,
        boundary_mode,
        max_mip_level,
    )
    if not is_array(tex):
        levels = {} if mip is None or isinstance(mip, TextureMip) else {f"mip[{i}]": each for i, each in enumerate(mip)}
        refuse_tangents(tex=tex, **named, **levels)
    coarser: Sequence[Any] = ()
    if plan.levels > 1:
        made = _mips(tex, plan.levels - 1) if mip is None else mip.levels if isinstance(mip, TextureMip) else mip
        coarser = made[: plan.levels - 1]
    chain = bool(coarser) and (mip is None or isinstance(mip, TextureMip))
    chooses_level = plan.filter not in ("nearest", "linear")
    uv_da, bias = (each if chooses_level else None for each in (uv_da, bias))
    along_u, along_v = plan.boundary
    given: Any = ([tex, *coarser], uv, uv_da, bias, plan.filter, along_u, along_v, chain)
    out: Array
    if is_array(tex):
        out = _forward.texture(*given)
        return out
    from mipbake.sampling import ops

    out = ops.texture(*given)
    return out


def texture_construct_mip(
    tex: Tensor | NDArray[Any], max_mip_level: int | None = None, cube_mode: bool = False
) -> TextureMip:
    """The mip levels of a texture that stays constant over many lookups, for the argument `mip` of `texture`.

    Where level L has n texels along a side, level L + 1 has max(1, n // 2). Each texel is the average of the area that
    it covers: 2 texels along an even side, 3 along an odd side, with polyphase weights. Each level is made from the
    level before (Laine et al. 2020, figure 2 a) and stored in the dtype of `tex`. Each face of a cube map is by itself.

    Args:
        tex: as for `texture`.
        max_mip_level: the coarsest level; default: complete to 1 x 1.
        cube_mode: whether `tex` is a cube map.

    Returns:
        An opaque object for textures of the same shape, dtype and device. Gradients pass through it to the `tex` of
        `texture`, as if the levels were made there. After a change of `tex` it must be made again.

    Raises:
        UsageError: the type, dtype, device or shape of an argument does not fit.
    """
    _arguments.check_storage(tex)
    _arguments.check_texture("tex", tuple(tex.shape), cube_mode, "cube_mode to True")
    _arguments.check_max_mip_level(max_mip_level)
    count = len(level_sizes(tex.shape[-3], tex.shape[-2], max_mip_level)) - 1
    return TextureMip(tuple(tex.shape), tuple(_mips(tex, count)) if count else ())


def _mips(tex: Any, count: int) -> Sequence[Any]:
    if is_array(tex):
        return _forward.mips(tex, count)
    from mipbake.sampling import ops

    found: Sequence[Any] = ops.mips(tex.detach(), count)
    return found
