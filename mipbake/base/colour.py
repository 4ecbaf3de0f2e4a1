"""Colour decoding: encoded file values to linear Rec.709."""

from __future__ import annotations

import difflib
from collections.abc import Callable
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mipbake.base.colour_science import colour_science
from mipbake.base.colour_spaces import COLOUR_SPACES
from mipbake.base.errors import UsageError
from mipbake.base.srgb import srgb_to_linear

SRGB, LINEAR = "sRGB", "linear Rec.709"

_LINEAR_NAMES = {"linear rec.709", "linear srgb", "lin_rec709", "linear rec709", "linear itu-r bt.709", "linear"}


@lru_cache(maxsize=4)
def _srgb_table(dtype: str) -> NDArray[np.float32]:
    top = np.iinfo(dtype).max
    return srgb_to_linear(np.arange(top + 1) / top).astype(np.float32)


def unit_range(pixels: NDArray[Any]) -> NDArray[np.float32]:
    """Integers of 8 and 16 bit to [0, 1]; floating-point values as they are. (...) to (...) of float32."""
    if pixels.dtype.kind == "u":
        scale = np.float32(1 / np.iinfo(pixels.dtype).max)
        return np.asarray(np.multiply(pixels, scale, dtype=np.float32))
    return pixels.astype(np.float32, copy=False)


def default_colour_space(is_integer: bool) -> str:
    """sRGB for integer files, linear Rec.709 for floating-point ones."""
    return SRGB if is_integer else LINEAR


def canonical_colour_space(name: str) -> str:
    """The name under which `decode` knows a colour space; UsageError with the nearest names when there is none."""
    lowered = name.strip().lower()
    if lowered == "srgb":
        return SRGB
    if lowered in _LINEAR_NAMES:
        return LINEAR
    linear = lowered.startswith("linear ")
    wanted = lowered.removeprefix("linear ")
    known = {own.lower(): own for own in COLOUR_SPACES}
    if wanted not in known:
        known = {each.lower(): each for each in _colour_science(name).RGB_COLOURSPACES}
    if wanted not in known:
        near = difflib.get_close_matches(wanted, known, n=3, cutoff=0.4)
        hint = ", ".join([SRGB, LINEAR, *(known[n] for n in near)])
        raise UsageError(
            f"unknown colour space {name!r}: expected a name that colour-science knows, with or without 'linear ' "
            f"before it, for example {hint}"
        )
    return f"{'linear ' if linear else ''}{known[wanted]}"


def _colour_science(name: str) -> ModuleType:
    return colour_science(f"the colour space {name!r}, which mipbake does not know itself,")


def is_linear(colour_space: str) -> bool:
    """Whether values of a colour space that `canonical_colour_space` returned are proportional to light."""
    return colour_space.startswith("linear ") or colour_space in ("ACEScg", "ACES2065-1")


def decode(pixels: NDArray[Any], colour_space: str) -> NDArray[np.float32]:
    """File values (H, W, 3) of uint8, uint16 or floating point to linear Rec.709 (H, W, 3) float32, not clipped.

    Args:
        pixels: values as the file stores them.
        colour_space: a name that `canonical_colour_space` returned. Other primaries than Rec.709's are converted with
            Bradford's chromatic adaptation.
    """
    if colour_space == LINEAR:
        return unit_range(pixels)
    if colour_space == SRGB:
        if pixels.dtype.kind == "u":
            return np.asarray(_srgb_table(pixels.dtype.name)[pixels])
        return np.asarray(srgb_to_linear(pixels.astype(np.float32, copy=False)), np.float32)
    return _decode_named(pixels, colour_space)


def _decode_named(pixels: NDArray[Any], colour_space: str) -> NDArray[np.float32]:
    matrix, decoded = _conversion(colour_space.removeprefix("linear "))
    if colour_space.startswith("linear ") or decoded is None:
        values = unit_range(pixels)
    elif pixels.dtype.kind == "u":
        top = np.iinfo(pixels.dtype).max
        values = np.asarray(decoded(np.arange(top + 1) / top), np.float32)[pixels]
    else:
        values = np.asarray(decoded(pixels.astype(np.float64)), np.float32)
    return np.asarray(values @ np.asarray(matrix, np.float32).T, np.float32)


def _conversion(name: str) -> tuple[ArrayLike, Callable[[NDArray[np.floating]], NDArray[np.floating]] | None]:
    """The matrix to linear Rec.709, and what decodes values; None where they are linear."""
    own = COLOUR_SPACES.get(name)
    if own is not None:
        return own.to_rec709, own.decoded
    colour = _colour_science(name)
    space = colour.RGB_COLOURSPACES[name]
    return colour.matrix_RGB_to_RGB(space, colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford"), space.cctf_decoding
