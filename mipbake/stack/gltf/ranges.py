"""Ranges of the values in a glTF material's textures: its factors stretch them, so that eight bits are used well.

glTF multiplies x and y of a normal texture by `normalTexture.scale` before it renormalises, and roughness by
`roughnessFactor`. So normals may be stored steeper and roughness higher than they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from mipbake.source.layout import channels_of
from mipbake.stack.map_files import Levels, MapFile

LEAST_SCALE = 1 / 64
"""The least scale of normals: a step of eight bits is then a slope of 1/8192, below which no lobe is narrow enough to
show it."""

_LEAST_Z = 0.05  # slopes of steeper normals are held there
_LEAST_FACTOR = 1 / 255  # a step of eight bits: not tuned
_SHARE = 0.97  # of slopes within the scale; tried beside 0.75, 0.9 and 0.99 on five sets, and no record holds it


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
        made = self._changed(file, np.divide, unit=True)
        factors = {"normal": self.normal, "roughness": self.roughness}
        return replace(made, weights=made.weights and replace(made.weights, factors=factors))

    def shown(self, file: MapFile) -> MapFile:
        """A file with the values that a material shows, from a file with the values that its texture holds.

        Normals are not made unit again: engines filter them as they are stored, so that steep ones count less.
        """
        return self._changed(file, np.multiply, unit=False)

    def meant(self, file: MapFile) -> MapFile:
        """Values as from `shown`, with unit normals where they are stretched: to be compared with what was
        stretched."""
        return self._changed(file, np.multiply, unit=True)

    def _changed(self, file: MapFile, change: np.ufunc, unit: bool) -> MapFile:
        if not any(getattr(self, c.map, 1) != 1 for c in file.layout.channels):
            return file  # levels that are made when they are read stay so
        levels = [level.copy() for level in file.levels]
        for name, factor in (("normal", [self.normal, self.normal, 1]), ("roughness", self.roughness)):
            found = {c.index: place for place, c in enumerate(file.layout.channels) if c.map == name}
            channels = [found[index] for index in sorted(found)]
            if channels and getattr(self, name) != 1:
                for level in levels:
                    values = np.asarray(change(level[..., channels], factor), np.float32)
                    level[..., channels] = _unit(values) if unit and name == "normal" else values
        return replace(file, levels=levels)


def ranges_of(levels: Levels, model: str) -> Ranges:
    """Ranges for the levels of a stack of `gltf` or `gltf-anisotropic`: nearly all slopes of its normals lie within the
    scale, and the highest roughness becomes 1."""
    highest = max(float(level[..., channels_of(model, "roughness")].max()) for level in levels)
    return Ranges(_scale(levels, model), min(1.0, max(_LEAST_FACTOR, _short(highest + 5e-7))))


def _scale(levels: Levels, model: str) -> float:
    """The scale of normals that _SHARE of the slopes of levels 0 and 1 lies within; from `LEAST_SCALE` to 1."""
    normals = [level[..., channels_of(model, "normal")] for level in levels[:2]]
    slopes = [np.abs(each[..., :2] / np.maximum(each[..., 2:], _LEAST_Z)).reshape(-1) for each in normals]
    return _short(min(1.0, max(LEAST_SCALE, float(np.quantile(np.concatenate(slopes), _SHARE)))))


def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.maximum(length, np.finfo(np.float32).tiny), np.float32)


def _short(value: float) -> float:
    """The number to six decimals: what stands in the document is exactly what is reckoned with."""
    return round(value, 6)
