"""Ranges of the values in a glTF material's textures: its factors stretch them, so that eight bits are used well.

glTF multiplies x and y of a normal texture by `normalTexture.scale` before it renormalises, and roughness by
`roughnessFactor`. So normals may be stored steeper and roughness higher than they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from mipbake.source.layout import channels_of
from mipbake.stack.map_files import Levels, MapFile

Values: TypeAlias = NDArray[np.float32]

LEAST_SCALE = 1 / 64
"""The least scale of normals: a step of eight bits is then a slope of 1/8192, below which no lobe is narrow enough to
show it."""

_LEAST_Z = 0.05  # slopes of steeper normals are held there
_LEAST_FACTOR = 1 / 255  # a step of eight bits: not tuned
_USUAL_SHARE = 0.9  # share of slopes within the scale: the best of the tried shares for all sets (benchmarks/uastc.py)


@dataclass(frozen=True)
class Ranges:
    """What the values in the textures are multiplied by.

    Args:
        normal: `normalTexture.scale`, above 0. Normals (x, y, z) are stored as the unit vector along
            (x / normal, y / normal, z).
        roughness: `roughnessFactor`, above 0 and at most 1.
    """

    normal: float = 1.0
    roughness: float = 1.0

    def stored(self, file: MapFile) -> MapFile:
        """A file with the values that its texture holds, from a file with the values that are meant."""
        return self._changed(file, self._stretched)

    def shown(self, file: MapFile) -> MapFile:
        """A file with the values that a material shows, from a file with the values that its texture holds.

        Normals are not made unit again: engines filter them as they are stored, so that steep ones count less.
        """
        return self._changed(file, self._shown)

    def meant(self, file: MapFile) -> MapFile:
        """Values as from `shown`, with unit normals where they are stretched: to be compared with what was
        stretched."""
        return self._changed(file, self._meant)

    def _changed(self, file: MapFile, change: Callable[[str, Values], Values]) -> MapFile:
        places: dict[str, dict[int, int]] = {}
        for place, channel in enumerate(file.layout.channels):
            if channel.map in ("normal", "roughness") and getattr(self, channel.map) != 1:
                places.setdefault(channel.map, {})[channel.index] = place
        if not places:
            return file
        levels = []
        for level in file.levels:
            made = level.copy()
            for name, of in places.items():
                channels = [of[index] for index in sorted(of)]
                made[..., channels] = change(name, level[..., channels])
            levels.append(made)
        return replace(file, levels=levels)

    def _stretched(self, name: str, values: Values) -> Values:
        if name == "roughness":
            return np.asarray(values / self.roughness, np.float32)
        return _unit(np.asarray(values / [self.normal, self.normal, 1], np.float32))

    def _shown(self, name: str, values: Values) -> Values:
        if name == "roughness":
            return np.asarray(values * self.roughness, np.float32)
        return np.asarray(values * [self.normal, self.normal, 1], np.float32)

    def _meant(self, name: str, values: Values) -> Values:
        shown = self._shown(name, values)
        return _unit(shown) if name == "normal" else shown


def usual_ranges(levels: Levels, model: str) -> Ranges:
    """Ranges for the levels of a stack of `gltf` or `gltf-anisotropic` that nobody measures.

    Nine tenths of the slopes of its normals lie within the scale, and the highest roughness becomes 1.
    """
    return Ranges(scale_within(levels, model, _USUAL_SHARE), roughness_factor(levels, model))


def scale_within(levels: Levels, model: str, share: float) -> float:
    """The scale of normals that so large a share of the slopes of levels 0 and 1 lies within; from `LEAST_SCALE` to 1.

    Args:
        share: from 0 to 1.
    """
    slopes: list[NDArray[np.float32]] = []
    for level in levels[:2]:
        normal = level[..., channels_of(model, "normal")]
        slopes.append(np.abs(normal[..., :2] / np.maximum(normal[..., 2:], _LEAST_Z)).reshape(-1))
    found = float(np.quantile(np.concatenate(slopes), share))
    return _short(min(1.0, max(LEAST_SCALE, found)))


def roughness_factor(levels: Sequence[NDArray[np.float32]], model: str) -> float:
    """The highest roughness of all levels."""
    highest = max(float(level[..., channels_of(model, "roughness")].max()) for level in levels)
    return min(1.0, max(_LEAST_FACTOR, _short(highest + 5e-7)))


def _unit(vectors: Values) -> Values:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(np.float32).tiny), np.float32)


def _short(value: float) -> float:
    """The number to six decimals: what stands in the document is exactly what is reckoned with."""
    return round(value, 6)
