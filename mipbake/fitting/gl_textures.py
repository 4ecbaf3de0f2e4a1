"""What the renderer `gl` keeps its maps in: textures, of which it uploads the tiles that are new."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import UsageError
from mipbake.base.extras import extra
from mipbake.base.srgb import srgb_to_linear
from mipbake.fitting.renderer import Array, Levels
from mipbake.material import COLOUR, MODELS
from mipbake.material.pixel_filter import level_sizes

TEXELS = ("rgba8", "rgba32f")
"""How textures hold texels: rounded to 8 bits, or not at all."""

_SRGB8_ALPHA8 = 0x8C43


class GlTextures:
    """One texture for each map of a stack.

    Texels that are rounded to 8 bits lie in normalised numbers of 16 bits, q / 255 as 257 q / 65535, which are the very
    same numbers. llvmpipe filters textures of 8 bits in 8 bits: between 10/255 and 20/255 it finds nothing but whole
    255ths, where GPUs and its other textures do. Colours are exempt, as sRGB is decoded before it is filtered.

    Args:
        context: of moderngl, and current in all calls.
        levels: whose sizes and model they are made for; nothing is uploaded yet.
        texels: one of `TEXELS`.

    Raises:
        UsageError: levels that do not halve from one to the next.
    """

    def __init__(self, context: Any, levels: Levels, texels: str) -> None:
        moderngl = loaded_moderngl()

        sizes = levels.sizes
        if sizes != level_sizes(*sizes[0])[: len(sizes)]:
            raise UsageError(f"levels measure {sizes} (height, width): expected each half as large as the one before")
        height, width = sizes[0]
        self._stamps: tuple[NDArray[np.int64], ...] | None = None
        self._colours = {each.name for each in MODELS[levels.model].stored if each.facts.encoding == COLOUR}
        self._rounded = texels == "rgba8"
        self.maps: dict[str, Any] = {}  # one or two channels, or four for three
        for name, arrays in levels.maps.items():
            channels = arrays[0].shape[2]
            components = 4 if channels == 3 else channels
            dtype, internal = "f4", None
            if self._rounded:
                dtype, internal = ("f1", _SRGB8_ALPHA8) if name in self._colours else ("nu2", None)
            texture = context.texture((width, height), components, alignment=1, dtype=dtype, internal_format=internal)
            texture.build_mipmaps(0, len(sizes) - 1)  # makes room, and sets the last level
            texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
            self.maps[name] = texture

    def update(self, levels: Levels) -> None:
        """Uploads the tiles whose stamps are others than before, and sets how lookups wrap."""
        changed, self._stamps = levels.changed(self._stamps), None  # an upload that fails is made anew
        for name, texture in self.maps.items():
            texture.repeat_x, texture.repeat_y = (each == "wrap" for each in levels.wrap)
            for index, (level, parts) in enumerate(zip(levels.maps[name], changed, strict=True)):
                for part in parts:
                    texels = self._encoded(part.of(level), name in self._colours, texture.components)
                    texture.write(texels, (part.column, part.row, part.width, part.height), index)
        self._stamps = levels.stamps

    def release(self) -> None:
        """Gives the memory of the driver back."""
        for texture in self.maps.values():
            texture.release()

    def _encoded(self, level: Array, colour: bool, components: int) -> NDArray[Any]:
        """(H, W, components): texels as the texture holds them."""
        level = np.asarray(level, np.float32)
        height, width, channels = level.shape
        if not self._rounded:
            whole = np.ones((height, width, components), np.float32)
            whole[..., :channels] = srgb_to_linear(level) if colour else level
            return whole
        # A channel at a time, which NumPy is three times as quick at as at vectors of three.
        texels = np.full((height, width, components), 255, np.uint8)
        for channel in range(channels):
            scaled = level[..., channel] * np.float32(255) + np.float32(0.5)
            texels[..., channel] = np.clip(scaled, 0, 255, out=scaled)  # the integer below
        return texels if colour else texels.astype(np.uint16) * np.uint16(257)


def loaded_moderngl() -> Any:
    """The module moderngl; UsageError, with what to type, where it is missing."""
    with extra("fit", "the renderer gl"):
        import moderngl
    return moderngl
