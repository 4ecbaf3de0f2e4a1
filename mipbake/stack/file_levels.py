"""Levels of a stack as files give them back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake.source.layout import LAYOUTS
from mipbake.stack.map_files import GivenBack, Levels, MadeLevels, MapFile
from mipbake.stack.packing import unpacked
from mipbake.stack.stack import MipStack


class WrittenLevels(MadeLevels):
    """Stored channels of a stack, with the maps that files hold in place of its own. Of files that give single texels
    back, lookups ask for what they need, and nothing of the size of a level is made.
    """

    def __init__(self, files: Sequence[MapFile], stack: MipStack) -> None:
        self._files, self._stack = files, stack

    def __len__(self) -> int:
        return min(len(self._stack.levels), *(len(file.levels) for file in self._files))

    def _level(self, index: int) -> NDArray[np.float32]:
        return self._with_maps(self._stack.levels[index].copy(), [file.levels[index] for file in self._files])

    def _with_maps(self, out: NDArray[np.float32], held: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        """Stored channels (..., C), changed in place, with what each file holds, (..., its channels)."""
        for file, texels in zip(self._files, held, strict=True):
            found = unpacked([(file.layout, [texels])], self._stack.model)
            for layout in LAYOUTS[self._stack.model]:
                if layout.name in found:
                    (out[..., layout.channels],) = found[layout.name]
        return out

    def lookup(self, uv: NDArray[np.float64], lod: float, wrap: tuple[str, str]) -> NDArray[np.float32]:
        """(P, C) stored channels at (P, 2) uv; see `mipbake.quality.round_lookups.lookup`."""
        clamped = min(max(lod, 0.0), len(self) - 1.0)
        finer = int(clamped)
        texels = self._bilinear(finer, uv, wrap)
        if clamped > finer:
            texels += np.float32(clamped - finer) * (self._bilinear(finer + 1, uv, wrap) - texels)
        return texels

    def _bilinear(self, index: int, uv: NDArray[np.float64], wrap: tuple[str, str]) -> NDArray[np.float32]:
        """(P, C) of one level."""
        height, width = self._stack.levels[index].shape[:2]
        columns, x = _neighbours(uv[:, 0], width, wrap[0])
        rows, y = _neighbours(uv[:, 1], height, wrap[1])
        near = self._texels(index, np.repeat(rows, 2, 0), np.tile(columns, (2, 1)))
        left, right = near[0] + y * (near[2] - near[0]), near[1] + y * (near[3] - near[1])
        return np.asarray(left + x * (right - left), np.float32)

    def _texels(self, index: int, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.float32]:
        """(N, P, C) stored channels of the texels of (N, P) rows and columns of a level."""
        made = (file.levels for file in self._files)
        held = [each.at(index, rows, columns) for each in made if isinstance(each, GivenBack)]
        return self._with_maps(np.array(self._stack.levels[index][rows, columns]), held)


def _neighbours(at: NDArray[np.float64], size: int, mode: str) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """(2, P) texels on both sides of (P,) coordinates along an axis, and (P, 1) the way from the first to the second.

    Coordinates are rounded to float32, as native lookups round their own.
    """
    place = at.astype(np.float32).astype(np.float64) * size - 0.5
    first = np.floor(place)
    both = first.astype(np.int64) + np.array([[0], [1]])
    return both % size if mode == "wrap" else np.clip(both, 0, size - 1), (place - first).astype(np.float32)[:, None]


def stored_channels(files: Sequence[MapFile], stack: MipStack) -> Levels:
    """All of `WrittenLevels` at once."""
    return WrittenLevels(files, stack)[:]


def written_levels(files: Sequence[MapFile], stack: MipStack) -> Sequence[NDArray[np.float32]]:
    """`WrittenLevels`, which are made at once where files do not give single texels back."""
    shading = [file for file in files if file.layout.shades]
    single = all(isinstance(file.levels, GivenBack) for file in shading)
    return WrittenLevels(shading, stack) if single else stored_channels(files, stack)
