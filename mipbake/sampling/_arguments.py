"""Checks of the arguments of `texture`, and of its plain twin: kinds, shapes and names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from mipbake.base.arguments import batch_size, check_shape, checked, dtype_of, is_array, whole
from mipbake.base.errors import UsageError

Shape = tuple[int, ...]

FILTERS = ("auto", "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear", "anisotropic")
BOUNDARIES = ("wrap", "clamp", "mirror", "zero")
MIP_FILTERS = ("linear-mipmap-nearest", "linear-mipmap-linear", "anisotropic")
MAX_TAPS = 16
MAX_LEVELS = 32
MAX_SIDE = 2**22  # beyond, float32 cannot tell the halves of a texel apart in a mirrored period


@dataclass(frozen=True)
class TextureMip:
    """Levels 1 and coarser of a texture, from `texture_construct_mip`; pass it as `mip` with that same texture."""

    base: Shape
    levels: tuple[Any, ...] = field(repr=False)


@dataclass(frozen=True)
class Plan:
    """What a lookup does, as far as shapes and names tell.

    Args:
        filter: one of FILTERS, "auto" resolved.
        boundary: for u and for v; ("cube", "cube") for cube maps.
        levels: how many levels are looked up, level 0 included.
        shape: (B, h, w, C) of the result.
    """

    filter: str
    boundary: tuple[str, str]
    levels: int
    shape: tuple[int, int, int, int]


def boundaries(boundary_mode: str | Sequence[str]) -> tuple[str, str]:
    """The modes for u and for v."""
    if isinstance(boundary_mode, str):
        if boundary_mode == "cube" or boundary_mode in BOUNDARIES:
            return boundary_mode, boundary_mode
    elif isinstance(boundary_mode, Sequence) and len(boundary_mode) == 2:
        u, v = boundary_mode
        if u in BOUNDARIES and v in BOUNDARIES:
            return u, v
    raise UsageError(
        f"boundary_mode is {boundary_mode!r}: expected 'wrap', 'clamp', 'mirror', 'zero' or 'cube', "
        "or two of the first four, for u and for v"
    )


def check_texture(name: str, shape: Shape, cube: bool, setting: str = "boundary_mode to 'cube'") -> None:
    """UsageError unless the shape fits a texture, or a cube map; `setting` is what says which."""
    form = "(B, 6, S, S, C), S and C" if cube else "(B, H, W, C), H, W and C"
    fits = len(shape) == (5 if cube else 4) and (not cube or (shape[1] == 6 and shape[2] == shape[3]))
    if not fits or any(size == 0 for size in shape[1:]):
        hint = "" if fits or cube or len(shape) != 5 else f"; for a cube map set {setting}"
        raise UsageError(f"{name} has shape {tuple(shape)}: expected {form} from 1 on{hint}")
    if shape[-3] > MAX_SIDE or shape[-2] > MAX_SIDE:
        raise UsageError(f"{name} has shape {tuple(shape)}: expected at most {MAX_SIDE} texels a side")


def level_sizes(height: int, width: int, max_mip_level: int | None) -> list[tuple[int, int]]:
    """(H, W) of levels 0, 1, ...: half the one before, rounded down, to 1 x 1 or to level `max_mip_level`."""
    sizes = [(height, width)]
    while sizes[-1] != (1, 1) and (max_mip_level is None or len(sizes) <= max_mip_level):
        height, width = sizes[-1]
        sizes.append((max(1, height // 2), max(1, width // 2)))
    return sizes


def check_max_mip_level(max_mip_level: int | None) -> None:
    """UsageError unless it is None or a whole number from 0."""
    level = 0 if max_mip_level is None else whole(max_mip_level)
    if level is None or level < 0:
        raise UsageError(f"max_mip_level is {max_mip_level!r}: expected None or a whole number from 0")


def resolved_filter(filter_mode: str, has_uv_da: bool, has_bias: bool) -> str:
    """One of FILTERS without "auto"; UsageError where what it needs is missing."""
    if filter_mode not in FILTERS:
        names = ", ".join(repr(name) for name in FILTERS[:-1])
        raise UsageError(f"filter_mode is {filter_mode!r}: expected {names} or {FILTERS[-1]!r}")
    if filter_mode == "auto":
        return "linear-mipmap-linear" if has_uv_da or has_bias else "linear"
    if filter_mode == "anisotropic" and not has_uv_da:
        raise UsageError("filter_mode is 'anisotropic' and uv_da is missing: expected the derivatives of uv in uv_da")
    if filter_mode in MIP_FILTERS and not (has_uv_da or has_bias):
        raise UsageError(f"filter_mode is {filter_mode!r}: expected uv_da or mip_level_bias, which choose the level")
    return filter_mode


def plan_texture(
    tex: Shape,
    uv: Shape,
    uv_da: Shape | None,
    bias: Shape | None,
    mip: TextureMip | Sequence[Shape] | None,
    filter_mode: str,
    boundary_mode: str | Sequence[str],
    max_mip_level: int | None,
) -> Plan:
    """Checks the shapes and names of a lookup; `mip` as the caller gave it, a custom stack by its shapes."""
    filter_name = resolved_filter(filter_mode, uv_da is not None, bias is not None)
    boundary = boundaries(boundary_mode)
    cube = boundary[0] == "cube"
    check_texture("tex", tex, cube)
    check_max_mip_level(max_mip_level)
    if cube and filter_name == "anisotropic":
        raise UsageError(
            "filter_mode is 'anisotropic' and boundary_mode is 'cube': expected another filter for cube maps, "
            "such as 'linear-mipmap-linear'"
        )
    last = 3 if cube else 2
    check_shape("uv", uv, [("B", "h", "w", last)])
    if uv_da is not None:
        check_shape("uv_da", uv_da, [("B", *uv[1:3], 2 * last)], "the lookups of uv")
    if bias is not None and (len(bias) != 3 or bias[1] not in (1, uv[1]) or bias[2] not in (1, uv[2])):
        raise UsageError(
            f"mip_level_bias has shape {tuple(bias)}: expected (B, {uv[1]}, {uv[2]}), the lookups of uv, "
            "or 1 on an axis along which it repeats"
        )
    named = {"tex": tex, "uv": uv, "uv_da": uv_da, "mip_level_bias": bias}
    batch = batch_size({name: shape[0] for name, shape in named.items() if shape is not None})
    levels = _level_count(tex, mip, max_mip_level, cube) if filter_name in MIP_FILTERS else 1
    return Plan(filter_name, boundary, levels, (batch, uv[1], uv[2], tex[-1]))


def _level_count(tex: Shape, mip: TextureMip | Sequence[Shape] | None, max_mip_level: int | None, cube: bool) -> int:
    if mip is None:
        return len(level_sizes(tex[-3], tex[-2], max_mip_level))
    if isinstance(mip, TextureMip):
        if tuple(mip.base) != tuple(tex):
            raise UsageError(
                f"mip was made for a texture of shape {tuple(mip.base)}: expected the shape of tex, {tuple(tex)}"
            )
        given = len(mip.levels)
    else:
        given = len(mip)
        if given >= MAX_LEVELS:
            raise UsageError(f"mip has {given} levels: expected at most {MAX_LEVELS - 1}")
        for index, shape in enumerate(mip):
            check_texture(f"mip[{index}]", shape, cube)
            if shape[0] != tex[0] or shape[-1] != tex[-1]:
                raise UsageError(
                    f"mip[{index}] has shape {tuple(shape)} where tex has {tuple(tex)}: "
                    "expected the same minibatch and the same channels"
                )
    return 1 + (given if max_mip_level is None else min(given, max_mip_level))


STORAGE = {True: ("float32", "float64", "float16"), False: ("float32", "float64", "float16", "bfloat16")}
"""Dtypes of textures: of NumPy arrays, and of tensors."""


def check_storage(tex: Any) -> str:
    """The dtype that lookups in a texture compute in."""
    checked("tex", tex, None, STORAGE[is_array(tex)])
    return "float64" if dtype_of(tex) == "float64" else "float32"


def checked_mip(mip: Any, tex: Any) -> TextureMip | list[Shape] | None:
    """The argument `mip` as `plan_texture` takes it: a custom stack by its shapes."""
    if mip is None:
        return None
    if not isinstance(mip, TextureMip) and (isinstance(mip, str) or not isinstance(mip, Sequence)):
        raise UsageError(
            f"mip is a {type(mip).__name__}: expected what texture_construct_mip returns, or a list of levels"
        )
    levels = mip.levels if isinstance(mip, TextureMip) else mip
    for index, level in enumerate(levels):
        checked(f"mip[{index}]", level, ("tex", tex), (dtype_of(tex),))
    return mip if isinstance(mip, TextureMip) else [tuple(level.shape) for level in levels]
