"""What errors of the texels of a file count in what is shaded: encoders of blocks spend their bits by it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mipbake.base.srgb import slope_of_decoding
from mipbake.material import MODELS
from mipbake.material.gltf import error_weights
from mipbake.source.layout import COLOUR, FLIPPED, LAYOUTS, SIGNED, FileChannel, FileLayout

Image = NDArray[np.float32]

_LEAST_ALONG = 0.1  # of the weight across a normal, along it: the length of a normal still counts when it is averaged
_LEAST_Z = 0.1  # normals that lie flatter do not count more


@dataclass(frozen=True, eq=False)
class BlockWeights:
    """Weights for the file of a stack, made when they are asked for: all would be as large as the file.

    Args:
        model: of the stack, one that glTF has. levels: (H_L, W_L, S) its stored channels.
        layout: of the file. srgb: whether its colours are sRGB-encoded.
        factors: what a material multiplies the values of a map in the file by, by name; x and y of normals.
    """

    model: str
    levels: Sequence[Image]
    layout: FileLayout
    srgb: bool
    factors: Mapping[str, float]

    def __call__(self, level: int, rows: slice) -> Image:
        """See `mipbake.source.images.blocks.Weigh`."""
        stored = self.levels[level][rows]
        weights, diffuse, lobe = error_weights(stored)
        places = {each.name: each.channels.start for each in LAYOUTS[self.model]}
        beside = {"occlusion": diffuse, "opacity": (diffuse + lobe) / 2}
        out: list[Image | None] = []
        data: Image = np.zeros(stored.shape[:2], np.float32)
        for channel in self.layout.channels:
            if channel.map in places:
                place = places[channel.map] + channel.index
                scale = self.factors.get(channel.map, 1.0) ** 2
                counts = scale * weights[..., place] * self._of_encoding(channel, stored[..., place])
            else:
                counts = beside.get(channel.map, data)
            data = np.maximum(data, counts)
            out.append(self._of_normal(stored, weights, channel.index) if channel.map == "normal" else None)
        # Maps that share a block count alike. Single lights, which weights are about, hardly see a metallic of 0.99 in
        # place of 1; but what is dark beside a highlight then glows.
        return np.stack([data if each is None else each for each in out], -1).astype(np.float32)

    def _of_normal(self, stored: Image, weights: Image, axis: int) -> Image:
        """(...) weights of what a file holds of x, y or z: half a unit for a unit."""
        place = MODELS[self.model].normal
        normal, across = stored[..., place], weights[..., place.start]
        if sum(channel.map == "normal" for channel in self.layout.channels) == 2:
            turned = (1 - np.square(normal[..., 1 - axis])) / np.square(np.maximum(normal[..., 2], _LEAST_Z))
        else:
            # Of vectors that a factor makes flatter, the short ones count less where texels are averaged.
            flat = self.factors.get("normal", 1.0) ** 2
            turned = np.maximum((1 - np.square(normal[..., axis])) * (flat if axis < 2 else 1), _LEAST_ALONG * flat)
        return np.asarray(4 * across * turned)

    def _of_encoding(self, channel: FileChannel, value: Image) -> Image | float:
        """Squared derivative of a value by what the file holds of it."""
        if channel.encoding != COLOUR or not self.srgb:
            return 4.0 if channel.encoding in (SIGNED, FLIPPED) else 1.0
        return np.asarray(np.square(slope_of_decoding(value)), np.float32)
