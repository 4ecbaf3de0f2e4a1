"""Levels for renderers of fits, stamped by hand."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake.fitting.renderer import TILE, Levels, Renderer, tiles_along
from mipbake.fitting.views import View
from mipbake.material.pixel_filter import level_sizes

CHANNELS = {"base_color": 3, "metallic": 1, "roughness": 1, "normal": 3}
"""Maps of `gltf`, with how many channels each has."""


def stamps_of(sizes: Iterable[tuple[int, int]], numbers: Iterable[int]) -> tuple[NDArray[np.int64], ...]:
    """Stamps of levels (height, width), one number for all tiles of each."""
    return tuple(np.full(tiles_along(size), number, np.int64) for size, number in zip(sizes, numbers, strict=True))


def stamped(levels: Levels, numbers: Sequence[int]) -> Levels:
    """The same maps with other stamps, one number for each level."""
    return Levels(levels.model, levels.maps, levels.wrap, stamps_of(levels.sizes, numbers))


def noisy(
    size: tuple[int, int], seed: int, stamp: int, wrap: tuple[str, str] = ("wrap", "wrap"), least: float = 0.3
) -> Levels:
    """Levels with another number from `least` on in every texel. The stamps count from `stamp` on."""
    rng = np.random.default_rng(seed)
    sizes = level_sizes(*size)
    maps = {n: [rng.uniform(least, 1, (*each, c)).astype(np.float32) for each in sizes] for n, c in CHANNELS.items()}
    return Levels("gltf", maps, wrap, stamps_of(sizes, range(stamp, stamp + len(sizes))))


def by_tiles(old: Levels, new: Levels, seed: int) -> tuple[Levels, Levels]:
    """What stamps say of some tiles, at random, of which `new` has others than `old`, each of the same sizes.

    Returns:
        The maps of `new`, with new stamps for those tiles alone: a renderer that has `old` must not look at the others.
        What it must show then: the maps of `old` with those tiles of `new`, all of whose stamps are new.
    """
    rng = np.random.default_rng(seed)
    last = max(int(each.max()) for each in old.stamps)
    stamps = tuple(np.where(rng.random(each.shape) < 0.5, last + 1, each) for each in old.stamps)
    mixed = {name: [level.copy() for level in maps] for name, maps in old.maps.items()}
    for index, (now, before) in enumerate(zip(stamps, old.stamps, strict=True)):
        rows, columns = np.indices(old.sizes[index]) // TILE
        changed = (now != before)[rows, columns]
        for name, maps in mixed.items():
            maps[index][changed] = new.maps[name][index][changed]
    told = Levels(old.model, new.maps, old.wrap, stamps)
    return told, stamped(Levels(old.model, mixed, old.wrap, stamps), [last + 2] * len(stamps))


def check_tiles(renderer: Renderer[View], views: Sequence[View], size: tuple[int, int]) -> None:
    """That a renderer which gets some tiles anew shows what it shows of the whole levels."""
    first = noisy(size, 1, 1_000)
    before = [renderer.render(first, view).image for view in views]
    told, whole = by_tiles(first, noisy(size, 2, 0), 3)
    seen = [renderer.render(told, view).image for view in views]
    for view, found, old in zip(views, seen, before, strict=True):
        assert np.array_equal(found, renderer.render(whole, view).image) and not np.array_equal(found, old)
