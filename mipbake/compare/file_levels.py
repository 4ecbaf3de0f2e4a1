"""Levels of a stack as files give them back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import overload

import numpy as np
from numpy.typing import NDArray

from mipbake.io.layout import LAYOUTS, from_file
from mipbake.io.map_files import Levels, MapFile, StoredLevels
from mipbake.packing import unpacked
from mipbake.render import lookup
from mipbake.stack import MipStack


def stored_channels(files: Sequence[MapFile], stack: MipStack) -> Levels:
    """Stored channels of a stack, with the maps that files hold in place of its own."""
    count = min(len(stack.levels), *(len(file.levels) for file in files))
    levels = [level.copy() for level in stack.levels[:count]]
    for file in files:
        for index, level in enumerate(levels):
            found = unpacked([(file.layout, [file.levels[index]])], stack.model)
            for layout in LAYOUTS[stack.model]:
                if layout.name in found:
                    (level[..., layout.channels],) = found[layout.name]
    return levels


class _WrittenLevels(Sequence[NDArray[np.float32]]):
    """`stored_channels`, which are looked up in the texels of the files: nothing of the size of a level is made.

    Each level is made where it is asked for itself. Interpolation commutes with what turns file values into channels,
    to rounding, so lookups interpolate file values.
    """

    def __init__(self, files: Sequence[MapFile], stack: MipStack) -> None:
        self._files, self._stack = files, stack

    def __len__(self) -> int:
        return min(len(self._stack.levels), *(len(file.levels) for file in self._files))

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...

    @overload
    def __getitem__(self, index: slice) -> list[NDArray[np.float32]]: ...

    def __getitem__(self, index: int | slice) -> NDArray[np.float32] | list[NDArray[np.float32]]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        files = [replace(file, levels=[file.levels[index]]) for file in self._files]
        return stored_channels(files, replace(self._stack, levels=[self._stack.levels[index]]))[0]

    def lookup(self, uv: NDArray[np.float64], lod: float, wrap: tuple[str, str]) -> NDArray[np.float32]:
        """(P, C) stored channels at (P, 2) uv; see `mipbake.render.texture_space.lookup`."""
        out = np.empty((len(uv), self._stack.levels[0].shape[-1]), np.float32)
        for file in self._files:
            assert isinstance(file.levels, StoredLevels)
            values = lookup(file.levels.texels[: len(self)], uv, lod, wrap)
            texels = from_file(values, file.layout.encodings, srgb=False)
            found = unpacked([(file.layout, [texels])], self._stack.model)
            for layout in LAYOUTS[self._stack.model]:
                if layout.name in found:
                    (out[:, layout.channels],) = found[layout.name]
        return out


def written_levels(files: Sequence[MapFile], stack: MipStack) -> Sequence[NDArray[np.float32]]:
    """Stored channels of a stack, with the maps that files hold in place of its own; where files hold floating-point
    numbers, levels that are looked up in their texels.
    """
    held = {(channel.map, channel.index) for file in files for channel in file.layout.channels}
    whole = all((layout.name, i) in held for layout in LAYOUTS[stack.model] for i in range(len(layout.encodings)))
    shading = [file for file in files if file.layout.shades]
    linear = all(
        isinstance(file.levels, StoredLevels)
        and file.levels.texels[0].dtype.kind == "f"
        and not (file.container.srgb(file.layout) and file.layout.is_colour)
        and file.levels.texels[0].shape[:2] == stack.levels[0].shape[:2]
        for file in shading
    )
    together = all(sum(_holds(file, each.name) for file in files) == 1 for each in LAYOUTS[stack.model])
    return _WrittenLevels(shading, stack) if whole and linear and together else stored_channels(files, stack)


def _holds(file: MapFile, name: str) -> bool:
    return any(channel.map == name for channel in file.layout.channels)
