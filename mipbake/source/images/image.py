"""An image and its header, what a file says of its image in one record for all formats, and where that is applied.

Readers fill `Declared`. `arranged` puts texels where the file says that they belong, and runs once for every image,
between decoding and everything else. Alpha and colours are applied where a role takes its channels, because both depend
on the role: a roughness is not divided by an alpha, and has no colour space.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.base import memory
from mipbake.base.colour import unit_range
from mipbake.source.images.colours import Colour
from mipbake.source.options import STRAIGHT

Place: TypeAlias = "tuple[int, str]"
"""Part and layer of a file that has several."""


@dataclass(frozen=True)
class Window:
    """Where the stored texels lie in the image: the column and row of the first one, and the image's size."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True)
class Declared:
    """What a file says of its image. The defaults are what a file means that says nothing.

    Args:
        orientation: a number from 1 to 8, as in TIFF and Exif: how the stored rows and columns are turned.
        turn_is_pixels: whether every reader of the format must turn the image, as with TIFF, and not only those that
            care for Exif.
        texels_alone: whether vectors keep their values where the image is turned: writers of KTX 2 turn what was right.
        window: where the stored texels lie; None where they are the image.
        padded: whether some of the window holds no stored texels, and is zero.
        channels: which stored channels the image has, in the order red, green, blue, alpha; empty for all of them.
        swizzle: what each channel of the image is, in letters: r, g, b, a, 0 or 1; empty for the channels as stored.
        alpha: whether colours are multiplied by alpha ("premultiplied") or not ("straight"), or alpha is no opacity
            ("custom").
        colour: of the image's colours.
        part, layer: which of the file's images this is, and what its channels are called; of formats that have several.
        notes: what else is said, in sentences without the file's name.
        warnings: the same, of what the user should look at.
    """

    orientation: int = 1
    turn_is_pixels: bool = False
    texels_alone: bool = False
    window: Window | None = None
    padded: bool = False
    channels: tuple[int, ...] = ()
    swizzle: str = ""
    alpha: str = STRAIGHT
    colour: Colour = field(default_factory=Colour)
    part: int = 0
    layer: str = ""
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    def size(self, width: int, height: int) -> tuple[int, int]:
        """(width, height) of the image whose stored texels have this size."""
        if self.window is not None:
            width, height = self.window.width, self.window.height
        return (height, width) if _TURNS[self.orientation][0] else (width, height)


@dataclass(frozen=True)
class Header:
    """What is known of an image: size in texels, number of channels, the index of alpha (-1: none), stored type, and
    what the file says of it, which size and channels follow already.
    """

    path: Path
    width: int
    height: int
    channels: int
    alpha: int
    depth: str
    declared: Declared = field(default_factory=Declared)

    @property
    def colour_space(self) -> str | None:
        """The colour space that the file tells for its colours."""
        return self.declared.colour.space

    @property
    def colours(self) -> int:
        """The number of channels without alpha."""
        return self.channels - (self.alpha >= 0)

    @property
    def is_integer(self) -> bool:
        """Whether values are stored as integers that stand for [0, 1]."""
        return self.depth not in ("half", "float", "double")


@dataclass(frozen=True)
class Image:
    """A file's image: pixels (H, W, C) of uint8, uint16, float16 or float32 with the colours as stored, turned and
    placed as the file says, its header, and the file's SHA-256 in hexadecimal.
    """

    pixels: NDArray[np.generic]
    header: Header
    sha256: str


def in_gltf(said: Declared) -> Declared:
    """What counts where a glTF document holds the image: the document says the rest, and its readers ignore Exif."""
    warnings = said.warnings
    if said.orientation != 1 and not said.turn_is_pixels:
        key = "KTXorientation" if said.texels_alone else "Exif orientation"
        warnings += (f"its {key} {said.orientation} is ignored, as in all textures of glTF",)
    return replace(
        said,
        orientation=said.orientation if said.turn_is_pixels else 1,
        alpha=STRAIGHT,
        colour=Colour(),
        warnings=warnings,
    )


_TURNS = {turn: (turn >= 5, turn in (3, 4, 7, 8), turn in (2, 3, 6, 7)) for turn in range(1, 9)}
"""Orientation to whether rows and columns are exchanged, then rows reversed, then columns reversed."""


def orientation(value: object) -> int:
    """An orientation as a file stores it; 1 for anything that is none."""
    return int(value) if isinstance(value, (int, np.integer)) and int(value) in _TURNS else 1


def arranged(pixels: NDArray[Any], said: Declared) -> NDArray[Any]:
    """The image, (H, W, C), out of the texels that are stored: its channels, its window, its orientation."""
    if said.swizzle:
        pixels = _swizzled(pixels, said.swizzle)
    if said.window is not None:
        pixels = _placed(pixels, said.window)
    if said.orientation == 1:
        return pixels
    swapped, rows, columns = _TURNS[said.orientation]
    view = pixels.swapaxes(0, 1) if swapped else pixels
    view = view[:: -1 if rows else 1, :: -1 if columns else 1]
    out = memory.empty(view.shape, view.dtype)
    for some in memory.some_rows(out):
        out[some] = view[some]
    return out


def turn_vectors(vectors: NDArray[np.float32], said: int) -> None:
    """Turns x and y, right and up in the stored image, of (..., 2 or more) in place, as an orientation turns texels."""
    swapped, rows, columns = _TURNS[said]
    if swapped:
        vectors[..., :2] = -vectors[..., 1::-1]
    if columns:
        vectors[..., 0] *= -1
    if rows:
        vectors[..., 1] *= -1


def _placed(pixels: NDArray[Any], window: Window) -> NDArray[Any]:
    """Texels within a window: zero where none are stored, as OpenEXR defines it."""
    out = memory.empty((window.height, window.width, pixels.shape[2]), pixels.dtype)
    out[...] = 0
    top, left = max(0, window.y), max(0, window.x)
    bottom = min(window.height, window.y + pixels.shape[0])
    right = min(window.width, window.x + pixels.shape[1])
    out[top:bottom, left:right] = pixels[top - window.y : bottom - window.y, left - window.x : right - window.x]
    return out


def _swizzled(pixels: NDArray[Any], swizzle: str) -> NDArray[Any]:
    """Channels by their letters; a channel that is not stored is 0, and alpha 1."""
    one = np.iinfo(pixels.dtype.name).max if pixels.dtype.kind == "u" else 1
    out = memory.empty((*pixels.shape[:2], len(swizzle)), pixels.dtype)
    for index, letter in enumerate(swizzle):
        at = "rgba".find(letter)
        if 0 <= at < pixels.shape[2]:
            out[..., index] = pixels[..., at]
        else:
            out[..., index] = one if letter in "1a" else 0
    return out


def straight(colours: NDArray[np.generic], alpha: NDArray[np.generic]) -> NDArray[np.float32]:
    """Colours (H, W, C) divided by the alpha (H, W) that they were multiplied with, at the values that files store.

    Where alpha is 0 there is no colour to find: it stays as it is stored.
    """
    out = memory.empty(colours.shape)
    for some in memory.some_rows(out):
        weight = unit_range(alpha[some])[..., None]
        out[some] = unit_range(colours[some]) / np.where(weight > 0, weight, np.float32(1))
    return out


def share_beyond(colours: NDArray[np.generic], alpha: NDArray[np.generic]) -> float:
    """Share of the texels whose colour exceeds alpha, as no reflectance does that was multiplied by it."""
    slack = np.float32(1.5 / np.iinfo(colours.dtype.name).max if colours.dtype.kind == "u" else _ROUNDED)
    count = 0
    for some in memory.some_rows(colours):
        most = unit_range(alpha[some]) * (1 + np.float32(_ROUNDED)) + slack
        count += int(np.count_nonzero(unit_range(colours[some]).max(-1) > most))
    return count / alpha.size


_ROUNDED = 2e-3
"""What half floats, twice rounded, may be off."""
