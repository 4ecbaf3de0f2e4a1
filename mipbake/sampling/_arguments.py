"""Checks of the arguments of `sample` that its NumPy door, its torch op and its twin share: shapes and names only."""

from __future__ import annotations

from collections.abc import Sequence

from mipbake.errors import UsageError

Shape = tuple[int, ...]

WRAP_MODES = ("wrap", "clamp")
MAX_LEVELS = 32
MAX_SIDE = 2**30


def check_level_count(count: int) -> None:
    """UsageError unless there are 1 to MAX_LEVELS levels."""
    if not 1 <= count <= MAX_LEVELS:
        raise UsageError(f"levels has {count} items: expected 1 to {MAX_LEVELS} arrays, the finest level first")


def wraps(wrap: Sequence[str]) -> tuple[bool, bool]:
    """Whether u and v repeat. `wrap` is a pair of WRAP_MODES."""
    pair = isinstance(wrap, Sequence) and not isinstance(wrap, str) and len(wrap) == 2
    if not pair or any(mode not in WRAP_MODES for mode in wrap):
        raise UsageError(f"wrap is {wrap!r}: expected a pair of 'wrap' or 'clamp', for u and for v")
    return wrap[0] == "wrap", wrap[1] == "wrap"


def result_shape(levels: Sequence[Shape], uv: Shape, lod: Shape) -> Shape:
    """(P, C), or (B, P, C) where levels, uv or lod has a batch axis; UsageError where the shapes do not fit."""
    check_level_count(len(levels))
    first = levels[0]
    for index, shape in enumerate(levels):
        if len(shape) not in (3, 4) or 0 in shape:
            raise UsageError(
                f"levels[{index}] has shape {_text(shape)}: expected (H, W, C) or (B, H, W, C), none of them 0"
            )
        if len(shape) != len(first) or shape[-1] != first[-1] or shape[:-3] != first[:-3]:
            raise UsageError(
                f"levels[{index}] has shape {_text(shape)} where levels[0] has {_text(first)}: "
                "expected the same batch and the same channels in every level"
            )
        if max(shape[-3], shape[-2]) > MAX_SIDE:
            raise UsageError(f"levels[{index}] has shape {_text(shape)}: expected at most {MAX_SIDE} texels a side")
    if len(uv) not in (2, 3) or uv[-1] != 2 or (len(uv) == 3 and uv[0] == 0):
        raise UsageError(f"uv has shape {_text(uv)}: expected (P, 2) or (B, P, 2)")
    points = uv[-2]
    if len(lod) > 2 or (lod and lod[-1] != points) or (len(lod) == 2 and lod[0] == 0):
        raise UsageError(
            f"lod has shape {_text(lod)}: "
            f"expected a scalar, (P,) or (B, P) with P = {points}, the number of lookups in uv"
        )
    batches = {"levels": first[:-3], "uv": uv[:-2], "lod": lod[:-1]}
    given = {name: batch[0] for name, batch in batches.items() if batch}
    sizes = [size for size in given.values() if size != 1]
    if any(size != sizes[0] for size in sizes):
        listed = ", ".join(f"{name} has {size}" for name, size in given.items())
        raise UsageError(f"batch sizes do not fit: {listed}; expected each to be 1 or the same number")
    batch = (sizes[0] if sizes else 1,) if given else ()
    return (*batch, points, first[-1])


def _text(shape: Shape) -> str:
    return str(tuple(shape))
